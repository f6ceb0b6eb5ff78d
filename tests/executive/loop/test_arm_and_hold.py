"""An executive closes its loop when its operator says so, and holds without a fault."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from engine import LOST, Bench, both, puppet_rig
from replays import replayed

from pcpc.drivers.canopen.layout import Power
from pcpc.executive.batch.group import LaneGroup, NotInLanes
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.requests import Refusal
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.virtual import in_memory, simulate
from pcpc.executive.rig.reading import load_rig

DISARMED, SENT = "supervisor.disarmed", "tx.CMD.motor_torque"
RAMP_CYCLES = 10
MANUAL = "supervisor: {arm: manual, on_fault: wait, ramp_s: 0.01}"
BY_ITSELF = "supervisor: {ramp_s: 0.01}"

Made = Callable[..., Bench]


@pytest.fixture
def made(tmp_path: Path) -> Made:
    """Return a function that makes a bench of a law that wants 1 N m."""

    def bench(*lines: str) -> Bench:
        found = Bench(both(load_rig(puppet_rig(tmp_path, *lines))))
        found.executive["controller.torque_Nm"] = 1.0
        found.run(20)
        return found

    return bench


def course(bench: Bench, cycles: int, name: str = SENT) -> list[float]:
    """Return a variable of the executive in the next cycles."""
    found = []
    for _ in range(cycles):
        assert bench.run(1) == 1, "it has ended"
        found.append(bench.executive[name])
    return found


def test_with_arm_manual_it_waits_in_READY_with_safe_commands(made: Made) -> None:
    bench = made(MANUAL, "executive: {limits: {CMD.motor_torque: {safe: 0.25}}}")
    node = bench.executive
    assert node.state == "READY" and node[SENT] == 0.25 and node["supervisor.gain"] == 0.0
    assert node["controller.steps"] == 20.0, "the law computes along"
    assert bench.plant.state == "RUN", "its command is there, a safe one"
    node.post({DISARMED: 0.0})
    found = np.array(course(bench, 20))
    assert node.state == "RUN" and node.loop.answer.refusal == Refusal.ACCEPTED
    assert np.abs(np.diff([0.25, *found])).max() <= 0.75 / RAMP_CYCLES + 1e-12, found
    assert found[0] == 0.25 and found[-1] == 1.0, "from the cycle behind the one that took it"
    ready, run = [at for at, to, _ in node.events(Event.STATE) if to in (State.READY, State.RUN)]
    assert (ready, run) == (0, 21)


def test_a_hold_ramps_to_safe_values_and_what_follows_is_a_closed_loop_again(made: Made) -> None:
    bench = made(BY_ITSELF)
    node = bench.executive
    assert node.state == "RUN" and node[SENT] == 1.0
    node.post({DISARMED: 1.0})
    down = np.array(course(bench, 30))
    assert node.state == "READY" and node["supervisor.fault"] == Fault.NONE
    assert np.abs(np.diff([1.0, *down])).max() <= 1.0 / RAMP_CYCLES + 1e-12
    assert down[0] == 1.0 and down[12:].tolist() == [0.0] * 18, down
    assert node["controller.steps"] == 50.0 and node["time.t_s"] == 0.049, "all goes on"
    node.post({DISARMED: 0.0})
    up = np.array(course(bench, 30))
    assert node.state == "RUN" and up[-1] == 1.0
    assert np.abs(np.diff([0.0, *up])).max() <= 1.0 / RAMP_CYCLES + 1e-12
    assert node.count("held") == 0 and not node.events(Event.FAULT)


def test_a_hold_that_is_taken_back_on_its_way_has_no_step(made: Made) -> None:
    bench = made(BY_ITSELF)
    bench.executive.post({DISARMED: 1.0})
    down = course(bench, 6)
    bench.executive.post({DISARMED: 0.0})
    found = np.array([*down, *course(bench, 20)])
    assert 0.0 < found.min() < 1.0 and found[-1] == 1.0, found
    assert np.abs(np.diff(found)).max() <= 1.0 / RAMP_CYCLES + 1e-12, found


def test_a_hold_keeps_to_the_rate_of_the_slowest_command(made: Made) -> None:
    limit = "executive: {limits: {CMD.motor_torque: {rate_per_s: 20.0}}}"
    bench = made(BY_ITSELF, limit)
    bench.run(60)
    bench.executive.post({DISARMED: 1.0})
    down = np.array([1.0, *course(bench, 80)])
    assert np.abs(np.diff(down)).max() <= 0.02 + 1e-12 and down[-1] == 0.0, down


@pytest.mark.parametrize("arm", ["manual", "automatic"])
def test_behind_a_fault_it_is_armed_as_the_rig_says(made: Made, arm: str) -> None:
    bench = made(MANUAL.replace("manual", arm))
    node = bench.executive
    node.post({DISARMED: 0.0})
    bench.run(20)
    assert node.state == "RUN"
    bench.run(3, {"FB_A": LOST})
    bench.run(RAMP_CYCLES + 5)
    assert node.state == "FAULT"
    node.post({"supervisor.reset": 1.0})
    bench.run(30)
    by_hand = arm == "manual"
    assert node.state == ("READY" if by_hand else "RUN") and node[DISARMED] == by_hand
    assert node[SENT] == (0.0 if by_hand else 1.0)
    node.post({DISARMED: 0.0})
    bench.run(20)
    assert node.state == "RUN" and node[SENT] == 1.0


def test_silence_is_a_fault_also_of_who_waits(made: Made) -> None:
    bench = made(MANUAL)
    bench.run(5, {"FB_A": LOST})
    node = bench.executive
    assert (node.state, node["supervisor.fault"]) == ("FAULT", Fault.INPUT_MISSING)
    assert node[SENT] == 0.0


@pytest.mark.parametrize("held", [2, 20, 80])
def test_a_run_that_is_held_ends_in_order(made: Made, held: int) -> None:
    bench = made(BY_ITSELF, "executive: {limits: {CMD.motor_torque: {rate_per_s: 20.0}}}")
    bench.run(60)
    node = bench.executive
    node.post({DISARMED: 1.0})
    bench.run(held)
    node.loop.control.stop = 1
    bench.run(80)
    assert node.state == "STOP" and abs(node[SENT]) <= 0.02, "safe in the next frame"
    assert node.count("fault") == Fault.NONE


def test_as_a_drive_it_is_ready_and_switched_on_on_its_way(made: Made) -> None:
    bench = made(BY_ITSELF)
    bench.executive.post({DISARMED: 1.0})
    bench.run(5)
    assert bench.executive["supervisor.status_word"] == Power.SWITCHED_ON.word
    bench.run(20)
    assert bench.executive["supervisor.status_word"] == Power.READY_TO_SWITCH_ON.word


def test_only_an_executive_is_held(made: Made) -> None:
    bench = made(BY_ITSELF)
    bench.plant.post({DISARMED: 1.0})
    bench.run(5)
    assert bench.plant.loop.answer.refusal == Refusal.OUT_OF_RANGE and bench.plant.state == "RUN"


def arms(*moments: tuple[float, int]) -> str:
    told = (f"{{at_s: {at}, set: {{{DISARMED}: {value}}}}}" for at, value in moments)
    return f"schedule: [{', '.join(told)}]"


@pytest.mark.parametrize("ends", [0.5, 0.305, 0.4])
def test_arming_and_holding_are_replayed_bit_for_bit(tmp_path: Path, ends: float) -> None:
    schedule = arms((0.1, 0), (0.3, 1), (0.45, 0))
    path = puppet_rig(tmp_path, MANUAL, schedule, f"duration_s: {ends}")
    rig = load_rig(path, settings=["controller.torque_Nm=1.0"])
    simulate(rig, tmp_path / "log.mcap")
    node = in_memory(rig).node["executive"].columns
    assert node["supervisor.gain"][:100].max() == 0.0 < node["supervisor.gain"][250] == 1.0
    for verdict in replayed(tmp_path / "log.mcap"):
        assert verdict.identical and verdict.cycles >= 1000 * ends, verdict.first()


def test_runs_that_are_armed_by_hand_are_done_one_by_one(tmp_path: Path) -> None:
    with pytest.raises(NotInLanes, match="armed by hand"):
        LaneGroup(load_rig(puppet_rig(tmp_path, MANUAL)), {})
    with pytest.raises(NotInLanes, match="schedule"):
        LaneGroup(load_rig(puppet_rig(tmp_path, BY_ITSELF, arms((0.1, 1)))), {})
