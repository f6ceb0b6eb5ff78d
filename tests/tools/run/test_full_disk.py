"""A disk without room: exit code 3, a line that says what is missing, the summary all the same."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest
from processes import ROOT, Done, own_bus, pcpc

from pcpc.drivers.errors import Exit
from pcpc.executive.log.mcap_writer import RecordError
from pcpc.executive.nodes import virtual
from pcpc.executive.rig.reading import load_rig

PROBE = str(ROOT / "plants/probe/rig.yaml")
FULL = "No space left on device"
OWN_MOUNTS = ["unshare", "--mount", *([] if os.geteuid() == 0 else ["--map-root-user"]), "--"]


def on_a_disk(size: str, folder: Path, words: Sequence[str]) -> Done:
    """Run a command that sees a disk of `size` at `folder`, empty."""
    folder.mkdir(exist_ok=True)
    script = f'mount -t tmpfs -o size={size} disk "$0" && exec "$@"'
    before = [*OWN_MOUNTS, "sh", "-c", script, str(folder)]
    return pcpc(*words, before=before)


def lines(done: Done) -> list[str]:
    assert "Traceback" not in done.err, str(done)
    return [line for line in done.err.splitlines() if not line.startswith("compiling ")]


@pytest.mark.parametrize("command", ["run", "simulate"])
def test_a_log_that_does_not_fit_is_a_loss_and_the_rest_is_summed_up(
    command: str, tmp_path: Path
) -> None:
    disk = tmp_path / "disk"
    words = [command, PROBE, "-o", str(disk / "run"), "--quiet", "--set", "duration_s=20", "--json"]
    bus = ["--pacing", "lockstep", "--bus", own_bus()] if command == "run" else []
    done = on_a_disk("1m", disk, [*words, *bus])
    assert done.code == 3, str(done)
    summary = done.summary
    missing = "\n".join(summary["log_missing"])
    assert summary["verdict"] == "loss" and not summary["faults"], str(done)
    assert f"{disk}/run/log.mcap: the log cannot be written: {FULL}; free space" in missing, missing
    assert f"{disk}/run/summary.json: cannot be written: {FULL}" in missing, missing
    assert summary["records"]["written"] > 0 and summary["cycles"] > 0, str(done)


def test_a_disk_without_any_room_is_said_at_once(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    words = ["simulate", PROBE, "-o", str(disk), "--quiet", "--set", "duration_s=0.1"]
    done = on_a_disk("4k", disk, words)
    assert done.code == 3, str(done)
    assert any(FULL in line and str(disk) in line for line in lines(done)), str(done)
    assert len(lines(done)) <= 2, str(done)


def test_figure_and_summary_that_cannot_be_written_are_a_loss(tmp_path: Path) -> None:
    rig, whole = str(ROOT / "plants/atb1000/rigs/slew10.yaml"), tmp_path / "whole"
    words = ["--set", "duration_s=0.2", "--set", "evaluation.window_s=[0.0, 0.2]", "--quiet"]
    assert pcpc("simulate", rig, "-o", str(whole), "--json", *words).code in (0, 1)
    sizes = {path.name: -(-path.stat().st_size // 4096) for path in whole.iterdir()}
    assert sizes["figure.png"] > 6, sizes
    disk = tmp_path / "disk"
    room = sizes["log.mcap"] + sizes["summary.json"] + 3  # pages: with those of the folders
    done = on_a_disk(f"{4 * room}k", disk, ["simulate", rig, "-o", str(disk), "--json", *words])
    assert done.code == 3 and done.summary["verdict"] == "loss", str(done)
    assert done.summary["log_missing"] == [f"{disk}/figure.png: cannot be written: {FULL}"]
    assert lines(done) == [], str(done)
    for name in ("figure.png", "summary.json"):
        (tmp_path / "run" / name).mkdir(parents=True)
    done = pcpc("simulate", rig, "-o", str(tmp_path / "run"), "--json", *words)
    assert done.code == 3 and done.summary["verdict"] == "loss", str(done)
    missing = [
        f"{tmp_path}/run/{name}: cannot be written: Is a directory"
        for name in ("figure.png", "summary.json")
    ]
    assert done.summary["log_missing"] == missing and lines(done) == [], str(done)


def test_an_export_that_does_not_fit_leaves_nothing_and_is_a_loss(tmp_path: Path) -> None:
    log, disk = tmp_path / "log.mcap", tmp_path / "disk"
    virtual.simulate(load_rig(PROBE, None, ["duration_s=2"]), log)
    for words in (["export", "-o", str(disk / "a.csv")], ["recover", "-o", str(disk / "b.mcap")]):
        done = on_a_disk("16k", disk, ["log", words[0], str(log), *words[1:], "--quiet"])
        assert done.code == 3 and done.out == "", str(done)
        (line,) = lines(done)
        assert str(disk) in line and FULL in line, line


def test_a_recorder_tells_a_full_disk_from_one_that_refuses(tmp_path: Path) -> None:
    rig = load_rig(PROBE, None, ["duration_s=0.1"])
    with pytest.raises(RecordError, match=FULL) as full:
        virtual.simulate(rig, Path("/dev/full"))
    with pytest.raises(RecordError) as refused:
        virtual.simulate(rig, tmp_path)
    assert (full.value.code, refused.value.code) == (Exit.LOSS, Exit.ENVIRONMENT)


@pytest.mark.parametrize(
    ("words", "most_bytes"),
    [
        (("new", "motor"), 500),
        (("new", "--device", "motor"), 5000),  # of its files only device.py is longer
        (("dbc", "rig", "-o", "written.dbc"), 500),
    ],
)
def test_what_cannot_be_written_whole_is_not_there_and_can_be_tried_again(
    words: tuple[str, ...], most_bytes: int, tmp_path: Path
) -> None:
    """A limit of file sizes ends a write in the middle, as a disk that fills up does."""
    new = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "tools/make/template", tmp_path / "rig", ignore=new)
    (tmp_path / "rig/motor.dbc").unlink()
    small = pcpc(*words, cwd=tmp_path, before=["prlimit", f"--fsize={most_bytes}", "--"])
    assert small.code in (Exit.LOSS, Exit.ENVIRONMENT), str(small)
    assert "cannot be written: File too large" in lines(small)[-1], str(small)
    assert "Traceback" not in small.err, str(small)
    assert not (tmp_path / words[-1]).exists(), sorted(tmp_path.rglob("*"))
    assert pcpc(*words, cwd=tmp_path).code == 0
