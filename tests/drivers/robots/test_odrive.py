"""ODrive's CANSimple: frames against the DBC file of another's client, motion in closed form."""

import math
import struct

import numpy as np
import pytest
from benches import NODE, ODriveBench
from odrive_can.utils import get_dbc

from pcpc.drivers.canopen.node import Whose
from pcpc.drivers.robots import odrive_settings, settings
from pcpc.drivers.robots.odrive_settings import CommandId, Error, Key

DBC = get_dbc()
FAST = {"axis0.controller.config.vel_limit": 100.0}
GETS = {  # what a remote frame asks for
    "Get_Version": 0, "Heartbeat": 1, "Get_Error": 3, "Get_Encoder_Estimates": 9, "Get_Iq": 20,
    "Get_Temperature": 21, "Get_Bus_Voltage_Current": 23, "Get_Torques": 28, "Get_Powers": 29,
}  # fmt: skip


def decoded(name: str, data: bytes) -> dict[str, float]:
    """Return a frame of axis 5 as the client's DBC file has it."""
    return DBC.get_message_by_name(f"Axis{NODE}_{name}").decode(data, decode_choices=False)


def test_commands_have_the_ids_of_the_clients_file() -> None:
    names = {one.frame_id & 31: one.name for one in DBC.messages if one.frame_id >> 5 == NODE}
    assert {
        name.partition("_")[2]: GETS[name.partition("_")[2]]
        for i, name in names.items()
        if name.partition("_")[2] in GETS
    } == GETS
    assert set(CommandId) <= set(names), set(CommandId) - set(names)
    lengths = {one.frame_id & 31: one.length for one in DBC.messages if one.frame_id >> 5 == NODE}
    assert all(odrive_settings.LENGTHS[one] <= lengths[one] for one in CommandId)


@pytest.mark.parametrize("name", GETS)
def test_each_answer_says_what_it_should(name: str) -> None:
    bench = ODriveBench(FAST | {"vbus_voltage": 48.0, "axis0.config.motor.torque_constant": 0.5})
    bench.closed(1).do(0x0E, "f", 2.0)
    bench.cycles(100)
    power = 2.0 * bench.w * 2.0 * math.pi
    expected: dict[str, dict[str, float]] = {
        "Get_Version": {"Protocol_Version": 2, "Fw_Version_Minor": 6, "Fw_Version_Revision": 10},
        "Heartbeat": {"Axis_State": 8, "Axis_Error": 0, "Procedure_Result": 0},
        "Get_Error": {"Active_Errors": 0, "Disarm_Reason": 0},
        "Get_Encoder_Estimates": {"Pos_Estimate": bench.q, "Vel_Estimate": bench.w},
        "Get_Iq": {"Iq_Setpoint": 4.0, "Iq_Measured": 4.0},
        "Get_Temperature": {"FET_Temperature": 25.0, "Motor_Temperature": 25.0},
        "Get_Bus_Voltage_Current": {"Bus_Voltage": 48.0, "Bus_Current": power / 48.0},
        "Get_Torques": {"Torque_Target": 2.0, "Torque_Estimate": 2.0},
        "Get_Powers": {"Electrical_Power": power, "Mechanical_Power": power},
    }
    found = decoded(name, bench.ask(GETS[name]))
    for signal, value in expected[name].items():
        assert found[signal] == pytest.approx(value, rel=1e-6), (signal, found)


def test_what_is_sent_by_itself_has_its_period() -> None:
    bench = ODriveBench({"axis0.config.can.iq_msg_rate_ms": 7}).cycles(1000)
    counts = {i: sum(one[1] == NODE << 5 | i for one in bench.said) for i in range(32)}
    assert {i: n for i, n in counts.items() if n} == {1: 11, 9: 101, 20: 143}, counts


@pytest.mark.parametrize("before", ["idle", "closed", "error"])
@pytest.mark.parametrize("wanted", [*range(20), 2**32 - 1])
def test_each_state_is_reached_or_refused(before: str, wanted: int) -> None:
    bench = ODriveBench()
    if before != "idle":
        bench.closed()
    if before == "error":
        bench.do(CommandId.ESTOP)
    at = int(bench.x.power)
    bench.do(CommandId.STATE, "I", wanted)
    data = decoded("Heartbeat", bench.ask(1))
    if wanted == 8 and before == "error":
        expected = (1, 3)
    elif wanted in (1, 3, 4, 7):
        expected = (1, 0)
    elif wanted == 8:
        expected = (8, 0)
    else:
        expected = (at, 13)
    assert (data["Axis_State"], data["Procedure_Result"]) == expected
    refused = expected[1] != 0
    assert bench.mistakes() == ({"COMMAND_REFUSED": 1} if refused else {})


