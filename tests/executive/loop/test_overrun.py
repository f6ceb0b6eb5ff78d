"""What follows when cycles run past their end, and what the loop counts about its own time."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine import SLEW10, Bench, both, puppet_rig, zeroed
from hypothesis import given, settings
from hypothesis import strategies as st

from pcpc.executive.errors import RigError
from pcpc.executive.loop import timing
from pcpc.executive.loop.buckets import OF_STAGES, end_of, place_of
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import FAULT_NAMES, Fault
from pcpc.executive.loop.timing_layout import Stage
from pcpc.executive.rig.reading import load_rig

PERIOD_NS = 1_000_000
STALL = 1_700_000  # ends one period and a half too late: one period is skipped
PATIENT = "supervisor: {fault_after_cycles: 50}"  # of frames; here only overruns matter


def bench(folder: Path, overrun: str, *more: str) -> Bench:
    """Return a bench whose executive has this policy."""
    return Bench(both(load_rig(puppet_rig(folder, f"overrun: {overrun}", PATIENT, *more))))


def test_fault_after_three_overruns_in_a_row(tmp_path: Path) -> None:
    made = bench(tmp_path, "{fault_after: 3, grace_s: 0.01}")
    made.run(20)
    made.run(6, late_ns=[STALL, STALL, 0, 0, STALL, STALL])
    assert made.executive.state == "RUN", "two in a row, a good one, two in a row"
    made.run(5, late_ns=[0, 0, STALL, STALL, STALL])
    made.run(2)
    assert made.executive.state == "FAULT"
    assert made.executive["supervisor.fault"] == Fault.OVERRUN
    assert "ran past their end" in FAULT_NAMES[Fault.OVERRUN]


def test_overruns_of_the_start_are_forgiven(tmp_path: Path) -> None:
    made = bench(tmp_path, "{fault_after: 2, grace_s: 0.02}")
    made.run(10, late_ns=[0, *[STALL] * 9])
    made.run(5)
    assert made.executive.state == "RUN", made.executive.state
    assert made.executive.count("skipped") == 9


@pytest.mark.parametrize(("stalled", "state"), [(9, "RUN"), (10, "FAULT")])
def test_the_grace_period_ends_with_its_last_cycle(
    tmp_path: Path, stalled: int, state: str
) -> None:
    made = bench(tmp_path, "{fault_after: 1, grace_s: 0.01}")
    late = [0] * 14
    late[stalled] = STALL
    made.run(len(late), late_ns=late)
    assert made.executive.state == state, f"a stall in cycle {stalled} with grace for 0 to 9"
    assert made.executive.count("skipped") == 1


@pytest.mark.parametrize(("stalls", "state"), [(2, "RUN"), (3, "FAULT")])
def test_a_fault_comes_after_exactly_so_many_overruns(
    tmp_path: Path, stalls: int, state: str
) -> None:
    made = bench(tmp_path, "{fault_after: 3, grace_s: 0.0}")
    made.run(10)
    made.run(8, late_ns=[STALL] * stalls)
    assert made.executive.state == state, f"{stalls} in a row, 3 allowed"


def test_without_a_policy_periods_are_skipped_and_nothing_else_happens(tmp_path: Path) -> None:
    made = Bench(both(load_rig(puppet_rig(tmp_path, PATIENT))))
    made.run(200)
    made.run(50, late_ns=[STALL] * 49)
    assert made.executive.state in ("RUN", "HOLD")
    assert made.executive.count("skipped") == 49
    assert made.executive["supervisor.fallback"] == 0.0


def test_the_fallback_takes_over_in_the_cycle_after_the_overrun_and_for_good(
    tmp_path: Path,
) -> None:
    made = bench(tmp_path, "{fallback: pd, fallback_after: 2, grace_s: 0.0}")
    node = made.executive
    node["controller.torque_Nm"] = 0.7
    made.run(20)
    assert node["tx.CMD.motor_torque"] == pytest.approx(0.7, abs=1e-9)
    made.run(2, late_ns=[STALL, STALL])
    assert node["supervisor.fallback"] == 0.0
    steps = node["controller.steps"]
    made.run(30)
    assert node["supervisor.fallback"] == 1.0
    assert node["controller.steps"] == steps, "the controller that is too slow is stepped no more"
    assert abs(node["tx.CMD.motor_torque"]) < 0.6, "the command is still the puppet's"
    assert node["controller.motor_torque_Nm"] == node["tx.CMD.motor_torque"]
    (cycle, behind, _), *others = node.events(Event.FALLBACK)
    assert not others and behind == 1, node.events(Event.FALLBACK)
    assert node.state == "RUN"
    assert cycle == 24, f"cycle {cycle}: two overruns after 20 cycles"


@pytest.mark.parametrize(
    ("overrun", "said"),
    [
        ("{fallback: pdd}", "did you mean pd"),
        ("{fallback: puppet}", "is the controller itself"),
        ("{fallback: pd, fault_after: 3}", "choose one of the two"),
        ("{fault_after: 0}", "fault_after"),
        ("{grace_s: -1.0}", "grace_s"),
    ],
)
def test_a_policy_that_cannot_be_is_refused_with_its_place(
    tmp_path: Path, overrun: str, said: str
) -> None:
    with pytest.raises(RigError, match=said) as refusal:
        load_rig(puppet_rig(tmp_path, f"overrun: {overrun}"))
    assert str(refusal.value).count("\n") == 0
    assert "puppet.yaml" in str(refusal.value)


def test_a_fallback_with_other_outputs_is_refused(tmp_path: Path) -> None:
    rig = load_rig(SLEW10, settings=["overrun.fallback=pd_nn_fast"])
    with pytest.raises(RigError, match="are not the first of the controller's"):
        both(rig)


# Statistics


@settings(max_examples=300, deadline=None, database=None)
@given(ns=st.one_of(st.integers(0, 100), st.integers(0, 2**40)))
def test_a_bucket_holds_its_value_and_is_an_eighth_wide(ns: int) -> None:
    i = place_of(ns, *OF_STAGES)
    end = end_of(i, OF_STAGES[0])
    assert ns <= end <= ns * 1.125 + 1, f"{ns} ns lie in a bucket that ends at {end}"
    assert i == 0 or end_of(i - 1, OF_STAGES[0]) < ns


def counted(lateness_ns: Any, work_ns: Any) -> Any:
    """Return a LOOP record that has counted cycles of these times."""
    n = zeroed()
    timing.reset(n)
    n.clock.late_ns, n.clock.period_ns = 100_000, PERIOD_NS
    for k, (late, work) in enumerate(zip(lateness_ns, work_ns, strict=True)):
        n.k = n.passes = k
        n.clock.deadline = k * PERIOD_NS
        n.clock.wake = n.clock.deadline + int(late)
        n.timing.received = n.timing.stepped = n.timing.sent = n.clock.wake
        n.timing.done = n.clock.wake + int(work)
        timing.count(n)
    timing.show(n)
    return n


def test_percentiles_of_the_table_are_numpys_to_an_eighth() -> None:
    rng = np.random.default_rng(3)
    late, work = (1e4 * rng.lognormal(0.0, 1.0, 3000)).astype(int), rng.integers(1e3, 9e4, 3000)
    n = counted(late, work)
    at = timing.STATISTICS_AT
    for values, shown in ((late, n.v[at : at + 6]), (work, n.v[at + 6 : at + 12])):
        expected = 1e-3 * np.array([values.min(), values.mean(), values.max()])
        assert np.allclose(shown[:3], expected, rtol=1e-12), (shown, expected)
        exact = 1e-3 * np.percentile(values, (50, 99, 99.9))
        assert (shown[3:] >= 0.99 * exact).all() and (shown[3:] <= 1.14 * exact).all(), (
            shown[3:],
            exact,
        )


def test_what_no_bucket_reaches_is_in_the_last_one() -> None:
    """A machine that was asleep for an hour, or a day, wakes that late."""
    n = counted([(1 << 41) - 1, 1 << 41, 1 << 47], [0, 0, 0])
    last = place_of(1 << 41, *OF_STAGES)
    assert n.histogram[Stage.WAKE_LATE, last] == 3 and not n.histogram[:, last + 1 :].any()


def test_the_latest_cycles_are_kept_whole() -> None:
    late = np.full(500, 20_000)
    late[[7, 70, 123, 124, 250, 251, 333, 400, 444, 490]] = np.arange(2, 12) * 100_000
    n = counted(late, np.full(500, 5_000))
    kept = {int(row.cycle): row for row in n.latest}
    assert set(kept) == {123, 124, 250, 251, 333, 400, 444, 490}, sorted(kept)
    assert int(kept[490].stage_ns[Stage.WAKE_LATE]) == 1_100_000
    assert int(kept[490].stage_ns[Stage.WORK]) == 5_000


def test_a_reset_starts_anew() -> None:
    n = counted(np.full(50, 70_000), np.full(50, 5_000))
    n.v[timing.RESET] = 1.0
    n.k = n.passes = 50
    n.clock.deadline = 50 * PERIOD_NS
    n.clock.wake = n.clock.deadline + 1_000
    n.timing.received = n.timing.stepped = n.timing.sent = n.clock.wake
    n.timing.done = n.clock.wake + 2_000
    timing.count(n)
    timing.show(n)
    at = timing.STATISTICS_AT
    assert n.v[timing.RESET] == 0.0
    assert (n.v[at], n.v[at + 2]) == (1.0, 1.0), n.v[at : at + 6]
    assert int(n.stages[Stage.WORK].count) == 1
