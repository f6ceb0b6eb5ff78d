"""Logs of earlier versions are read, compared and replayed, as docs/versions.md promises.

    probe-2be7d52.mcap    21 November 2026: stamps of a clock, no counts of frames
    motor-b919103.mcap    22 November 2026: carries law, plant and evaluation of its own
    faulty-68cde00.mcap   26 November 2026: probe with faults of a value and a frame, a schedule

The last says 0.2.0, the others 0.1.0. Each was written by `pcpc simulate` of the commit that its
name tells.
"""

import json
from pathlib import Path

import numpy as np
import pytest

import pcpc
from pcpc.drivers.errors import Exit
from pcpc.tools import cli

HERE = Path(__file__).parent
PROBE, MOTOR = HERE / "probe-2be7d52.mcap", HERE / "motor-b919103.mcap"
FAULTY = HERE / "faulty-68cde00.mcap"
CYCLES = {PROBE: 100, MOTOR: 60, FAULTY: 100}
NOT_JUDGED = {PROBE: Exit.OK, MOTOR: Exit.NOT_MET, FAULTY: Exit.OK}  # 60 ms are too short for it
VERSIONS = {PROBE: "0.1.0", MOTOR: "0.1.0", FAULTY: "0.2.0"}
LOGS = pytest.mark.parametrize("log", CYCLES, ids=["probe", "motor", "faulty"])
CHANGES = {PROBE: "controller.gain=6", MOTOR: "reference.start_s=0", FAULTY: "controller.gain=6"}


def said(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    """Carry out a command that ends with `code`; return what it prints."""
    ended = cli.main(words)
    out, err = capsys.readouterr()
    assert ended == code, out + err
    return out


@LOGS
def test_it_is_read_and_nothing_is_missing(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    about = json.loads(said(capsys, "log", "info", str(log), "--json"))
    assert about["versions"]["pcpc"] == VERSIONS[log], "else it shows nothing of earlier versions"
    assert about["versions"]["git"].startswith(log.stem.partition("-")[2])
    assert about["nodes"]["executive"]["cycles"] == CYCLES[log]
    run = pcpc.open(log)
    np.testing.assert_allclose(np.diff(run["time.t_s"]), 1e-3, rtol=1e-9)
    assert set(run.frames["name"]) >= {"SYNC", "CMD", "FB"}
    assert [event["name"] for event in run.events if event["cycle"] < 2][:2] == ["READY", "RUN"]


@LOGS
def test_it_is_recomputed_to_the_bit(log: Path) -> None:
    nodes = pcpc.open(log, trust=True).replay()
    assert [node.identical for node in nodes] == [True, True], nodes


@LOGS
def test_it_goes_on_from_a_cycle_with_a_change(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, change in (("same", []), ("changed", ["--set", CHANGES[log]])):
        words = "--cycle", "20", "--trust", "--no-figure", "--quiet", "-o", str(tmp_path / name)
        said(capsys, "branch", str(log), *words, *change, code=NOT_JUDGED[log])
    old, same, changed = (
        pcpc.open(one, trust=True) for one in (log, tmp_path / "same", tmp_path / "changed")
    )
    received, last = [name for name in old.names if name.startswith("rx.FB.")], CYCLES[log] - 1
    for run, cycles, is_equal in ((same, last, True), (changed, 20, True), (changed, last, False)):
        assert run.replay()[0].identical
        pairs = [np.array_equal(old[name][:cycles], run[name][:cycles]) for name in received]
        assert all(pairs) == is_equal and pairs, (cycles, pairs)


def test_all_are_verified_and_a_cut_one_is_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (cut := tmp_path / "cut.mcap").write_bytes(PROBE.read_bytes()[:60_000])
    logs = [*map(str, CYCLES), str(cut)]
    rows = json.loads(said(capsys, "verify", *logs, "--trust", "--json", code=Exit.LOSS))["logs"]
    found = {row["log"]: row for row in rows}
    assert found[str(cut)]["verdict"] == "incomplete"
    checked = "executive {0} of {0} cycles, plant {1} of {1} cycles"
    for log, cycles in CYCLES.items():
        row = found[str(log)]
        assert (row["verdict"], row["why"], row["first"]) == ("identical", [], None)
        assert row["checked"] == checked.format(cycles, cycles + 1)


def test_the_keyframes_of_0_2_are_compared() -> None:
    """Their layout has another name; they have the bits of today's."""
    assert [node.keyframes for node in pcpc.open(FAULTY, trust=True).replay()] == [1, 1]


@LOGS
def test_it_is_told_drawn_and_exported(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said(capsys, "report", str(log), "-o", str(tmp_path / "run.html"))
    assert f"{CYCLES[log]}" in (tmp_path / "run.html").read_text("utf-8")
    said(capsys, "log", "export", str(log), "--format", "csv", "-o", str(tmp_path / "csv"))
    assert any(tmp_path.glob("csv*"))


def test_it_is_compared_with_a_run_of_today() -> None:
    today = pcpc.simulate("probe", set={"duration_s": 0.1})
    (pair,) = pcpc.compare(pcpc.open(PROBE), today).pairs
    assert pair.first is not None and pair.first.cycle == 100, "today's node sends a last command"
    np.testing.assert_array_equal(pcpc.open(PROBE)["rx.FB.position"], today["rx.FB.position"])
    assert not pcpc.compare(pcpc.open(MOTOR), pcpc.open(MOTOR)).changed


def test_the_names_of_0_2_are_there() -> None:
    """Until a name's end has been announced in CHANGELOG.md one minor version before."""
    names = """\
        Bounds Comparison Error Figure Fit Live Loop Margin Margins NotMet NotOk Response Run
        Sample Sweep UnknownName bounds compare fit loop margin open running simulate sweep"""
    assert set(names.split()) <= set(pcpc.__all__)
