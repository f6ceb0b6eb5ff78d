"""The pacing that a machine holds: chosen in a line, never against what was asked for."""

import select
import signal
from typing import Any

import numpy as np
import pytest

from pcpc.executive.loop import control
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.ring_layout import Ends, OfRecord
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.start import pace

RIG = "plants/probe/rig.yaml"
PC, TCG = "model name : AMD EPYC\n", "model name : QEMU TCG CPU version 2.5+\n"


def settled(
    pacing: str | None, *settings: str, slower: float = 1.0, cpu: str = PC, alone: bool = False
) -> tuple[str | None, str]:
    """Return the pacing and what is said."""
    rig = load_rig(RIG, None, settings, resolve=False)
    return pace.settle(pacing, rig, alone, slower, cpu)


@pytest.mark.parametrize("rate_hz", [1.0, 1000.0, 20000.0])
def test_a_present_machine_is_let_alone(rate_hz: float) -> None:
    for pacing in (None, "real", "sync", "lockstep"):
        assert settled(pacing, f"rate_hz={rate_hz}") == (pacing, "")


def test_an_emulated_processor_runs_in_lockstep_and_says_so() -> None:
    for slower, cpu in ((50.0, PC), (3.0, TCG)):
        assert settled(None, slower=slower, cpu=cpu) == (
            "lockstep",
            "this processor is emulated and holds 25 Hz, not 1000: pacing lockstep; "
            "on a clock with --set rate_hz=25 --pacing real",
        )
        assert settled(None, "rate_hz=25", slower=12.0, cpu=cpu) == (None, "")


def test_what_was_asked_for_is_done_with_a_warning() -> None:
    for pacing in ("real", "sync"):
        found, said = settled(pacing, cpu=TCG)
        assert found == pacing
        assert said.endswith(
            f"use --pacing lockstep, or --set rate_hz=25; pacing {pacing} as asked"
        )
    assert settled("lockstep", cpu=TCG) == ("lockstep", "")
    found, said = settled(None, cpu=TCG, alone=True)
    assert found is None and "use --pacing lockstep on all nodes, or" in said, said


def test_a_slow_machine_holds_a_lower_rate() -> None:
    assert settled(None, slower=11.0) == (None, "")
    found, said = settled(None, "rate_hz=5000", slower=11.0)
    assert found == "lockstep", said
    assert said.startswith(
        "this processor is 11 times slower than a PC and holds 4000 Hz, not 5000"
    )


def test_this_machine_is_measured_and_holds_a_low_rate() -> None:
    slower = pace.slowness()
    assert slower >= 1.0
    rig = load_rig(RIG, None, ["rate_hz=1"], resolve=False)
    assert pace.settle(None, rig, alone=False) == (None, "")


def test_a_processor_that_others_use_as_well_is_not_taken_for_an_emulated_one() -> None:
    alone, sum_s = pace.slowness(), pace.EMULATED * pace.SUM_S

    def stand_still(*_: object) -> None:
        """Let each sum stand still once at least, for longer than it would be emulated."""
        select.select([], [], [], 1.5 * sum_s * alone)
        if not over:  # one that is called late must not come again
            signal.setitimer(signal.ITIMER_REAL, 1e-4)

    over = False
    before = signal.signal(signal.SIGALRM, stand_still)
    try:
        signal.setitimer(signal.ITIMER_REAL, 1e-4)
        crowded = pace.slowness()
    finally:
        over = True
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert pace.is_emulated(crowded, PC) == pace.is_emulated(alone, PC), (crowded, alone)


class Block(dict[str, Any]):
    """What is asked of a node's memory."""

    control = control.blank()
    ends: Any


def node(fault: int, stall_ns: int) -> Any:
    """Return a node's block in a ring of 8 records that has gone round; one cycle was late."""
    stamps = np.cumsum([200_000 + (stall_ns if k == 17 else 0) for k in range(20)])
    record, ends = np.zeros((8, 3), np.int64), np.zeros(1, Ends.dtype)[0]
    record[np.arange(20) % 8, OfRecord.STAMP_NS] = stamps
    block = Block(record=record)
    block.control, block.ends = control.blank(), lambda ring: ends
    block.control.fault, ends.head = fault, 20
    return block


def test_a_fault_for_silence_names_limit_stall_and_setting() -> None:
    settings = ["rate_hz=5000", "supervisor.fault_after_cycles=3", "supervisor.hold_cycles=2"]
    rig = load_rig(RIG, None, settings, resolve=False)
    stalled = {"executive": node(Fault.INPUT_MISSING, 90_000), "plant": node(0, 2_200_000)}
    assert pace.silence(stalled, rig) == (
        "3 cycles are 0.6 ms, and here a cycle began 2.2 ms late, "
        "without SCHED_FIFO (see `pcpc doctor`); run it with --pacing lockstep, or allow for "
        "stalls: --set supervisor.hold_cycles=500 --set supervisor.fault_after_cycles=1000"
    )
    lost = {"executive": node(Fault.INPUT_MISSING, 90_000), "plant": node(0, 100_000)}
    assert pace.silence(lost, rig) == "3 cycles are 0.6 ms"
    assert pace.silence({"executive": node(0, 2_200_000)}, rig) == ""