def test_torque_velocity_and_position_are_reached() -> None:
    bench = ODriveBench(FAST)
    bench.closed(1).do(0x0E, "f", 0.5)
    bench.cycles(1000)
    assert bench.w == pytest.approx(0.5 * 1.0, rel=1e-9), "constant torque, inertia 1, 1 s"
    bench.closed(2).do(0x0D, "ff", -3.0, 0.0)
    bench.cycles(3000)
    assert bench.w == pytest.approx(-3.0, abs=1e-3)
    bench.closed(3).do(0x0C, "fhh", 1.25, 0, 0)
    bench.cycles(4000)
    assert bench.q == pytest.approx(1.25, abs=1e-3) and bench.mistakes() == {}


def test_what_is_fed_forward_needs_no_error() -> None:
    bench = ODriveBench(FAST, drag=2.0)
    bench.d.gains = (0.0, 0.0, 0.0)
    bench.closed(3).do(0x0C, "fhh", 0.0, 0, 1500)
    bench.cycles(5000)
    assert bench.w == pytest.approx(1.5 / 2.0, rel=1e-3), "torque 1500 x 0.001 N m against drag"
    bench.closed(2).do(0x0D, "ff", 0.0, 3.0)
    bench.cycles(5000)
    assert bench.w == pytest.approx(3.0 / 2.0, rel=1e-3)


def test_a_trapezoid_takes_its_time() -> None:
    bench = ODriveBench(FAST | {"axis0.trap_traj.config.vel_limit": 2.0,
                                "axis0.trap_traj.config.accel_limit": 4.0,
                                "axis0.trap_traj.config.decel_limit": 8.0})  # fmt: skip
    bench.held = True
    bench.closed(3, 5).do(0x0C, "fhh", 3.0, 0, 0)
    way, done = [], 0
    for k in range(3000):
        bench.cycles(1)
        way.append(float(bench.x.way_position))
        done = done or (k if bench.x.arrived else 0)
    seconds = 2.0 / 4.0 + 2.0 / 8.0 + (3.0 - 0.5 - 0.25) / 2.0  # ramps take 1/2 and 1/4 turn
    assert done / 1000.0 == pytest.approx(seconds, abs=0.01), done
    v, a = np.diff(way) * 1000.0, np.diff(way, 2) * 1e6
    assert v.max() <= 2.0 + 1e-9 and a.max() <= 4.0 + 1e-6 and a.min() >= -8.0 - 2.0, a.min()
    assert way[-1] == 3.0 and max(way) <= 3.0


def test_the_filter_is_a_critically_damped_one() -> None:
    bench = ODriveBench(FAST | {"axis0.controller.config.input_filter_bandwidth": 10.0})
    bench.held = True
    bench.closed(3, 3).do(0x0C, "fhh", 1.0, 0, 0)
    for k in range(1, 600):
        bench.cycles(1)
        t = k * 1e-3
        exact = 1.0 - (1.0 + 10.0 * t) * math.exp(-10.0 * t)  # (1): both poles at -k/2
        assert bench.x.way_position == pytest.approx(exact, abs=0.01), k


def test_a_filter_is_no_faster_than_a_quarter_of_the_rate() -> None:
    ways = []
    for bandwidth in (1e4, 250.0, 249.0):
        bench = ODriveBench(FAST | {"axis0.controller.config.input_filter_bandwidth": bandwidth})
        bench.closed(3, 3).do(0x0C, "fhh", 1.0, 0, 0)
        bench.held = True
        ways.append([float(bench.cycles(1).x.way_position) for _ in range(20)])
    assert ways[0] == ways[1] != ways[2]


def test_ramps_of_velocity_and_torque_have_their_slope() -> None:
    bench = ODriveBench(FAST | {"axis0.controller.config.vel_ramp_rate": 5.0,
                                "axis0.controller.config.torque_ramp_rate": 2.0,
                                "axis0.controller.config.inertia": 0.25})  # fmt: skip
    bench.held = True
    bench.closed(2, 2).do(0x0D, "ff", 3.0, 0.0)
    bench.cycles(200)
    assert bench.x.way_velocity == pytest.approx(1.0) and bench.x.way_torque == pytest.approx(1.25)
    bench.closed(1, 6).do(0x0E, "f", -3.0)
    bench.x.way_torque = 0.0
    bench.cycles(500)
    assert bench.u == pytest.approx(-1.0)


def test_the_velocity_is_limited_in_all_modes() -> None:
    bench = ODriveBench({"axis0.controller.config.vel_limit": 2.0})
    bench.d.gains = (20.0, 10.0, 0.0)  # an integral overshoots, and more than 1.2 is an error
    bench.closed(2).do(0x0D, "ff", 30.0, 0.0)
    bench.cycles(3000)
    assert bench.w == pytest.approx(2.0, abs=1e-2) and bench.mistakes() == {"TARGET_CLIPPED": 1}
    bench.closed(1).do(0x0E, "f", 100.0)
    bench.cycles(2000)
    assert bench.w <= 2.0 * 1.2, "in torque mode, too"


