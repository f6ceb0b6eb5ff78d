"""Logs that a page writes and reads, with a native run's columns in the place of a page's run."""

import base64
import json
import random
import re
import shutil
import subprocess
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from places import ROOT

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.after.log.diff import compare
from pcpc.tools.cli import main
from pcpc.tools.make.generate.translator.kinds import Untranslatable
from pcpc.tools.make.web.log_head import log_head

NODE = shutil.which("node") or ""
PAGE, SCRIPT = ROOT / "tools/make/web/page", Path(__file__).with_name("rig_log.mjs")
pytestmark = pytest.mark.skipif(not NODE, reason="no node here")

RIGS = {
    "hull": ("atb1000/rigs/hull.yaml", "pd"),
    "hull of a network": ("atb1000/rigs/hull.yaml", "pd_nn"),
    "slew": ("atb1000/rigs/slew10.yaml", "pd"),
    "schedule": ("atb1000/rigs/engage.yaml", None),
    "quarter car": ("quarter_car/rigs/suspension-8.yaml", None),
    "pendulum": ("backlash_pendulum/rigs/backlash-pendulum.yaml", None),
}
OF_A_RECORDER = ("backlog_max.", "drains", "busy_us", "longest_drain_us")


@dataclass
class Native:
    """A native run, and what Python tells a page of its rig."""

    folder: Path
    log: logs.Log
    head: dict[str, Any]

    def page(self, name: str, *, cycles: int | None = None, lost: str = "") -> Path:
        """Return the file that a page writes of the run; CalledProcessError with its message."""
        columns = {
            f"{node}:{key}": values
            for node, one in self.log.node.items()
            for key, values in one.columns.items()
            if f"{node}:{key}" != lost and not key.startswith(("supervisor.", "time."))
        }
        ends = np.cumsum([len(values) for values in columns.values()]).tolist()
        places = [[a, b] for a, b in zip([0, *ends], ends, strict=False)]
        data, told, out = (self.folder / f"{name}.{end}" for end in ("bin", "json", "mcap"))
        np.concatenate([*columns.values()]).tofile(data)
        own = {(one["cycle"], one["name"]) for one in self.head["tunings"]}
        tunings = [
            {"node": node, **{key: one[key] for key in ("cycle", "name", "value")}}
            for node, about in self.log.node.items()
            for one in about.tunings
            if (one["cycle"], one["name"]) not in own
        ]
        count = cycles or len(self.log.node["executive"].cycle)
        run = {
            "cycles": count,
            "tunings": [one for one in tunings if 0 < one["cycle"] < count],
            "settings": {f"{t['node']}:{t['name']}": t["value"] for t in tunings if not t["cycle"]},
            "places": dict(zip(columns, places, strict=True)),
            "data": str(data),
        }
        told.write_text(json.dumps(run))
        self._node("write", told, out)
        return out

    def read(self, *files: dict[str, Any]) -> list[dict[str, Any]]:
        """Return what a page makes of files, cut or with flipped bits."""
        told, out = self.folder / "files.json", self.folder / "answers.json"
        told.write_text(json.dumps(files))
        self._node("read", told, out)
        answers: list[dict[str, Any]] = json.loads(out.read_text())
        return answers

    def _node(self, what: str, given: Path, out: Path) -> None:
        head = self.folder / "head.json"
        head.write_text(json.dumps(self.head, allow_nan=False))
        command = [NODE, *map(str, (SCRIPT, PAGE, what, head, given, out))]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr


def rig_of(name: str, *settings: str) -> Rig:
    file, controller = RIGS[name]
    return load_rig(ROOT / "plants" / file, controller, ["duration_s=2.5", *settings])


def native(rig: Rig, folder: Path, tuned: tuple[str, float] | None = None) -> Native:
    """Return a run of `rig`; `tuned`: a parameter of the executive, at the start and on the way."""
    head = log_head(rig)
    run = VirtualRun(rig, folder / "native.mcap")
    try:
        loop = run.blocks[0].loop
        for request, _ in enumerate(chain([0], run.advance())):
            if tuned:
                loop.mail_index[0] = run.plans[0].table.index[tuned[0]]
                loop.mail_value[0] = tuned[1] * (1.0 + 0.1 * request)
                loop.mail.count, loop.mail.request = 1, request + 1
    finally:
        run.close()
    return Native(folder, logs.read(folder / "native.mcap"), head)


