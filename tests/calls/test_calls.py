"""Each call of libc that a command makes may fail: it ends as it promises, and says ok of no loss.

These tests try a choice. All: `python -m tests.calls --most 0 --table tests/calls/outcomes.md`.
"""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import ROOT

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from tests.calls.called_commands import COMMANDS, Judge, lost_frames
from tests.calls.failing_calls import Ended

DRAWING = ("figure", "sweep")  # matplotlib's own code prints a traceback where a font is not read


def tried(*words: str) -> list[dict[str, Any]]:
    """Return what became of each case of `python -m tests.calls WORDS`."""
    command = [sys.executable, "-m", "tests.calls", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.stderr.splitlines()[-1:] == [f"{done.stdout.count(chr(10))} cases, 0 findings"], (
        done
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_a_disk_that_is_full_for_one_write_is_a_loss() -> None:
    rows = tried("simulate", "--call", "write", "--how", "ENOSPC", "--most", "6")
    assert [row["code"] for row in rows if row["fired"]] == [3] * 6, rows


def test_calls_of_the_compiled_loop_fail_too() -> None:
    (row,) = tried(
        "lockstep",
        "--process",
        "plant thread",
        "--call",
        "send",
        "--how",
        "ENOBUFS",
        "--cases",
        "1",
        "--seed",
        "2",
    )
    assert (row["process"], row["fired"], row["code"]) == ("plant thread", True, 5), row


@pytest.mark.deep
def test_a_word_of_the_host_that_is_refused_once_holds_up_no_run() -> None:
    rows = tried("lockstep", "--process", "host", "--call", "send", "--how", "ENOBUFS")
    assert [row["code"] for row in rows] == [0] * 4, rows


@pytest.mark.deep
@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in DRAWING])
def test_a_command_of_which_a_call_fails_ends_as_it_promises(command: str) -> None:
    rows = tried(command, "--most", "6", "--cases", "30", "--seed", "1")
    assert sum(row["fired"] for row in rows) > 20, rows


@pytest.fixture
def judge(tmp_path: Path) -> Judge:
    """Return a judge of a run of the probe, in tmp_path / "whole"."""
    (tmp_path / "whole" / "out").mkdir(parents=True)
    rig = load_rig(ROOT / "plants/probe/rig.yaml", settings=["duration_s=0.05"])
    simulate(rig, tmp_path / "whole" / "out" / "log.mcap")
    return Judge((), tmp_path / "whole", True, {})


def ended(code: int | None = 0, err: str = "", left: tuple[str, ...] = ()) -> Ended:
    return Ended(code, "", err, 0.0, left, True, {})


@pytest.mark.parametrize(("end", "finding"), [
    (ended(None), "a hang"),
    (ended(-11), "exit code -11"),
    (ended(1), "exit code 1 without a word"),
    (ended(4, "Traceback (most recent call last):"), "a Traceback"),
    (ended(left=("pcpc recorder",)), "left pcpc recorder running"),
])  # fmt: skip
def test_an_end_that_no_command_may_have_is_found(judge: Judge, end: Ended, finding: str) -> None:
    assert judge.wrong(end, judge.folder) == [finding]


def test_other_words_than_those_of_a_whole_run_are_found(judge: Judge) -> None:
    said = replace(judge, said="bit-identical\n")
    assert said.wrong(ended(), said.folder) == ["false ok: "]
    assert said.wrong(ended(3, "a loss"), said.folder) == []


def test_a_false_ok_is_found(judge: Judge, tmp_path: Path) -> None:
    """Of a file that is not there, one that is cut, other bits; and what is left behind."""
    other = tmp_path / "other" / "out"
    other.mkdir(parents=True)
    assert judge.wrong(ended(), other.parent) == ["false ok: no out/log.mcap"]
    data = (judge.folder / "out" / "log.mcap").read_bytes()
    (other / "log.mcap").write_bytes(data[: len(data) // 2])
    assert judge.wrong(ended(), other.parent)[0].startswith("false ok: ")
    assert judge.wrong(ended(3, "a loss"), other.parent) == []
    rig = ROOT / "plants/probe/rig.yaml"
    settings = ["duration_s=0.05", "controller.gain=4.1"]
    simulate(load_rig(rig, settings=settings), other / "log.mcap")
    assert judge.wrong(ended(), other.parent) == ["false ok: other bits"]
    assert "in a cut log" in judge.wrong(ended(3, "a loss"), other.parent)[0]
    (other / "left.tmp").touch()
    assert judge.wrong(ended(), other.parent)[0] == "left out/left.tmp"


def test_a_frame_that_is_lost_between_two_is_found(judge: Judge) -> None:
    """As of a send whose error nobody looked at: it is in the log of its sender alone."""
    log = logs.read(judge.folder / "out" / "log.mcap")
    assert lost_frames(log) == []
    plant = log.node["plant"]
    (came,) = np.nonzero((plant.frames["direction"] == 1) & (plant.frames["id"] == 0x80))
    frames = np.delete(plant.frames, came[len(came) // 2])
    damaged = replace(log, node=log.node | {"plant": replace(plant, frames=frames)})
    assert lost_frames(damaged) == [f"executive sent {len(came)} of 80, {len(came) - 1} came"]
