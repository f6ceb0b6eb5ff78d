"""A fault that waits is left by a reset, and a run is stopped: by request, signal or frame."""

import re
from pathlib import Path

import numpy as np
import pytest
from engine import ATB1000, LOST, Bench, both, puppet_rig
from replays import replayed

from pcpc.drivers.can.wire_layout import STRANGER
from pcpc.executive.errors import RigError
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.reception import take_frame
from pcpc.executive.loop.requests import Refusal
from pcpc.executive.loop.states import STATE_NAMES
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig

WAITS = "supervisor: {on_fault: wait, ramp_s: 0.01, quick_stop_s: 0.004}"
RAMP_CYCLES, QUICK_CYCLES = 10, 4
RESET, STOP = "supervisor.reset", "supervisor.stop"
ESTOP_DBC = {
    "BO_ 1793 HB": "BO_ 15 ESTOP: 1 Vector__XXX\n"
    ' SG_ pressed : 0|1@1+ (1,0) [0|1] "" EXEC,PLANT\n\n',
    'BA_ "GenMsgSendType" BO_ 1793 1;': 'BA_ "GenMsgSendType" BO_ 15 2;\n',
}  # lines that come before others


@pytest.fixture
def waiting(tmp_path: Path) -> Bench:
    """Return a closed loop that sends 1 N m, whose faults wait."""
    made = Bench(both(load_rig(puppet_rig(tmp_path, WAITS))))
    made.executive["controller.torque_Nm"] = 1.0
    assert made.run(10) == 10 and made.executive.state == "RUN"
    return made


def fault(bench: Bench) -> None:
    """Lose feedback until the executive faults, then let it ramp down."""
    bench.run(3, {"FB_A": LOST})
    assert bench.executive.state == "FAULT"
    assert bench.run(RAMP_CYCLES + 5) == RAMP_CYCLES + 5, "the node has ended"
    assert bench.executive["tx.CMD.motor_torque"] == 0.0


def test_a_reset_leads_back_to_RUN_and_the_command_rises_from_its_safe_value(
    waiting: Bench,
) -> None:
    fault(waiting)
    node = waiting.executive
    node.post({RESET: 1.0})
    waiting.run(1)
    assert node.loop.answer.refusal == Refusal.ACCEPTED
    assert node.state == "FAULT" and node[RESET] == 0.0, "heard once, for the next cycle"
    waiting.run(RAMP_CYCLES + 5)
    states = [STATE_NAMES[to] for _, to, _ in node.events(Event.STATE)]
    assert states[-4:] == ["FAULT", "INIT", "READY", "RUN"], states
    assert node["supervisor.fault"] == Fault.NONE
    sent = node.series("tx.CMD.motor_torque")[-RAMP_CYCLES - 6 :]
    assert np.allclose(np.diff(sent)[2:11], 0.1) and sent[-1] == 1.0, sent
    assert node.count("fault") == Fault.INPUT_MISSING, "a run that faulted stays one"


def test_a_reset_is_refused_while_the_ramp_lasts_and_without_a_fault(waiting: Bench) -> None:
    node = waiting.executive
    for _ in range(2):
        node.post({RESET: 1.0})
        waiting.run(1)
        assert node.loop.answer.refusal == Refusal.NO_RESET
        waiting.run(3, {"FB_A": LOST})
    assert node.state == "FAULT" and node["supervisor.gain"] > 0.0
    waiting.run(2 * RAMP_CYCLES)
    assert node.state == "FAULT"


def test_a_reset_that_comes_past_the_refusal_is_not_heard_while_the_ramp_lasts(
    waiting: Bench,
) -> None:
    """A schedule or a law may write it: nobody has judged that request."""
    node = waiting.executive
    waiting.run(3, {"FB_A": LOST})
    node[RESET] = 1.0
    waiting.run(1)
    assert node["supervisor.gain"] > 0.0 and node[RESET] == 0.0, "it is over"
    waiting.run(2 * RAMP_CYCLES)
    told = [code for _, code, _ in node.events(Event.FAULT)]
    assert told == [Fault.INPUT_MISSING] and node.state == "FAULT"


