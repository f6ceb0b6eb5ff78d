"""Rows of one campaign are of one rig and one code: what else a run follows from has a digest."""

import json
import math
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from places import ROOT

from pcpc.drivers.errors import UserError
from pcpc.executive.batch.runs import BatchRuns, Case
from pcpc.executive.errors import RigError
from pcpc.tools.cli import main
from pcpc.tools.study.engine import RunVerdict
from pcpc.tools.study.sweep import origin as origins
from pcpc.tools.study.sweep import rerun, shards, store
from pcpc.tools.study.sweep.campaign import Campaign, Shard, differences
from pcpc.tools.study.sweep.results import RAN, Results
from pcpc.tools.study.sweep.work import Work
from pcpc.tools.terminal.progress import Progress

TEMPLATE = ROOT / "tools/make/template"
PREPARED = """
import help_of_pid
from pathlib import Path
from pcpc.executive.laws.block import Prepared

FOLDER = Path(__file__).parent
FACTOR = float((FOLDER / "at_import.txt").read_text()) * help_of_pid.VALUE


def prepare(settings, rate_hz, seed):
    more = float((FOLDER / "at_prepare.txt").read_text())
    return Prepared({**settings, "kp_V_rad": FACTOR * more * settings["kp_V_rad"]})


BLOCK = Block(step, prepare=prepare)
"""
HELPER = "help_of_pid"
TABLE = "# rows\nt_s, q_d_rad\n0.0, 0.0\n1.0, 1.0\n"


def campaign(folder: Path, *settings: str) -> Campaign:
    return Campaign(str(folder / "rig.yaml"), ("pid", "pd"), (), 8, "random", 1, settings)


def copy(folder: Path) -> Path:
    """Return a copy of the template whose law has modules, files and a table of its own."""
    shutil.copytree(TEMPLATE, folder)
    law, rig = folder / "laws/pid.py", folder / "rig.yaml"
    law.write_text(law.read_text().replace("BLOCK = Block(step)\n", PREPARED))
    given = "law: references:step\n      parameters: {amplitude_rad: 3.0, start_s: 0.1}"
    text = rig.read_text()
    assert given in text
    rig.write_text(text.replace(given, "{law: table, file: rows.csv, interpolation: hold}"))
    (folder / "laws/help_of_pid.py").write_text("VALUE = 1.0\n")
    (folder / "laws/at_import.txt").write_text("1.0\n")
    (folder / "laws/at_prepare.txt").write_text("1.0\n")
    (folder / "rows.csv").write_text(TABLE)
    return folder


