"""`pcpc stop` and `pcpc reset` on a real run, of a rig whose name nobody else has."""

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from processes import ROOT, own_bus

import pcpc
from pcpc.drivers.errors import Exit
from pcpc.executive.nodes.live import find
from pcpc.tools.cli import main

PATIENT = "hold_cycles: 100000, fault_after_cycles: 100000"
ANSWER_S = 30.0
NAME = f"stopped-{os.getpid()}"
LAW = "controllers: {proportional: {law: 'law.py:BLOCK'}}"


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """Write a rig whose faults wait."""
    path = tmp_path / "rig.yaml"
    base = ROOT / "plants/probe/rig.yaml"
    law = base.with_name("law.py").read_text()
    assert ", 0.0, 100.0)" in law
    (tmp_path / "law.py").write_text(law.replace(", 0.0, 100.0)", ", 0.0, 1e308)"))
    stops = f"supervisor: {{{PATIENT}, on_fault: wait}}"
    name, rate = f"rig: {NAME}", "rate_hz: 200.0\nduration_s: 600.0"
    path.write_text(f"base: {base}\n{name}\n{rate}\n{stops}\n{LAW}\n")
    return path


@pytest.fixture
def live(rig: Path, tmp_path: Path) -> Iterator[pcpc.Live]:
    with pcpc.running(rig, bus=own_bus(), folder=tmp_path / "run") as run:
        yield run


def said(screen: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    """Return the exit code of a command and what it printed."""
    code = main(list(words))
    shown = screen.readouterr()
    return code, shown.out + shown.err


def test_a_run_goes_on_after_a_reset_and_ends_with_a_stop_also_when_locked(
    live: pcpc.Live, rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, text = said(capsys, "reset", str(rig))
    assert code == Exit.NOT_MET and "no fault" in text, text
    live.set({"controller.gain": 1e308, "controller.target": 10.0})
    live.wait_until(lambda now: now["supervisor.gain"] == 0.0, within_s=ANSWER_S)
    assert live.state == "FAULT"
    code, text = said(capsys, "reset", str(rig))
    assert code == Exit.NOT_MET and "still there: a command was not" in text, text
    live.set({"controller.gain": 4.0, "controller.target": 1.0})
    code, text = said(capsys, "reset", str(rig), "--json")
    assert code == Exit.OK and next(iter(json.loads(text))).endswith(".executive"), text
    live.wait_until(lambda now: now["supervisor.gain"] == 1.0, within_s=ANSWER_S)
    assert live.state in ("RUN", "HOLD")
    assert main(["lock", "all", "--node", find("executive", NAME).name]) == Exit.OK
    code, text = said(capsys, "stop", str(rig), "--quick")
    assert code == Exit.OK and "in cycle" in text, text
    live.wait(ANSWER_S)
    assert live.run.verdict.startswith("safety stop"), "it had a fault"
