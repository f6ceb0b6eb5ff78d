"""Stalls in real processes: exact cycle numbers, the phase kept, the rig's policy carried out."""

import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from processes import PATIENT, RIGS, Running, own_bus, pcpc, until

from pcpc.executive.log import reader as logs
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.timing_layout import Stage

PERIOD_NS = 1_000_000
SLOW = """\
from pcpc.executive.laws.block import Block, Ports, port, stage
from pcpc.plants.atb1000.laws import pd
from pcpc.executive.laws.emath import sin


class Work(Ports):
    sines = port("", "how many sines a step takes", 0.0, 0.0, 1e9)


class States(Ports):
    s = port("", "the last sine")


@stage
def step(t: float, dt: float, p: Work, x: States, u: pd.Inputs, y: pd.Outputs) -> None:
    y.e_rad = u.q_d_rad - (u.encoder_rad + u.hull_pitch_rad)
    for _ in range(int(p.sines)):
        x.s = sin(x.s + 1.0)


BLOCK = Block(step)
"""


def slow_rig(folder: Path, overrun: str) -> Path:
    """Write a rig whose law needs some milliseconds a cycle from 0.5 s on."""
    (folder / "slow.py").write_text(SLOW)
    rig = folder / "slow.yaml"
    rig.write_text(
        f"base: {RIGS / 'slew10.yaml'}\nrig: slow\nduration_s: 1.5\ncontroller: slow\n"
        "controllers: {slow: {law: slow.py}}\nexpect: null\n"
        "evaluation: {window_s: [0.0, 1.5]}\n"
        "supervisor: {fault_after_cycles: 400}\n"
        "schedule: [{at_s: 0.5, set: {controller.sines: 300000.0}}]\n"
        f"overrun: {overrun}\n"
    )
    return rig


def run(rig: Path, folder: Path) -> tuple[int, logs.NodeLog]:
    """Run a rig on a bus of its own; return exit code and the executive's record."""
    done = pcpc("run", str(rig), "--bus", own_bus(), "-o", str(folder), "--quiet", "--no-figure")
    log = folder / "log.mcap"
    assert log.exists(), done
    replayed = pcpc("replay", str(log), "--quiet", "--json", "--node", "executive")
    assert replayed.code == 0, replayed
    return done.code, logs.read(log).node["executive"]


def test_a_law_that_is_too_slow_hands_over_to_the_fallback(tmp_path: Path) -> None:
    _, node = run(slow_rig(tmp_path, "{fallback: pd, fallback_after: 9}"), tmp_path / "run")
    events = [e for e in node.events if e["event"] == "fallback"]
    assert len(events) == 1, node.events
    at = events[0]["cycle"]
    slow = np.count_nonzero((node.cycle >= 500) & (node.cycle < at))  # a stall skips cycles
    assert 9 <= slow <= 10, f"slow from cycle 500 on, the fallback came in {at}, after {slow}"
    active = node.columns["supervisor.fallback"]
    assert (active[node.cycle >= at] == 1.0).all() and (active[node.cycle < at] == 0.0).all()
    after = node.cycle > at + 20
    assert np.abs(node.columns["controller.motor_torque_Nm"][after]).max() > 0.01, "pd commands"
    assert node.cycle[-1] == 1499, node.cycle[-1]


def test_a_fault_after_a_stall_names_the_limit_in_time_and_the_setting(tmp_path: Path) -> None:
    rig = slow_rig(tmp_path, "{}")
    text = rig.read_text().replace("fault_after_cycles: 400", "fault_after_cycles: 3")
    rig.write_text(text.replace("300000.0", "10000000.0"))  # far more than 3 ms, on any machine
    words = ["--quiet", "--no-figure", "--json", "-o", str(tmp_path / "run")]
    done = pcpc("run", str(rig), "--bus", own_bus(), "--pacing", "real", *words)
    assert done.code == 5, done
    said = "\n".join(done.summary["faults"])
    assert "3 cycles are 3 ms, and here a cycle began " in said, done
    assert "ms late" in said and " --set supervisor.fault_after_cycles=" in said, done


