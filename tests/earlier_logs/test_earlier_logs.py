"""Logs of earlier versions are read, compared and replayed, as docs/versions.md promises.

    probe-2be7d52.mcap    21 November 2026: stamps of a clock, no counts of frames
    motor-b919103.mcap    22 November 2026: carries law, plant and evaluation of its own

Both say 0.1.0. Each was written by `pcpc simulate` of the commit that its name tells.
"""

import json
from pathlib import Path

import numpy as np
import pytest

import pcpc
from pcpc.tools import cli

HERE = Path(__file__).parent
PROBE, MOTOR = HERE / "probe-2be7d52.mcap", HERE / "motor-b919103.mcap"
CYCLES = {PROBE: 100, MOTOR: 60}
LOGS = pytest.mark.parametrize("log", [PROBE, MOTOR], ids=["probe", "motor"])


def said(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    """Carry out a command that ends with `code`; return what it prints."""
    ended = cli.main(words)
    out, err = capsys.readouterr()
    assert ended == code, out + err
    return out


@LOGS
def test_it_is_read_and_nothing_is_missing(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    about = json.loads(said(capsys, "log", "info", str(log), "--json"))
    assert about["versions"]["pcpc"] == "0.1.0", "else it shows nothing of earlier versions"
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
