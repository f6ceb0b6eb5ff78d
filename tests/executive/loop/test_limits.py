"""What is sent: finite, within range and rate, and safe in its own time."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine import LOST, Bench, Node, both, puppet_rig
from hypothesis import given, settings
from hypothesis import strategies as st

from pcpc.drivers.compiled.jit import i8, loop
from pcpc.executive.loop.cycle import N, finish
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import FAULT_NAMES, Fault
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.rig.reading import load_rig

RUN, FAULT = State.RUN, State.FAULT
RAMP_CYCLES = 50  # 50 ms
DETERMINISTIC = settings(max_examples=40, derandomize=True, deadline=None)


def end(node: Node) -> None:
    """Send the last frames."""
    _finish(node.loop)


@loop(i8(N))
def _finish(n: Any) -> Any:
    finish(n)
    return 0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e305])
def test_a_command_that_is_not_finite_is_replaced_by_the_last_one_and_a_FAULT(
    bench: Bench, value: float
) -> None:
    node = bench.executive
    node["controller.torque_Nm"] = value
    bench.run(1)
    assert node["tx.CMD.motor_torque"] == 1.0, node["tx.CMD.motor_torque"]
    bench.run(1)
    assert node.state == "FAULT" and node.count("fault") == Fault.COMMAND_NOT_FINITE
    assert bench.run(100) == RAMP_CYCLES
    sent = node.series("tx.CMD.motor_torque")[10:]
    assert np.isfinite(sent).all() and (np.diff(sent) <= 0.0).all() and sent[-1] == 0.0, sent


def test_every_recorded_NaN_is_the_same_one(bench: Bench) -> None:
    node = bench.executive
    odd = np.array([0xFFF8DEADBEEF0001], np.uint64).view(np.float64)
    node.loop.v[node.place("controller.torque_Nm")] = odd[0]
    raw = node.loop.v.view(np.uint64)[node.place("controller.torque_Nm")]
    assert raw == 0xFFF8DEADBEEF0001, f"{raw:x}"
    bench.run(1)
    recorded = node.series("controller.motor_torque_Nm").view(np.uint64)[-1]
    assert recorded == 0x7FF8000000000000, f"{recorded:x}"


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e300])
def test_a_signal_without_limits_that_is_not_finite_is_a_FAULT_that_names_it(
    bench: Bench, value: float
) -> None:
    node = bench.executive
    node["controller.other_Nm"] = value
    bench.run(1)
    assert node.state == "RUN" and node["tx.CMD.motor_torque"] == 1.0
    bench.run(1)
    assert node.state == "FAULT" and node.count("fault") == Fault.OUTPUT_NOT_FINITE
    ((cycle, place, seen),) = node.events(Event.NOT_FINITE)
    assert (cycle, place) == (10, node.place("controller.tau_Nm"))
    assert seen == value or (math.isnan(seen) and math.isnan(value))
    assert bench.run(100) == RAMP_CYCLES, "the command's ramp to its safe value"
    assert node.series("tx.CMD.motor_torque")[-1] == 0.0


def test_a_plant_that_diverges_is_a_fault_of_the_plant(bench: Bench) -> None:
    plant = bench.plant
    for name in (v.name for v in plant.plan.table.variables if v.name.startswith("barrel.x_")):
        plant[name] = math.nan
    bench.run(RAMP_CYCLES + 5)
    assert plant.count("fault") == Fault.PLANT_NOT_FINITE, FAULT_NAMES[plant.count("fault")]
    place = plant.events(Event.NOT_FINITE)[0][1]
    assert plant.plan.names[place].startswith("barrel."), plant.plan.names[place]


def test_a_value_that_is_not_finite_in_the_last_cycle_is_a_fault_too(
    plans: tuple[Plan, Plan],
) -> None:
    bench = Bench(plans)
    node = bench.executive
    node["controller.other_Nm"] = math.nan
    node.loop.guard.cycles = 1
    assert bench.run(5) == 0, "the run is over with the first cycle"
    end(node)
    assert node.count("fault") == Fault.OUTPUT_NOT_FINITE


@pytest.mark.parametrize(("wanted", "sent"), [(5.0, 2.0), (-5.0, -2.0), (2.0, 2.0), (1.5, 1.5)])
def test_a_command_is_clamped_flagged_and_counted(bench: Bench, wanted: float, sent: float) -> None:
    node, clamped = bench.executive, wanted != sent
    node["controller.torque_Nm"] = wanted
    bench.run(1)
    assert node["tx.CMD.motor_torque"] == sent and node["supervisor.saturated"] == clamped
    bench.run(1)
    assert bench.plant["rx.CMD.flags"] == clamped and bench.plant["rx.CMD.motor_torque"] == sent
    assert node.count("saturated") == 2 * clamped
    node["controller.torque_Nm"] = 0.5
    bench.run(2)
    assert node["supervisor.saturated"] == 0 and bench.plant["rx.CMD.flags"] == 0


@pytest.fixture(scope="module")
def rate_limited(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, Plan]:
    """Return plans whose command changes by at most 0.125 N m a cycle, within -1..2 N m."""
    limit = "executive: {limits: {CMD.motor_torque: {low: -1.0, high: 2.0, rate_per_s: 125.0}}}"
    return both(load_rig(puppet_rig(tmp_path_factory.mktemp("puppet"), limit)))


@DETERMINISTIC
@given(wanted=st.lists(st.floats(-4.0, 4.0), min_size=1, max_size=30))
def test_what_is_sent_is_the_nearest_value_within_range_and_rate(
    rate_limited: tuple[Plan, Plan], wanted: list[float]
) -> None:
    bench = Bench(rate_limited)
    node, last = bench.executive, 0.0
    change = float(node.loop.limits.table[0].rate)
    assert math.isclose(change, 0.125, rel_tol=1e-12), change
    for value in wanted[:8]:
        node["controller.torque_Nm"] = value
        bench.run(1)
        sent = node["tx.CMD.motor_torque"]
        nearest = min(max(min(max(value, -1.0), 2.0), last - change), last + change)
        assert sent == nearest, f"wanted {value}, last {last}: sent {sent}, not {nearest}"
        assert node["supervisor.saturated"] == (sent != value)
        last = sent


RATE = 0.125  # N m a cycle


def ways(*lines: str) -> str:
    """Return limits of the command: a slow one, and what else the test wants."""
    return ", ".join(("rate_per_s: 125.0", *lines))


@pytest.mark.parametrize(
    ("limits", "safe"),
    [
        (ways("low: -1.0", "high: 2.0"), 0.0),
        (ways("low: -1.0", "high: 2.0", "safe: -0.7"), -0.7),
        (ways("low: 0.3", "high: 2.0"), 0.3),
        (ways("low: -3.0", "high: -0.5"), -0.5),
        ("safe: 0.25", 0.25),
        ("low: 0.5, high: 2.0", 0.5),
    ],
)
@pytest.mark.parametrize("why", ["duration", "stop", "fault"])
def test_a_command_goes_to_its_safe_value_within_range_and_rate(
    tmp_path: Path, limits: str, safe: float, why: str
) -> None:
    text = f"executive: {{limits: {{CMD.motor_torque: {{{limits}}}}}}}"
    made = Bench(both(load_rig(puppet_rig(tmp_path, text, "supervisor: {ramp_s: 0.002}"))))
    node = made.executive
    low, high, rate = map(float, node.loop.limits.table[0].tolist()[:3])
    node["controller.torque_Nm"] = -5.0 if safe < 0.0 and low < safe - 1.0 else 1.9
    made.run(40)
    before = node["tx.CMD.motor_torque"]
    assert abs(before - safe) > 1.0, f"{before}: the test has nothing to ramp"
    done = 40
    if why == "duration":
        node.loop.guard.cycles = done
        node.loop.k = done
    elif why == "stop":
        node.loop.control.stop = 1
    else:
        node["controller.torque_Nm"] = math.nan
    made.run(100)
    end(node)
    sent = np.append(node.series("tx.CMD.motor_torque"), node["tx.CMD.motor_torque"])
    assert sent[-1] == pytest.approx(safe, abs=1e-12), sent[-5:]
    assert (sent[done:] >= low).all() and (sent[done:] <= high).all()
    # the first cycle begins at the safe value
    change = np.abs(np.diff(sent, prepend=safe))
    assert (change <= rate * (1.0 + 1e-12)).all(), f"{change.max()} a cycle, limit {rate}"
    states = set(node.series("supervisor.state")[done:].astype(int).tolist())
    assert states <= ({RUN, FAULT} if why == "fault" else {RUN}), states
    assert (node.count("fault") == Fault.NONE) == (why != "fault")
    assert why == "fault" or math.isfinite(rate) or len(sent) == done + 1, "cycles more"


def test_before_the_first_valid_input_a_command_is_safe(plans: tuple[Plan, Plan]) -> None:
    made = Bench(plans)
    node = made.executive
    node["controller.torque_Nm"] = 1.5
    node.loop.rx.loss["enter"][:] = 1.0  # of every frame the first is lost
    assert made.run(1) == 1
    assert (node.state, node["tx.CMD.motor_torque"]) == ("INIT", 0.0)
    node.loop.rx.loss["enter"][:] = 0.0
    made.run(1)
    assert (node.state, node["tx.CMD.motor_torque"]) == ("READY", 1.5)


def test_what_a_plant_sends_may_have_a_safe_value_too(tmp_path: Path) -> None:
    limits = "plant: {limits: {FB_A.hub_rate: {safe: 0.5, low: -3.0, high: 3.0}}}"
    made = Bench(both(load_rig(puppet_rig(tmp_path, limits, "supervisor: {on_fault: wait}"))))
    plant = made.plant
    made.run(10)
    assert plant["tx.FB_A.hub_rate"] == plant["barrel.hub_rate_rad_s"] != 0.5
    assert plant["rx.CMD.mode"] == RUN
    made.run(RAMP_CYCLES + 5, {"CMD": LOST})
    assert plant.state == "FAULT" and plant["tx.FB_A.hub_rate"] == 0.5
    assert made.executive["rx.FB_A.hub_rate"] == pytest.approx(0.5, abs=1e-4)
