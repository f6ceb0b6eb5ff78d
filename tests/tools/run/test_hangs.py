"""What does not return, raises, is not answered or loses its recorder: named, ended, summed up."""

import os
import shutil
import signal
from pathlib import Path

import pytest
from processes import ROOT, Running, own_bus, pcpc, until

PROBE = ROOT / "plants" / "probe"
LAW = """\
from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage


class Gains(Ports):
    gain = port("", "k")
    target = port("", "r")


class Inputs(Ports):
    position = port("", "measured")


class Outputs(Ports):
    command = port("", "what the lag is told")


@stage
def step(t: float, dt: float, p: Gains, x: Nothing, u: Inputs, y: Outputs) -> None:
    y.command = p.gain * (p.target - u.position)
    if t > 0.1003 and t < 0.9:
        {body}


BLOCK = Block(step)
"""
HANGS = "while p.gain > 0.0:\n            y.command += u.position"
RAISES = 'raise ValueError("too late")'
QUIET = ("--quiet", "--no-figure")
LOCKSTEP = ("--pacing", "lockstep")


def rig_with(folder: Path, body: str) -> Path:
    """Write the probe with a law that does `body` from 0.1 s on; return its rig file."""
    for name in ("model.py", "probe.dbc", "rig.yaml"):
        shutil.copy(PROBE / name, folder)
    (folder / "law.py").write_text(LAW.format(body=body))
    return folder / "rig.yaml"


def test_a_step_that_hangs_ends_the_run_with_its_name(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, HANGS)
    with Running("run", str(rig), *QUIET, *LOCKSTEP, "--json", "-o", str(tmp_path / "o")) as run:
        done = run.done()
        assert done.code == 5 and run.left() == [], str(done)
    first = done.summary["faults"][0]
    assert first == "executive: the step of controller does not return, in cycle 101", str(done)
    assert done.summary["verdict"] == "safety stop"


def test_in_virtual_time_a_step_that_hangs_is_named_and_ctrl_c_ends_it(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, HANGS)
    done = pcpc("simulate", str(rig), *QUIET, "--json", "-o", str(tmp_path / "o"))
    assert done.code == 5, str(done)
    said = ["executive: the step of controller does not return, in cycle 101"]
    assert done.summary["faults"] == said, str(done)
    with Running("simulate", str(rig), *QUIET, "-o", str(tmp_path / "p")) as run:
        until(lambda: (tmp_path / "p" / "log.mcap").exists() or run.over(), "it begins")
        run.process.send_signal(signal.SIGINT)
        assert run.done(20.0).code == 130, str(run)


@pytest.mark.parametrize("way", [("simulate",), ("run", *LOCKSTEP)])
def test_a_step_that_raises_is_told_with_its_line(tmp_path: Path, way: tuple[str, ...]) -> None:
    rig = rig_with(tmp_path, RAISES)
    done = pcpc(way[0], str(rig), *way[1:], *QUIET, "--json", "-o", str(tmp_path / "o"))
    assert done.code == 5 and "Traceback" not in done.err, str(done)
    assert f"{tmp_path}/law.py:21: ValueError: too late, in `{RAISES}`" in done.err, str(done)
    first = done.summary["faults"][0]
    assert first == "executive: the step of controller ended with an exception, in cycle 101", first


def test_a_law_that_returns_nan_is_named_and_no_run_is_ok(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, 'y.command = float("nan")')
    done = pcpc("simulate", str(rig), *QUIET, "--json", "-o", str(tmp_path / "o"))
    assert done.code == 5, str(done)
    assert done.summary["faults"] == ["executive: controller.command was nan in cycle 101"]


@pytest.mark.parametrize(
    ("alone", "other", "frame"),
    [("executive", "plant", "HB_PLANT"), ("plant", "executive", "SYNC")],
)
def test_a_node_that_nobody_answers_ends_with_a_line(
    tmp_path: Path, alone: str, other: str, frame: str
) -> None:
    wait = ("--set", "supervisor.peer_timeout_s=0.3", "--bus", own_bus())
    kept = ("-o", str(tmp_path / "o")) if alone == "executive" else ()
    done = pcpc("run", f"--only={alone}", str(PROBE / "rig.yaml"), *QUIET, *wait, *kept)
    assert done.code == 4, str(done)
    assert f"no frame of {other} on udp_multicast" in done.err, str(done)
    assert f" s, as {frame}; start " in done.err, str(done)
    assert len(done.err.strip().splitlines()) <= 2 and not (tmp_path / "o").exists(), str(done)


def test_a_dead_recorder_is_the_only_fault_and_a_closed_terminal_leaves_a_summary(
    tmp_path: Path,
) -> None:
    rig = str(PROBE / "rig.yaml")
    for name, ends in (("killed", "recorder"), ("hung up", "host")):
        bus, folder = own_bus(), tmp_path / name
        with Running("run", rig, *QUIET, "--json", "--bus", bus, "-o", str(folder)) as run:
            run.in_the_middle("probe", bus)
            if ends == "recorder":
                os.kill(run.pid("recorder"), signal.SIGKILL)
            else:
                run.process.send_signal(signal.SIGHUP)
            done = run.done()
            assert run.left() == [], str(run)
        assert (folder / "summary.json").exists(), str(done)
        faults = done.summary["faults"]
        if ends == "recorder":
            assert (done.code, len(faults)) == (5, 1) and "recorder: ended by" in faults[0], done
        else:
            assert (done.code, faults) == (130, []), done