@pytest.fixture(autouse=True)
def _imports_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let each test import modules beside its own law."""
    monkeypatch.setattr(sys, "path", [one for one in sys.path if not one.endswith("motor/laws")])
    monkeypatch.delitem(sys.modules, HELPER, raising=False)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return campaign(copy(tmp_path_factory.mktemp("origin") / "motor")).spec()


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("laws/pid.py", "BLOCK =", "# edited\nBLOCK =", "laws/pid.py"),
        ("model.py", "BLOCK =", "# edited\nBLOCK =", "model.py"),
        ("laws/help_of_pid.py", "1.0", "50.0", "laws/help_of_pid.py"),
        ("laws/at_import.txt", "1.0", "50.0", "laws/at_import.txt"),
        ("laws/at_prepare.txt", "1.0", "50.0", "laws/at_prepare.txt"),
        ("rows.csv", "1.0, 1.0", "1.0, 2.0", "table executive-reference.csv"),
        ("evaluation.py", '"""', '"""Edited: ', "evaluation.py"),
        ("motor.dbc", "VERSION", "\nVERSION", "motor.dbc"),
        ("rig.yaml", "ki_V_rads: 600.0", "ki_V_rads: 601.0", "rig"),
        ("drawing.py", '"""', '"""Edited: ', ""),
        ("README.md", "#", "##", ""),
    ],
)
def test_a_campaign_is_another_one_where_a_file_that_its_runs_need_is(
    file: str, old: str, new: str, said: str, whole: dict[str, Any], tmp_path: Path
) -> None:
    other = copy(tmp_path / "motor")
    text = (other / file).read_text()
    assert old in text
    (other / file).write_text(text.replace(old, new, 1))
    found = campaign(other).spec()
    assert differences({**found, "rig": whole["rig"]}, whole) == said


def test_versions_and_the_project_itself_are_of_a_campaign(
    whole: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = campaign(copy(tmp_path / "motor"))
    for area in origins.carried_files.AREAS:
        (tmp_path / area).mkdir()
    law = tmp_path / "plants" / "law.py"
    law.write_text("GAIN = 1.0\n")
    monkeypatch.setattr(origins, "_PROJECT", tmp_path)
    before = one.spec()["origin"]
    law.write_text("GAIN = 50.0\n")
    facts = origins.facts() | {"version_numba": "0.1", "python": "3.99", "git": "x"}
    monkeypatch.setattr(origins, "facts", lambda: facts)
    found = origins.difference(before, one.spec()["origin"])
    assert found == "version of numba, python, project"


def test_a_folder_goes_on_with_the_code_that_it_began_with(
    whole: dict[str, Any], tmp_path: Path
) -> None:
    other = copy(tmp_path / "motor")
    (other / "laws/pid.py").open("a").write("# edited\n")
    first = store.Store(tmp_path / "rows", whole, Shard(1, 2))
    first.add([RunVerdict(0, "pid", 1, {}, RAN, True)])
    first.close()
    spec = {**campaign(other).spec(), "rig": whole["rig"]}
    with pytest.raises(RigError, match=r"another campaign; it differs in laws/pid\.py; choose"):
        store.Store(tmp_path / "rows", spec, Shard(2, 2))


def test_a_process_that_imported_another_law_than_now_lies_there_says_so(tmp_path: Path) -> None:
    folder = copy(tmp_path / "motor")
    campaign(folder).spec()
    (folder / "laws/help_of_pid.py").write_text("VALUE = 50.0\n")
    with pytest.raises(RigError, match=r"help_of_pid\.py: has changed since this process"):
        campaign(folder).spec()


def kept(folder: Path, metric: float, ok: bool | None = True) -> Path:
    """Write the rows of a campaign of one draw."""
    spec = Campaign(str(TEMPLATE / "rig.yaml"), ("pid", "pd"), (), 1).spec()
    own = store.Store(folder, spec, Shard())
    found: dict[str, Any] = {"metrics": {"rms": metric}, "margins": {"it holds": 0.5}}
    own.add(RunVerdict(0, name, 1, {}, RAN, ok, **found) for name in spec["controllers"])
    own.complete()
    own.close()
    return folder


@pytest.mark.parametrize(
    ("row", "found", "ended", "other"),
    [
        ((1.5, True), (1.5, 0.5), 0, ""),
        ((1.5, True), (1.5000000000000002, 0.5), 0, "rms"),
        ((1.5, True), (None, 0.5), 0, "rms"),
        ((1.5, True), (1.5, 0.25), 0, "it holds"),
        ((1.5, True), (1.5, None), 0, "it holds"),
        ((1.5, True), (1.5, 0.5), 1, "verdict"),
        ((1.5, True), (1.0, 0.5), 5, "rms, verdict"),
        ((1.5, False), (1.5, 0.5), 0, "verdict"),
        ((1.5, False), (1.5, 0.5), 1, ""),
        ((1.5, None), (1.5, 0.5), 0, "verdict"),
        ((math.inf, False), ("inf", 0.5), 1, ""),
        ((math.inf, False), (1.5, 0.5), 1, "rms"),
    ],
)
def test_a_run_again_is_that_of_the_table_or_says_so(
    row: tuple[float, bool | None],
    found: tuple[float | str | None, float | None],
    ended: int,
    other: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = kept(tmp_path / "rows", *row)

    def simulated(*words: str) -> int:
        Path(words[-1]).mkdir()
        rms, margin = found
        summary = {
            "metrics": {"rms": rms},
            "requirements": [{"name": "it holds", "margin": margin}],
            "verdict": {0: "ok", 1: "expectation not met", 5: "safety stop"}[ended],
            "judged": ["it holds"], "not_judged": {},
        }  # fmt: skip
        (Path(words[-1]) / "summary.json").write_text(json.dumps(summary))
        return ended

    monkeypatch.setattr(rerun, "_pcpc", simulated)
    assert main(["sweep", "rerun", str(folder), "0", "pd"]) == (1 if other else ended)
    said = capsys.readouterr().out
    assert said == (f"{folder}: draw 0 of pd came to another {other}\n" if other else "")


@pytest.mark.parametrize(
    ("verdict", "judged", "left", "ok"),
    [
        ("ok", ["a"], {}, True), ("ok", ["a"], {"b": "too short"}, None), ("ok", [], {}, None),
        ("not judged", [], {"b": "too short"}, None), ("loss", ["a"], {"b": "too short"}, False),
    ],
)  # fmt: skip
def test_a_verdict_is_another_one_where_it_was_not_judged(
    verdict: str, judged: list[str], left: dict[str, str], ok: bool | None, tmp_path: Path
) -> None:
    about = {"metrics": {"rms": 1.5}, "requirements": [{"name": "it holds", "margin": 0.5}]}
    about |= {"verdict": verdict, "judged": judged, "not_judged": left}
    (tmp_path / "summary.json").write_text(json.dumps(about))
    for one in (True, False, None):
        results = Results(*shards.merge([kept(tmp_path / str(one), 1.5, one)]))
        other = rerun._differences(tmp_path / "summary.json", results, 0)
        assert other == ["verdict"] * (one != ok), (one, other)


def test_a_run_again_by_another_code_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = kept(tmp_path / "rows", 1.5)
    facts = origins.facts() | {"version_numba": "0.1"}
    monkeypatch.setattr(origins, "facts", lambda: facts)
    assert main(["sweep", "rerun", str(folder), "0"]) == 2
    said = capsys.readouterr().err
    assert "version of numba is not what it was in the campaign; as it is now: pcpc simul" in said


@pytest.mark.parametrize("wrong", [{"seed": 7}, {"values": {"motor.coulomb_Nm": 0.1}}])
def test_rows_of_other_draws_are_not_gone_on_with(wrong: dict[str, Any], tmp_path: Path) -> None:
    whole = replace(campaign(TEMPLATE), vary=("motor.coulomb_Nm=x0.5:2",))
    first = next(whole.numbered(Shard()))
    draw = whole.draw("pid", *first)
    work = Work(whole, Shard(), tmp_path / "rows", None, 1)
    own = RunVerdict(0, "pid", draw.seed, draw.values, RAN, True)
    work.store.add([own])
    assert not work._is_done(*first), "that of pd is not there"
    work.store.close()
    work = Work(whole, Shard(), tmp_path / "other", None, 1)
    work.store.add([replace(own, **wrong)])
    with pytest.raises(RigError, match="draw 0 of pid has other values in its row; begin again"):
        work._is_done(*first)
    work.store.close()


def edited_while_it_runs(folder: Path, file: str) -> Callable[..., str]:
    def run(work: Work, *about: object) -> str:
        (folder / file).open("a").write("\n")
        return ""

    return run


@pytest.mark.parametrize("file", ["motor.dbc", "evaluation.py", "laws/at_prepare.txt"])
def test_a_campaign_does_not_end_well_if_its_code_changed_meanwhile(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = copy(tmp_path / "motor")
    work = Work(campaign(folder), Shard(), tmp_path / "rows", None, 1)
    monkeypatch.setattr(Work, "_run", edited_while_it_runs(folder, file))
    with pytest.raises(RigError, match=rf"{file}.* changed (while|since)"):
        work.to_end(Progress(quiet=True))
    work.store.close()
    assert not (tmp_path / "rows" / store.EXPORT).exists()


def test_runs_one_by_one_are_of_the_rig_file_of_the_first(tmp_path: Path) -> None:
    folder = copy(tmp_path / "motor")
    rig = folder / "rig.yaml"
    runs = BatchRuns(rig, "pid", [], {})
    runs.rig_of(Case(1))
    rig.write_text(rig.read_text().replace("ki_V_rads: 600.0", "ki_V_rads: 601.0"))
    with pytest.raises(UserError, match="changed since the first run; begin again") as error:
        runs.rig_of(Case(1))
    assert not isinstance(error.value, RigError), "it would be a refused run"


def test_what_pip_notes_of_an_editable_package_is_no_file_of_a_law(tmp_path: Path) -> None:
    """The first import of numba reads it, whichever law that happens in."""
    for name, outside in (("own.egg-info/entry_points.txt", False), ("own/entry_points.txt", True)):
        file = tmp_path / name
        file.parent.mkdir()
        file.touch()
        assert origins.carried_files.is_outside(file) is outside