@pytest.mark.parametrize(("command", "form"), [(0x0D, "ff"), (0x0E, "f")])
def test_a_target_at_its_limit_is_not_clipped(command: int, form: str) -> None:
    bench = ODriveBench({"axis0.config.motor.torque_constant": 0.5})
    bench.do(0x0F, "ff", 2.0, 4.0)  # 2 turns/s, 2 N m
    for target, clipped in ((2.0, 0), (-2.0, 0), (2.001, 1), (-2.001, 2)):
        bench.do(command, form, *(target, 0.0)[: len(form)])
        assert bench.mistakes().get("TARGET_CLIPPED", 0) == clipped, target


@pytest.mark.parametrize(("cause", "error"), [
    ("stop", Error.ESTOP), ("silence", Error.WATCHDOG), ("speed", Error.VELOCITY),
    ("mode", Error.BAD_CONFIG), ("input", Error.BAD_CONFIG),
])  # fmt: skip
def test_an_error_disarms_until_it_is_cleared(cause: str, error: int) -> None:
    bench = ODriveBench({"axis0.config.enable_watchdog": 1, "axis0.config.watchdog_timeout": 0.1})
    bench.closed(2).do(0x0D, "ff", 1.0, 0.0)
    bench.cycles(50)
    assert bench.u != 0.0
    if cause == "stop":
        bench.do(CommandId.ESTOP)
    elif cause == "speed":
        bench.w = 30.0
        bench.cycles(1)
    elif cause in ("mode", "input"):
        bench.do(CommandId.MODE, "II", *((0, 1) if cause == "mode" else (2, 5)))
    bench.cycles(60 if cause == "silence" else 1)
    data = decoded("Heartbeat", bench.ask(1))
    assert (data["Axis_State"], data["Axis_Error"]) == (1, error) and bench.u == 0.0, data
    assert decoded("Get_Error", bench.ask(3))["Disarm_Reason"] == error
    bench.w = 0.0
    bench.cycles(1)
    bench.do(CommandId.CLEAR, "B", 0)
    bench.closed(2)
    assert bench.cycles(1).x.power == 8
    assert ("SILENT" in bench.mistakes()) == (cause == "silence")


@pytest.mark.parametrize(("command", "form", "values"), [
    (0x0C, "fhh", (1.0, 0, 0)), (0x0D, "ff", (1.0, 0.0)), (0x0E, "f", (1.0,)), (0x07, "I", (8,)),
])  # fmt: skip
def test_a_master_that_speaks_is_not_silent(
    command: int, form: str, values: tuple[float, ...]
) -> None:
    starts = {"axis0.config.enable_watchdog": 1, "axis0.config.watchdog_timeout": 0.1}
    bench = ODriveBench(FAST | starts).closed()
    bench.held = True
    for _ in range(5):
        bench.cycles(90).send(NODE << 5 | command, struct.pack("<" + form, *values))
    assert bench.x.power == 8 and "SILENT" not in bench.mistakes()
    assert bench.cycles(102).x.power == 1 and bench.mistakes()["SILENT"] == 1


def test_settings_are_read_and_written_by_their_numbers() -> None:
    bench = ODriveBench()
    for i, one in enumerate(odrive_settings.SETTINGS):
        form, value = ("I", int(one.high)) if one.whole else ("f", 0.5)
        bench.do(4, "BHB" + form, 1, i, 0, value)
        (answer,) = bench.do(4, "BHBI", 0, i, 0, 0)
        number, found = struct.unpack("<xHx" + form, answer)
        assert number == i and found == (value if one.writable else one.start), one
    assert bench.mistakes() == {"VALUE_REFUSED": 2}
    bench = ODriveBench()
    for form, values in (
        ("BHBI", (0, len(odrive_settings.SETTINGS), 0, 0)),
        ("BHBI", (2, 0, 0, 0)),
        ("BHBI", (1, 0, 0, 65536)),
    ):
        assert bench.do(4, form, *values) == []
    assert bench.mistakes() == {"VALUE_REFUSED": 3}


