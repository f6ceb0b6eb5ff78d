"""The node as a drive: status word and emergency frame as a DBC of the rig asks for them."""

from pathlib import Path

import numpy as np
import pytest
from engine import ATB1000, LOST, Bench, both, puppet_rig

from pcpc.drivers.canopen.layout import LIMITED, WARNING, ErrorRegister, Power
from pcpc.executive.batch.group import LaneGroup, NotInLanes
from pcpc.executive.errors import RigError
from pcpc.executive.loop.faults import ERROR_CODES, ERROR_REGISTERS, Fault
from pcpc.executive.loop.ring_layout import FRAME_WORDS, OfFrame
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import load_rig

STATUS = """BO_ 385 STATUS: 2 EXEC
 SG_ word : 0|16@1+ (1,0) [0|65535] "" PLANT

"""
EMERGENCY = """BO_ 129 EMCY: 8 EXEC
 SG_ error_code : 0|16@1+ (1,0) [0|65535] "" PLANT
 SG_ error_register : 16|8@1+ (1,0) [0|255] "" PLANT

"""
WIRED = (
    "executive: {limits: {CMD.motor_torque: {rate_per_s: 1000.0}},"
    " transmit: {STATUS.word: supervisor.status_word,"
    " EMCY.error_code: supervisor.error_code, EMCY.error_register: supervisor.error_register}}"
)
WAITS = "supervisor: {on_fault: wait, ramp_s: 0.01}"
EMCY_ID = 129


def drive_rig(folder: Path, wired: str = WIRED, emergency: str = EMERGENCY) -> Path:
    """Write a rig whose DBC has a status word in every cycle, and an emergency frame."""
    text = (ATB1000 / "atb1000.dbc").read_text()
    text = text.replace('"EveryCycle","Cyclic"', '"EveryCycle","Cyclic","Event"')
    number = emergency.split()[1] if emergency else "129"
    kinds = f'BA_ "GenMsgSendType" BO_ 385 0;\nBA_ "GenMsgSendType" BO_ {number} 2;\n'
    for line, more in (
        ("BO_ 1793 HB", STATUS + emergency),
        ('BA_ "GenMsgSendType" BO_ 1793 1;', kinds),
    ):
        assert text.count(line) == 1, line
        text = text.replace(line, more + line)
    (folder / "drive.dbc").write_text(text)
    return puppet_rig(folder, "dbc: drive.dbc", WAITS, wired)


@pytest.fixture
def driven(tmp_path: Path) -> Bench:
    """Return a closed loop whose executive tells what it is as a drive."""
    made = Bench(both(load_rig(drive_rig(tmp_path))))
    made.executive["controller.torque_Nm"] = 1.0
    return made


def emergencies(bench: Bench) -> list[tuple[int, int, int]]:
    """Return (cycle, error code, register) of every emergency frame that was sent."""
    n = bench.executive.loop
    rows = n.frame.reshape(-1, FRAME_WORDS)[: int(n.frame_ends.head)]
    sent = rows[rows[:, OfFrame.ABOUT] & 0x7FF == EMCY_ID]
    data = sent[:, [OfFrame.CYCLE, OfFrame.PAYLOAD]].tolist()
    return [(cycle, word & 0xFFFF, word >> 16 & 0xFF) for cycle, word in data]


def test_the_status_word_goes_through_the_states_of_a_drive(driven: Bench) -> None:
    node, seen = driven.executive, []

    def go(cycles: int, **lost: int) -> None:
        for _ in range(cycles):
            driven.run(1, lost)
            seen.append(int(node["tx.STATUS.word"]))

    go(5)
    go(1, FB_A=LOST)
    go(2)
    go(3, FB_A=LOST)
    go(12)
    node.post({"supervisor.reset": 1.0})
    go(15)
    node["controller.torque_Nm"] = 50.0
    go(3)
    node.post({"supervisor.stop": 1.0})
    go(4)
    short = [word for i, word in enumerate(seen) if i == 0 or word != seen[i - 1]]
    enabled, held = Power.OPERATION_ENABLED.word, Power.OPERATION_ENABLED.word | WARNING
    limited = LIMITED
    assert short == [
        Power.READY_TO_SWITCH_ON.word, enabled, held, enabled, held,
        Power.FAULT_REACTION_ACTIVE.word, Power.FAULT.word,
        Power.SWITCH_ON_DISABLED.word, Power.READY_TO_SWITCH_ON.word, Power.SWITCHED_ON.word,
        enabled,
        enabled | limited, Power.QUICK_STOP_ACTIVE.word | limited, Power.QUICK_STOP_ACTIVE.word,
    ], [hex(word) for word in short]  # fmt: skip
    assert driven.plant["rx.STATUS.word"] == seen[-1]


def test_an_emergency_frame_is_sent_once_for_a_fault_and_once_for_its_end(driven: Bench) -> None:
    node = driven.executive
    driven.run(20)
    assert emergencies(driven) == []
    node["controller.other_Nm"] = np.nan
    driven.run(15)
    fault = Fault.OUTPUT_NOT_FINITE
    assert emergencies(driven) == [(21, fault.code, fault.code.register)]
    assert driven.plant["rx.EMCY.error_code"] == fault.code
    node.post({"supervisor.reset": 1.0})
    driven.run(5)
    assert len(emergencies(driven)) == 1, "a reset that failed is no news"
    node["controller.other_Nm"] = 0.0
    node.post({"supervisor.reset": 1.0})
    driven.run(5)
    assert [what[1:] for what in emergencies(driven)[1:]] == [(0, 0)]


def test_before_the_first_input_a_drive_is_not_ready(tmp_path: Path) -> None:
    made = Bench(both(load_rig(drive_rig(tmp_path))))
    made.executive.loop.rx.loss["enter"][:] = 1.0
    made.run(1)
    assert made.executive["tx.STATUS.word"] == Power.NOT_READY.word


def test_another_frame_of_send_type_Event_is_refused(tmp_path: Path) -> None:
    path = drive_rig(tmp_path, "executive: {}", EMERGENCY.replace("129", "600"))
    with pytest.raises(RigError, match="no node sends EMCY, of send type Event"):
        plan(load_rig(path), "executive", "sync")


def test_a_rig_with_a_status_word_runs_alone_not_in_lanes(tmp_path: Path) -> None:
    with pytest.raises(NotInLanes, match="emergency frame"):
        LaneGroup(load_rig(drive_rig(tmp_path)), {})


def test_every_fault_has_an_error_code_of_CiA_301(tmp_path: Path) -> None:
    assert ERROR_CODES[0] == ERROR_REGISTERS[0] == 0.0
    for fault in list(Fault)[1:]:
        assert 0x1000 <= fault.code <= 0xFFFF and fault.code.register & 1, fault
        assert (fault.code >> 8 in (0x81, 0x82)) == (
            fault.code.register == ErrorRegister.COMMUNICATION
        ), fault


def test_an_emergency_frame_waits_until_the_controller_is_back_on_the_bus(driven: Bench) -> None:
    node = driven.executive
    driven.run(20)
    node.loop.guard.off = 1
    driven.run(15)
    fault = Fault.BUS_OFF
    assert node["supervisor.fault"] == Fault.BUS_OFF and emergencies(driven) == []
    node.loop.guard.off = 0
    driven.run(3)
    assert [what[1:] for what in emergencies(driven)] == [(fault.code, fault.code.register)]
