"""The module of a page in Node: the digest of `pcpc simulate`, and with what was changed."""

import hashlib
import json
import re
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import pytest
from processes import pcpc

from pcpc.executive.log.reader import Log
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.make.web.contents import digest
from pcpc.tools.make.web.program import Program
from pcpc.tools.start.rigs import find

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="no node here: apt install nodejs")
HERE = Path(__file__).parent
SHORT = ("--set", "duration_s=1")


def page(folder: Path, rig: str, *more: str) -> Path:
    """Return the page of a rig."""
    file = folder / "page.html"
    done = pcpc("generate", "web", rig, *more, "-o", str(file), "-q")
    assert done.code == 0, done
    return file


def runs(file: Path, *asked: dict[str, Any], patience_s: float = 300.0) -> list[dict[str, Any]]:
    """Return what became of runs in Node."""
    given = json.dumps({"page": str(file), "runs": asked})
    done = subprocess.run(
        [str(NODE), str(HERE / "in_node.mjs")],
        input=given,
        capture_output=True,
        text=True,
        timeout=patience_s,
    )
    assert done.returncode == 0, done.stderr
    return list(json.loads(done.stdout))


def native(name: str, controller: str, *settings: str) -> tuple[str, Log]:
    """Return the digest of a native run, and its log."""
    rig = load_rig(Path(find(name)), controller, ["duration_s=1", *settings])
    log = in_memory(rig)
    return digest(Program(rig), log), log


@pytest.mark.parametrize(
    "rig", ["probe", "deadzone-sine", "fuzzy-d03", "two-gaps", "telerobot-u1", "suspension-8"]
)
def test_each_controller_gives_the_digest_of_pcpc_simulate(rig: str, tmp_path: Path) -> None:
    names = [*load_rig(Path(find(rig))).config.controllers][:3]
    file = page(tmp_path, rig, *SHORT)
    for name, got in zip(names, runs(file, *({"controller": name} for name in names)), strict=True):
        assert got["digest"] == got["native"], (name, got)
        assert len({got["counts"][0] + 1, *got["counts"][1:]}) == 1


@pytest.mark.parametrize(
    "rig",
    ["hull", "slew10", "payload-on", "backlash-map", "two-gaps", "friction-c", "suspension-8",
     "fuzzy-d01", "backlash-pendulum", "deadzone-step", "telerobot-u1"],
)  # fmt: skip
def test_a_run_is_judged_as_natively(rig: str, tmp_path: Path) -> None:
    file = page(tmp_path, rig, "--controller", load_rig(Path(find(rig))).config.controller)
    known = load_rig(Path(find(rig)))
    judge, log = Judge.of(known), in_memory(known)
    (got,) = runs(file, {"controller": known.config.controller})
    found = {one["name"]: one["value"] for one in got["verdict"]["metrics"]}
    expected = {name: value for name, value in judge.metrics(log).items() if value == value}
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-15)
    results = judge.requirements(log, cut=False)
    told = got["verdict"]["requirements"]
    assert [one["met"] for one in told] == [one.held for one in results]
    assert got["verdict"]["word"] == "ok"


def test_what_is_changed_gives_the_digest_of_the_command_that_the_page_tells(
    tmp_path: Path,
) -> None:
    file = page(tmp_path, "deadzone-sine", "--controller", "nn", *SHORT)
    gain, width = "controller.kv_Nms_rad", "arm.d_plus_Nm"
    begun, tuned, both = runs(
        file,
        {"controller": "nn", "values": {gain: 31.5, width: 7.25}},
        {"controller": "nn", "at": 300, "then": {gain: 31.5}},
        {"controller": "nn", "values": {width: 1.0}, "at": 1, "then": {gain: 5.0}},
    )
    later = "schedule=[{at_s: %g, set: {controller.kv_Nms_rad: %g}}]"
    assert begun["digest"] == native("deadzone-sine", "nn", f"{gain}=31.5", f"{width}=7.25")[0]
    assert tuned["digest"] == native("deadzone-sine", "nn", later % (0.3, 31.5))[0]
    settings = f"{width}=1", later % (0.001, 5.0)
    assert both["digest"] == native("deadzone-sine", "nn", *settings)[0]
    assert len({one["digest"] for one in (begun, tuned, both)} | {begun["native"]}) == 4