@pytest.fixture(scope="module")
def hull(tmp_path_factory: pytest.TempPathFactory) -> Native:
    return native(rig_of("hull"), tmp_path_factory.mktemp("hull"))


def assert_same(ours: logs.Log, theirs: logs.Log) -> None:
    """Compare all that both hold, but what a recorder measures and keyframes."""
    assert not ours.missing
    for patterns in ([], ["*"]):
        report = compare(theirs, ours, patterns)
        assert report.equal, (report.only, report.differences[:3])
    for name, node in theirs.node.items():
        own = ours.node[name]
        assert np.array_equal(own.frames, node.frames)
        assert (own.events, own.tunings) == (node.events, node.tunings)
        different = {
            key for key, part in node.description.items() if own.description.get(key) != part
        }
        assert different <= {"metadata", "keyframe_passes", "keyframe_bytes", "keyframe_layout"}
    for name, facts in theirs.metadata.items():
        changed = {key for key in facts if ours.metadata[name].get(key) != facts[key]}
        assert all(
            key == "clock_wall_ns" or key.startswith(OF_A_RECORDER) or key.endswith(".keyframe")
            for key in changed
        ), changed
    described = {f"{name}.json" for name in theirs.node}
    assert {k: v for k, v in theirs.attachments.items() if k not in described} == {
        k: v for k, v in ours.attachments.items() if k not in described
    }
    assert ours.files == theirs.files


@pytest.mark.parametrize("name", RIGS)
def test_a_pages_log_is_that_of_the_native_run(name: str, tmp_path: Path) -> None:
    settings = ["schedule=[{at_s: 1.0, set: {controller.network_on: 1.0}}]"]
    run = native(rig_of(name, *(settings if name == "schedule" else [])), tmp_path)
    page = run.page("page")
    assert_same(logs.read(page), run.log)
    assert main(["replay", str(page), "--quiet"]) == 0


def test_tunings_of_a_page_are_those_of_pcpc_tune(tmp_path: Path) -> None:
    run = native(rig_of("hull"), tmp_path, ("controller.kv_Nms_rad", 90.0))
    told = run.log.node["executive"].tunings
    assert [one["cycle"] for one in told] == [0, 1000, 2000]
    page = run.page("page")
    assert_same(logs.read(page), run.log)
    assert main(["replay", str(page), "--quiet"]) == 0
    native_file, own = run.read({"name": str(tmp_path / "native.mcap")}, {"name": str(page)})
    assert native_file == own
    assert own["settings"] == {"executive:controller.kv_Nms_rad": 90.0}
    assert [one["cycle"] for one in own["tunings"]] == [1000, 2000]


def test_a_run_that_was_stopped_replays_as_far_as_it_came(hull: Native) -> None:
    page = hull.page("stopped", cycles=1234)
    log = logs.read(page)
    assert [len(node.cycle) for node in log.node.values()] == [1234, 1235]
    assert main(["replay", str(page), "--quiet"]) == 0


def test_a_run_whose_commands_are_not_safe_at_its_end_has_no_last_word(tmp_path: Path) -> None:
    run = native(rig_of("hull", "executive.limits.CMD.motor_torque.rate_per_s=2.0"), tmp_path)
    assert len(run.log.node["executive"].cycle) > 2500  # natively they are ramped down
    page = run.page("page", cycles=2500)
    assert [one["name"] for one in logs.read(page).node["plant"].events] == ["READY", "RUN"]
    assert main(["replay", str(page), "--quiet"]) == 0


def test_a_wrong_bit_of_a_column_is_found_by_replay(hull: Native) -> None:
    values = hull.log.node["executive"].columns["controller.tau_Nm"]
    kept = values[700]
    values[700] = np.nextafter(kept, 9.0)
    page = hull.page("wrong")
    values[700] = kept
    assert main(["replay", str(page), "--quiet"]) == 1