def test_a_reset_with_the_cause_still_there_is_the_same_fault_again(waiting: Bench) -> None:
    node = waiting.executive
    node["controller.other_Nm"] = np.nan
    waiting.run(RAMP_CYCLES + 5)
    assert node["supervisor.fault"] == Fault.OUTPUT_NOT_FINITE
    node.post({RESET: 1.0})
    waiting.run(5)
    assert node.state == "FAULT" and node["supervisor.fault"] == Fault.OUTPUT_NOT_FINITE
    told = [code for _, code, _ in node.events(Event.FAULT)]
    assert told == [Fault.OUTPUT_NOT_FINITE] * 2, "the reset that failed is told"
    node["controller.other_Nm"] = 0.0
    waiting.run(3)
    assert node.state == "FAULT", "a reset is an edge: what was asked before is over"
    node.post({RESET: 1.0})
    waiting.run(5)
    assert node.state == "RUN"


def test_a_reset_without_input_leaves_the_fault_as_it_was(waiting: Bench) -> None:
    fault(waiting)
    node = waiting.executive
    waiting.run(1, {"FB_A": LOST})
    node.post({RESET: 1.0})
    waiting.run(3, {"FB_A": LOST})
    waiting.run(5)
    assert node.state == "FAULT" and node["supervisor.fault"] == Fault.INPUT_MISSING


def test_the_plants_watchdog_is_reset_and_its_input_rises_from_the_safe_value(
    waiting: Bench,
) -> None:
    plant = waiting.plant
    waiting.run(20, {"CMD": LOST})
    assert plant.state == "FAULT" and plant["rx.CMD.motor_torque"] == 0.0
    plant.post({RESET: 1.0})
    waiting.run(RAMP_CYCLES + 10)
    assert plant.state == "RUN" and plant["rx.CMD.motor_torque"] == 1.0
    taken = plant.series("rx.CMD.motor_torque")[-RAMP_CYCLES - 10 :]
    assert np.diff(taken).max() < 0.1 + 1e-9, np.diff(taken)


def test_an_input_that_is_missing_while_it_rises_does_not_fall(waiting: Bench) -> None:
    plant = waiting.plant
    waiting.run(20, {"CMD": LOST})
    plant.post({RESET: 1.0})
    waiting.run(8)
    assert 0.2 < plant["rx.CMD.motor_torque"] < 0.9
    waiting.run(1, {"CMD": LOST})
    waiting.run(RAMP_CYCLES)
    taken = plant.series("rx.CMD.motor_torque")[-RAMP_CYCLES - 6 :]
    assert np.diff(taken).min() > -1e-9 and taken[-1] == 1.0, taken


def test_a_fault_while_the_command_rises_goes_down_from_where_it_is(waiting: Bench) -> None:
    fault(waiting)
    node = waiting.executive
    node.post({RESET: 1.0})
    waiting.run(8)
    risen = node["tx.CMD.motor_torque"]
    assert 0.3 < risen < 0.8, risen
    node["controller.torque_Nm"] = np.nan
    waiting.run(RAMP_CYCLES + 2)
    sent = node.series("tx.CMD.motor_torque")[-RAMP_CYCLES - 3 :]
    assert np.abs(np.diff(sent)).max() < 0.1 + 1e-9 and sent[-1] == 0.0, sent


def test_a_fault_that_does_not_wait_ends_the_node_as_before(tmp_path: Path) -> None:
    made = Bench(both(load_rig(puppet_rig(tmp_path, "supervisor: {ramp_s: 0.01}"))))
    made.run(10)
    assert made.run(100, {"FB_A": LOST}) < 20


@pytest.mark.parametrize(("how", "cycles"), [(1.0, 9), (2.0, 4)])
def test_a_stop_ramps_the_command_down_and_is_no_fault(
    tmp_path: Path, how: float, cycles: int
) -> None:
    slow = "executive: {limits: {CMD.motor_torque: {rate_per_s: 500.0, high: 2.0}}}"
    made = Bench(both(load_rig(puppet_rig(tmp_path, slow, WAITS))))
    node = made.executive
    node["controller.torque_Nm"] = 2.0
    made.run(10)
    node.loop.mail.lock = 1  # nobody can lock it
    node.post({STOP: how})
    done = made.run(100)
    assert done == cycles
    sent = node.series("tx.CMD.motor_torque")[-done:]
    assert np.abs(np.diff(sent)).max() <= 0.5 + 1e-12 and sent[-1] <= 0.5, sent
    assert node.count("fault") == Fault.NONE