def test_a_law_that_is_too_slow_is_a_fault_where_the_rig_says_so(tmp_path: Path) -> None:
    code, node = run(slow_rig(tmp_path, "{fault_after: 3}"), tmp_path / "run")
    assert code == 5
    faults = [e["name"] for e in node.events if e["event"] == "fault"]
    assert faults == ["cycles ran past their end, more in a row than the rig allows"], node.events


def test_after_being_stopped_and_continued_the_cycles_are_exact_and_in_phase(
    tmp_path: Path,
) -> None:
    bus, folder = own_bus(), tmp_path / "run"
    with Running(
        "run",
        str(RIGS / "slew10.yaml"),
        "--bus",
        bus,
        "-o",
        str(folder),
        "--quiet",
        "--no-figure",
        "--set",
        "supervisor.fault_after_cycles=5000",
        "--set",
        "duration_s=5.0",
    ) as process:
        block = process.in_the_middle("slew10", bus)
        plant, pid = process.block("slew10", bus, "plant"), process.pid("executive")

        def passed(node: sh.NodeMemory, cycles: int) -> None:
            begin = int(node.control.cycle)
            until(lambda: node.control.cycle > begin + cycles or process.over(), "it goes on")

        for _ in range(3):
            os.kill(pid, signal.SIGSTOP)
            passed(plant, 40)
            os.kill(pid, signal.SIGCONT)
            passed(block, 50)
        done = process.done()
    node = logs.read(folder / "log.mcap").node["executive"]
    assert node.cycle[-1] == 4999, f"the last cycle is {node.cycle[-1]}\n{done}"
    assert (np.diff(node.cycle) >= 1).all()
    skipped = int(node.timing["health.skipped_cycles"][-1])
    assert skipped == node.cycle[-1] - (len(node.cycle) - 1) >= 3 * 30, skipped
    due = node.stamp_ns - np.rint(1000.0 * node.timing["timing.wake_late_us"]).astype(np.int64)
    phase = np.unique((due[1:] - node.cycle[1:] * PERIOD_NS) - (due[1] - node.cycle[1] * PERIOD_NS))
    assert (phase == 0).all(), f"deadlines moved by {phase} ns"


def test_a_limit_of_lateness_decides_over_the_exit_code(tmp_path: Path) -> None:
    words = ("run", str(RIGS / "slew10.yaml"), "--json", "--quiet", "--no-figure", *PATIENT)
    done = pcpc(
        *words,
        "--set",
        "timing.error=0.000001",
        "--set",
        "duration_s=0.5",
        "--bus",
        own_bus(),
        "-o",
        str(tmp_path / "run"),
    )
    assert done.code in (1, 3), done
    assert done.summary["timing_level"] == "ERROR", done.summary
    assert any("at p99.9" in line for line in done.summary["expectations_failed"])


@pytest.mark.parametrize("node", ["executive", "plant"])
def test_statistics_of_a_running_node_are_in_its_table_and_reset(node: str, tmp_path: Path) -> None:
    bus, rig, folder = own_bus(), str(RIGS / "hull.yaml"), str(tmp_path / "run")
    words = ("--bus", bus, "-o", folder, "--quiet", "--no-figure", *PATIENT)
    with Running("run", rig, *words) as process:
        process.in_the_middle("hull", bus)
        block = process.block("hull", bus, node)
        until(lambda: block.control.cycle > 400, "400 cycles")
        names = ("timing.wake_late_p99_us", "timing.work_max_us")
        got = pcpc("get", *names, "--node", block.name, "--json")
        assert got.code == 0, got
        assert min(json.loads(got.out).values()) > 0.0, got
        assert pcpc("set", "timing.reset=1", "--node", block.name).code == 0

        def fewer_than_passed() -> bool:
            passes = int(block.control.passes)
            return bool(block["stages"][Stage.WAKE_LATE]["count"] < passes - 300)

        until(lambda: fewer_than_passed() or process.over(), "counting starts anew")