def test_mcaps_own_reader_finds_every_message(hull: Native) -> None:
    page = hull.page("page")
    with page.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        counts = summary.statistics.channel_message_counts
        found = dict.fromkeys(counts, 0)
        for _, channel, _ in reader.iter_messages():
            found[channel.id] += 1
        assert found == counts
        assert [one.name for one in reader.iter_attachments()] == [
            name for name, *_ in hull.head["attachments"]
        ]
        assert len([*reader.iter_metadata()]) == summary.statistics.metadata_count


def test_a_column_that_a_run_does_not_have_is_named(hull: Native) -> None:
    with pytest.raises(AssertionError, match=r"plant:rx\.CMD\.tau_des: the run has no such column"):
        hull.page("lost", lost="plant:rx.CMD.tau_des")


def test_a_dropped_log_has_the_columns_of_the_run(hull: Native) -> None:
    native_file = {"name": str(hull.folder / "native.mcap"), "sums": True}
    for answer in hull.read(native_file, {"name": str(hull.page("page")), "sums": True}):
        assert answer["same"] and answer["cycles"] == 2500 and not answer["tunings"]
        for node, one in hull.log.node.items():
            for name, values in one.columns.items():
                sent = np.frombuffer(base64.b64decode(answer["columns"][f"{node}:{name}"]))
                assert np.array_equal(sent.view(np.int64), values.view(np.int64)), name


def test_damaged_logs_are_refused_in_one_line(hull: Native) -> None:
    chance = random.Random(1)
    for path in (hull.folder / "native.mcap", hull.page("page")):
        size = path.stat().st_size
        cuts = [0, 1, 7, 8, 44, 45, size - 1, *(chance.randrange(size) for _ in range(40))]
        files: list[dict[str, Any]] = [{"name": str(path), "cut": cut} for cut in cuts]
        flips = [(chance.randrange(size), 1 << chance.randrange(8)) for _ in range(60)]
        files += [{"name": str(path), "flips": [flip]} for flip in flips]
        files += [
            {"name": str(path), "flips": [[at, 255] for at in range(start, start + 64)]}
            for start in chance.sample(range(size - 64), 20)
        ]
        answers = hull.read(*files)
        for file, answer in zip(files, answers, strict=True):
            assert re.fullmatch("the log is damaged: .*", answer.get("error", "")), (file, answer)


def test_a_chunk_is_believed_by_its_own_checksum(hull: Native) -> None:
    for path in (hull.folder / "native.mcap", hull.page("page")):
        data = path.read_bytes()
        end = int.from_bytes(data[-28:-20], "little")  # of the data, where the summary begins
        unchecked = [[at, data[at]] for at in range(end - 4, end)]  # as from writers without a CRC
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None
        chunk = summary.chunk_indexes[1]
        last = chunk.chunk_start_offset + chunk.chunk_length - 1
        whole, damaged = hull.read(
            {"name": str(path), "flips": unchecked},
            {"name": str(path), "flips": [*unchecked, [last - 40, 1]]},
        )
        assert whole.get("cycles") == 2500, whole
        assert damaged.get("error", "").startswith("the log is damaged"), damaged


def test_other_rigs_and_versions_are_refused_by_name(hull: Native, tmp_path: Path) -> None:
    other = native(rig_of("slew"), tmp_path)
    (answer,) = hull.read({"name": str(tmp_path / "native.mcap")})
    assert answer["error"] == "a log of the rig slew10; this page is of hull"
    longer = native(rig_of("hull", "duration_s=0.5"), tmp_path)
    (answer,) = hull.read({"name": str(tmp_path / "native.mcap")})
    assert (answer["cycles"], answer["same"]) == (500, False)
    longer.head["version"] = "9.9"
    (answer,) = longer.read({"name": str(tmp_path / "native.mcap")})
    assert answer["error"].endswith("this page is of 9.9")
    (answer,) = other.read({"name": str(SCRIPT)})
    assert answer["error"].startswith("the log is damaged: no MCAP file")


def test_a_rig_with_a_local_node_has_no_pages_log() -> None:
    with pytest.raises(Untranslatable, match="local node"):
        log_head(load_rig(ROOT / "plants/telerobot/rigs/telerobot-u0.yaml"))