@pytest.mark.parametrize(
    "changed",
    [
        {"controller.kap2": 785.1356164947664, "controller.critic_on": 0.259085991853645},
        {"arm.a2_m": 0.001, "reference_2.frequency_hz": 0.477464829275686},
    ],
)
def test_a_value_that_ends_the_run_natively_is_told(
    changed: dict[str, float], tmp_path: Path
) -> None:
    """The first of the law, the second of the plant; a page has no supervisor."""
    file = page(tmp_path, "payload-on", "--controller", "critic", *SHORT)
    ended, whole = runs(file, {"controller": "critic", "values": changed}, {"controller": "critic"})
    law = {k: v for k, v in changed.items() if k.startswith("controller.")}
    at_once = ", ".join(f"{{at_s: 0, set: {{{k}: {v!r}}}}}" for k, v in law.items())
    settings = [f"schedule=[{at_once}]"] if law else [f"{k}={v!r}" for k, v in changed.items()]
    rig = load_rig(Path(find("payload-on")), "critic", ["duration_s=1", *settings])
    cycles = len(in_memory(rig).node["executive"].columns["time.t_s"])
    assert ended["odd"]["cycle"] <= cycles < 1000 and whole["odd"] is None


def test_another_seed_gives_the_digest_of_that_seed(tmp_path: Path) -> None:
    file = page(tmp_path, "hull", "--controller", "pd", *SHORT)
    found = runs(file, *({"controller": "pd", "seed": str(seed)} for seed in (1, 2, 4)))
    expected = [native("hull", "pd", f"seed={seed}")[0] for seed in (1, 2, 4)]
    assert [one["digest"] for one in found] == expected
    assert len({*expected}) == 3


def test_a_module_with_a_bit_of_its_period_changed_has_another_digest(tmp_path: Path) -> None:
    file = page(tmp_path, "deadzone-sine", "--controller", "pd", *SHORT)
    module = Program(load_rig(Path(find("deadzone-sine")), "pd", ["duration_s=1"])).module()
    places = [at.start() + 6 for at in re.finditer(re.escape(struct.pack("<d", 1e-3)), module)]
    found = runs(file, *({"controller": "pd", "flip": at} for at in places), {"controller": "pd"})
    equal = [one["digest"] == one["native"] for one in found]
    assert equal[-1] and not all(equal)


def test_the_digest_is_of_every_recorded_value() -> None:
    """Shape (n,) of each column; one bit of any of them gives another digest."""
    rig = load_rig(Path(find("probe")), None, ["duration_s=0.1"])
    program, log = Program(rig), in_memory(rig)
    whole = hashlib.sha256()
    for role, columns in program.columns().items():
        names = [name for name, _ in columns]
        for k in range(program.cycle_count):
            row = [log.node[role].columns[name][k] for name in names]
            whole.update(b"".join(value.tobytes() for value in row))
    assert whole.hexdigest() == digest(program, log)


def test_equal_rigs_give_equal_pages(tmp_path: Path) -> None:
    """Markup in a title is text, and nothing is loaded from anywhere."""
    rig = tmp_path / "rig.yaml"
    title = "</title><script>alert(1)</script>"
    rig.write_text(f"base: {Path(find('probe')).resolve()}\ntitle: '{title}'\n", encoding="utf-8")
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    files = [page(tmp_path / name, str(rig), *SHORT).read_bytes() for name in ("a", "b")]
    assert files[0] == files[1]
    text = files[0].decode()
    assert title not in text and "&lt;script&gt;alert(1)" in text
    assert "default-src 'none'" in text and len(text) < 1_000_000
    for word in ("http://", "https://", "@import", "src="):
        assert word not in re.sub("https://github.com/(leeoniya|101arrowz)/", "", text), word