def estop_rig(folder: Path, *keys: str) -> Path:
    """Write a rig with a frame ESTOP that no node of it sends."""
    text = (ATB1000 / "atb1000.dbc").read_text()
    text = text.replace('"EveryCycle","Cyclic"', '"EveryCycle","Cyclic","Event"')
    for line, more in ESTOP_DBC.items():
        assert text.count(line) == 1, line
        text = text.replace(line, more + line)
    (folder / "estop.dbc").write_text(text)
    stops = ", ".join(("on_fault: wait, ramp_s: 0.01, quick_stop_s: 0.004", *keys))
    return puppet_rig(folder, "dbc: estop.dbc", f"supervisor: {{{stops}}}")


def test_an_emergency_stop_is_a_fault_and_a_quick_stop_also_in_the_ramp_of_another(
    tmp_path: Path,
) -> None:
    made = Bench(both(load_rig(estop_rig(tmp_path, "estop: ESTOP.pressed"))))
    node = made.executive
    node["controller.torque_Nm"] = 1.0
    made.run(10)
    node["rx.ESTOP.pressed"] = 1.0
    made.run(QUICK_CYCLES + 1)
    assert node.state == "FAULT" and node["supervisor.fault"] == Fault.EMERGENCY_STOP
    assert node["tx.CMD.motor_torque"] == 0.0
    node.post({RESET: 1.0})
    made.run(3)
    assert node["supervisor.fault"] == Fault.EMERGENCY_STOP, "it is still pressed"
    node["rx.ESTOP.pressed"] = 0.0
    node.post({RESET: 1.0})
    made.run(RAMP_CYCLES + 4)
    assert node.state == "RUN" and node["tx.CMD.motor_torque"] == 1.0
    made.run(3, {"FB_A": LOST})
    assert node.state == "FAULT" and node["supervisor.gain"] == pytest.approx(1.0)
    made.run(1)
    node["rx.ESTOP.pressed"] = 1.0
    made.run(QUICK_CYCLES)
    assert node["tx.CMD.motor_torque"] == 0.0, "hurried"
    assert node["supervisor.fault"] == Fault.INPUT_MISSING, "the first fault is told"


def test_a_stop_frame_of_anybody_is_latched(tmp_path: Path) -> None:
    made = Bench(both(load_rig(estop_rig(tmp_path, "stop_frame: ESTOP"))))
    node = made.executive
    node["controller.torque_Nm"] = 1.0
    made.run(10)
    for source in (7, 9, STRANGER):  # whoever sends it
        node.loop.wire.source = source
        node.loop.wire.rx[:16] = [15, 0, 0, 0, 1, *[0] * 11]
        take_frame(node.loop)
    node.loop.wire.source = 0
    made.run(QUICK_CYCLES + 1)
    assert (node.state, node["supervisor.fault"]) == ("FAULT", Fault.STOP_FRAME)
    assert node["tx.CMD.motor_torque"] == 0.0 and node.count("foreign") == 0
    made.run(20)
    assert node.state == "FAULT"
    node.post({RESET: 1.0})
    made.run(5)
    assert node.state == "RUN"


def test_a_reset_and_a_stop_of_the_schedule_are_replayed_bit_for_bit(tmp_path: Path) -> None:
    lines = (
        "schedule: [{at_s: 0.05, set: {controller.torque_Nm: 1.0}},"
        " {at_s: 0.2, set: {supervisor.stop: 2}}]",
        "duration_s: 0.5",
    )
    rig = load_rig(puppet_rig(tmp_path, WAITS, *lines))
    simulate(rig, tmp_path / "log.mcap")
    for verdict in replayed(tmp_path / "log.mcap"):
        assert verdict.identical and 200 < verdict.cycles < 210, (verdict.cycles, verdict.first())


WRONG = {
    "estop: ESTOP.presed": "no node receives a signal ESTOP.presed; did you mean ESTOP.pressed",
    "stop_frame: CMD": "no node receives a frame of GenMsgSendType Event CMD",
    "peer_timeout_s: 0.001": "0.001 s is less than 2 periods, 0.002 s",
    "hold_cycles: 1": "expected a whole number >= 2, got 1",
    "fault_after_cycles: 1": "expected a whole number >= 2, got 1",
}


@pytest.mark.parametrize(("keys", "says"), WRONG.items())
def test_stops_that_cannot_be_and_timeouts_of_less_than_two_periods_are_refused(
    tmp_path: Path, keys: str, says: str
) -> None:
    path = estop_rig(tmp_path, keys)
    with pytest.raises(RigError) as error:
        plan(load_rig(path), "executive", "sync")
    where = rf"{re.escape(str(path))}:\d+:\d+: supervisor.{keys.partition(':')[0]}: "
    assert re.match(where + re.escape(says), str(error.value)), error.value
