"""Stalls: whole periods are skipped and counted, the phase stays, the plant makes them up."""

from typing import Any

import numpy as np
import pytest
from engine import LOST, Bench, Node, zeroed
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pcpc.executive.loop.clock import Time, Trigger, arm
from pcpc.executive.loop.cycle import next_cycle
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.nodes.plan import Plan

PERIOD_NS = 1_000_000
DETERMINISTIC = settings(max_examples=40, derandomize=True, deadline=None)


@pytest.fixture(scope="module")
def clock() -> Any:
    """Return a LOOP record with a clock of 1 kHz and nothing else."""
    n = zeroed()
    n.clock.period_ns, n.clock.trigger, n.clock.kind = PERIOD_NS, Trigger.CLOCKED, Time.GIVEN
    return n


@DETERMINISTIC
@given(
    deadline=st.integers(0, 10**15),
    late=st.integers(-PERIOD_NS, 10**10),
    k=st.integers(0, 10**9),
    skipped=st.integers(0, 10**6),
)
def test_after_a_stall_whole_periods_are_skipped_and_counted(
    clock: Any, deadline: int, late: int, k: int, skipped: int
) -> None:
    n = clock
    n.clock.deadline, n.timing.done, n.k, n.passes = deadline, deadline + PERIOD_NS + late, k, 7
    n.control.skipped = skipped
    next_cycle(n)
    after, cycle, behind = int(n.clock.deadline), int(n.k), int(n.clock.behind)
    done = deadline + PERIOD_NS + late
    assert (after - deadline) % PERIOD_NS == 0, "the phase is lost"
    assert after - deadline == (cycle - k) * PERIOD_NS, "k and deadline disagree"
    assert behind == cycle - k - 1 == int(n.control.skipped) - skipped, f"{behind} skipped"
    assert after >= done, f"the next deadline is over already by {done - after} ns"
    assert behind == 0 or after - done <= PERIOD_NS, f"{after - done} ns: a period too many"
    assert int(n.passes) == 8


@DETERMINISTIC
@given(now=st.integers(0, 10**15), phase=st.integers(0, PERIOD_NS))
def test_the_first_deadline_is_soon_and_on_the_common_grid(
    clock: Any, now: int, phase: int
) -> None:
    n = clock
    n.clock.now_ns, n.clock.phase_ns = now, phase
    arm(n.clock)
    ahead = int(n.clock.deadline) - now
    assert (int(n.clock.deadline) - phase) % PERIOD_NS == 0, "off the grid"
    assert PERIOD_NS // 8 < ahead <= PERIOD_NS + PERIOD_NS // 8, f"{ahead} ns ahead"


def deadlines_of(node: Node) -> NDArray[np.int64]:
    """Return the deadline of each pass, ns."""
    late_ns = np.rint(1000.0 * node.series("timing.wake_late_us")).astype(np.int64)
    return np.asarray(node.records()[:, 1] - late_ns, np.int64)


@DETERMINISTIC
@given(late=st.lists(st.one_of(st.just(0), st.integers(0, 6 * PERIOD_NS)), max_size=40))
def test_under_random_stalls_no_period_has_two_cycles_and_none_is_uncounted(
    plans: tuple[Plan, Plan], late: list[int]
) -> None:
    bench = Bench(plans)
    bench.run(3)
    assert bench.run(len(late) + 3, late_ns=late) == len(late) + 3
    node = bench.executive
    cycle, wake, due = node.records()[:, 0], node.records()[:, 1], deadlines_of(node)
    assert (due == (cycle + 1) * PERIOD_NS).all(), "a deadline is off its cycle's place"
    assert (np.diff(cycle) >= 1).all() and (wake[1:] >= due[1:]).all()
    assert len(set((wake[1:] // PERIOD_NS).tolist())) == len(wake) - 1, "two cycles in a period"
    passes = np.arange(len(cycle))
    assert (node.series("health.skipped_cycles")[1:] == (cycle - passes)[1:]).all()
    assert node.count("late") == sum(ns > PERIOD_NS // 10 for ns in late)
    assert sum(n for _, n, _ in node.events(Event.SKIP)) == cycle[-1] - passes[-1]


def test_the_plant_makes_up_the_periods_it_owes_and_the_executive_does_not(
    clocked: tuple[Plan, Plan],
) -> None:
    steady, stalled = Bench(clocked), Bench(clocked)
    steady.run(40)
    stalled.run(20)
    stalled.run(13, late_ns=[7_100_000])
    a, b = steady.plant, stalled.plant
    skipped = b.count("skipped")
    assert skipped == stalled.executive.count("skipped") == 7, f"{skipped} periods"
    both_have, rows, others = np.intersect1d(
        a.records()[:, 0], b.records()[:, 0], return_indices=True
    )
    assert both_have[-1] == 40 and len(both_have) == 41 - 7, both_have
    for name in (v.name for v in b.plan.table.variables if v.name.startswith("barrel.x_")):
        one, other = a.series(name)[rows], b.series(name)[others]
        assert (one == other).all(), f"{name}: cycle {both_have[np.argmax(one != other)]}"
    steps = stalled.executive.series("controller.steps")[-1]
    cycles = stalled.executive.records()[-1, 0] + 1
    assert (steps, cycles) == (33, 40), f"{steps} steps, {cycles} cycles"
    phase = deadlines_of(b)[2:] % PERIOD_NS
    assert (phase == PERIOD_NS // 2).all(), f"phase {phase}"


def test_an_executive_that_dies_after_its_first_command_does_not_leave_the_plant_with_it(
    plans: tuple[Plan, Plan],
) -> None:
    bench = Bench(plans)
    bench.executive["controller.torque_Nm"] = 1.5
    bench.run(1)
    assert (bench.plant.state, bench.plant["rx.CMD.motor_torque"]) == ("READY", 1.5)
    bench.run(60, {"CMD": LOST})
    held, fault = bench.plant["barrel.x_held_Nm"], bench.plant.count("fault")
    assert fault == Fault.INPUT_MISSING and held == 0.0, f"fault {fault}, {held} N m held"