def test_gains_limits_and_places_come_over_the_bus() -> None:
    bench = ODriveBench({"axis0.config.motor.torque_constant": 0.1})
    bench.r.velocity_scale = 0.25
    bench.do(0x1A, "f", 7.0)
    bench.do(0x1B, "ff", 2.0, 3.0)
    assert bench.d.gains.position_per_s == 7.0 and bench.x.regained == 1
    assert bench.d.gains.velocity == 2.0 * 0.25 and bench.d.gains.integral_per_s == 1.5
    bench.do(0x0F, "ff", 12.0, 30.0)
    assert bench.r.value[Key.VEL_LIMIT] == 12.0
    assert bench.r.value[Key.TORQUE_SOFT_MAX] == pytest.approx(3.0)
    bench.do(0x11, "f", 4.0)
    bench.do(0x12, "ff", 5.0, 6.0)
    bench.do(0x13, "f", 0.5)
    keys = (
        Key.TRAP_TRAJ_VEL_LIMIT,
        Key.TRAP_TRAJ_ACCEL_LIMIT,
        Key.TRAP_TRAJ_DECEL_LIMIT,
        Key.INERTIA,
    )
    assert [bench.r.value[one] for one in keys] == [4.0, 5.0, 6.0, 0.5]
    bench.do(0x19, "f", -4.5)
    bench.cycles(1)
    assert decoded("Get_Encoder_Estimates", bench.ask(9))["Pos_Estimate"] == -4.5
    bench.do(0x16, "B", 0)
    assert bench.r.value[Key.VEL_LIMIT] == 2.0 and bench.cycles(1).x.position == 0.0


@pytest.mark.parametrize(("command", "form", "values", "kind"), [
    (0x0C, "fhh", (math.nan, 0, 0), "NOT_FINITE"), (0x0D, "ff", (1.0, math.inf), "NOT_FINITE"),
    (0x0E, "f", (-math.inf,), "NOT_FINITE"), (0x0F, "ff", (math.nan, 1.0), "NOT_FINITE"),
    (0x19, "f", (math.nan,), "NOT_FINITE"), (0x1B, "ff", (-1.0, 0.0), "VALUE_REFUSED"),
    (0x0B, "II", (4, 1), "VALUE_REFUSED"), (0x0B, "II", (3, 7), "VALUE_REFUSED"),
    (0x06, "Q", (0,), "COMMAND_REFUSED"), (0x16, "B", (1,), "COMMAND_REFUSED"),
    (0x0A, "", (), "COMMAND_REFUSED"), (0x1F, "", (), "COMMAND_REFUSED"),
    (0x0C, "f", (1.0,), "FRAME_SHORT"), (0x07, "H", (8,), "FRAME_SHORT"),
])  # fmt: skip
def test_what_a_master_does_wrong_is_counted_and_has_no_effect(
    command: int, form: str, values: tuple[float, ...], kind: str
) -> None:
    bench = ODriveBench().closed()
    before = (bytes(bench.r.value), bytes(bench.r.state))
    assert bench.do(command, form, *values) == []
    assert bench.mistakes() == {kind: 1}
    assert (bytes(bench.r.value), bytes(bench.r.state)) == before


def test_whose_a_frame_is() -> None:
    bench = ODriveBench()
    for command in range(32):
        bench.send((NODE + 1) << 5 | command, bytes(8))
        assert bench.whose == Whose.OTHER
        bench.send(NODE << 5 | command | 1 << 31, bytes(8))
        assert bench.whose == Whose.OTHER, "an extended id is another"
        bench.send(NODE << 5 | command, bytes(8))
        twin = command in (0, 1, 3, 5, 9, 20, 21, 23, 28, 29)
        assert bench.whose == (Whose.TWIN if twin else Whose.OURS), command


def test_random_frames_leave_it_finite_and_alive() -> None:
    rng = np.random.default_rng(20261127)
    bench = ODriveBench(FAST)
    for _ in range(20_000):
        command = int(rng.integers(32))
        data = rng.bytes(int(rng.integers(9)))
        remote = int(rng.random() < 0.1) << 30
        bench.send(NODE << 5 | command | remote, data)
        if rng.random() < 0.3:
            bench.cycles(1)
            assert math.isfinite(bench.u), bench.x
            bench.q, bench.w = min(max(bench.q, -1e3), 1e3), min(max(bench.w, -1e3), 1e3)
    bench.w = 0.0
    bench.do(0x16, "B", 0)
    assert bench.closed(2).cycles(1).x.power == 8


def test_a_wrong_setting_is_named() -> None:
    for starts, said in (
        ({"vel_limit": 1.0}, "no such setting; axis0.controller.config.vel_limit, axis0.trap_traj"),
        ({"axis0.config.enable_watchdog": 0.5}, "0.5 is not a whole number from 0 to 1"),
        ({"axis0.controller.config.vel_limit": -1.0}, "-1 is not a number from 0"),
        ({"vbus_voltage": math.nan}, "nan is not a number"),
    ):
        with pytest.raises(ValueError, match=said):
            settings.changed_settings(odrive_settings.SETTINGS, starts)
