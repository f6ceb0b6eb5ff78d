"""The register protocol of moteus: bits against its own client, motion in closed form."""

import io
import math
from typing import Any

import moteus
import numpy as np
import pytest
from benches import NODE, MoteusBench
from moteus import multiplex as mp
from moteus.protocol import Mode, Register, Writer, parse_registers, scale_register

from pcpc.drivers.canopen.node import Whose
from pcpc.drivers.compiled.rows import Flag
from pcpc.drivers.robots import moteus_registers, settings
from pcpc.drivers.robots.moteus_registers import KIND, SCALES, Key

RESOLUTIONS = {"int8": mp.INT8, "int16": mp.INT16, "int32": mp.INT32, "float": mp.F32}
LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
FREE = {"servo.default_timeout_s": 1e9}
CLIENT = moteus.Controller(id=NODE)
SENT = {  # of a position command: value, row, what the client writes it with
    "position": (-0.7, Key.POSITION, Writer.write_position),
    "velocity": (1.25, Key.VELOCITY, Writer.write_velocity),
    "feedforward_torque": (-3.5, Key.FEEDFORWARD_TORQUE, Writer.write_torque),
    "kp_scale": (0.25, Key.KP_SCALE, Writer.write_pwm),
    "kd_scale": (0.75, Key.KD_SCALE, Writer.write_pwm),
    "maximum_torque": (12.0, Key.MAXIMUM_TORQUE, Writer.write_torque),
    "stop_position": (1.1, Key.STOP_POSITION, Writer.write_position),
    "watchdog_timeout": (0.4, Key.WATCHDOG_TIMEOUT, Writer.write_time),
    "velocity_limit": (2.5, Key.VELOCITY_LIMIT, Writer.write_velocity),
    "accel_limit": (3.0, Key.ACCEL_LIMIT, Writer.write_accel),
    "fixed_voltage_override": (7.5, Key.FIXED_VOLTAGE_OVERRIDE, Writer.write_voltage),
    "ilimit_scale": (0.5, Key.ILIMIT_SCALE, Writer.write_pwm),
    "fixed_current_override": (2.0, Key.FIXED_CURRENT_OVERRIDE, Writer.write_current),
    "ignore_position_bounds": (1, Key.IGNORE_POSITION_BOUNDS, Writer.write_int),
}


def of_all(kind: Any, resolution: int) -> Any:
    """Return the resolutions of a command or a query, all alike."""
    made = kind()
    for name in vars(kind):
        if not name.startswith("_"):
            setattr(made, name, resolution)
    return made


def as_sent(value: float, resolution: int, write: Any, register: int) -> float:
    """Return what the client makes of a value and reads again."""
    buffer = io.BytesIO()
    write(Writer(buffer), value, resolution)
    (raw,) = mp.TYPES[resolution].unpack(buffer.getvalue())
    return float(scale_register(register, resolution, raw))


@pytest.mark.parametrize("name", RESOLUTIONS)
def test_commands_of_the_client_are_decoded_as_it_means_them(name: str) -> None:
    resolution = RESOLUTIONS[name]
    client = moteus.Controller(
        id=NODE, position_resolution=of_all(moteus.PositionResolution, resolution)
    )
    for chosen in (
        list(SENT),
        ["velocity", "maximum_torque"],
        ["position", "kd_scale"],
        list(SENT)[9:],
    ):
        if name in ("int32", "float"):
            chosen = chosen[:9]  # more does not fit into the client's frame
        bench = MoteusBench(FREE)
        bench.do(client.make_position(**{one: SENT[one][0] for one in chosen}))
        for one, (value, row, write) in SENT.items():
            start = moteus_registers.SETTINGS[row].start
            number = moteus_registers.SETTINGS[row].number
            number = Register.Q_CURRENT if number == 0x02C else number  # it does not read that
            wanted = as_sent(value, resolution, write, number) if one in chosen else start
            assert bench.r.value[row] == pytest.approx(wanted, rel=1e-15, nan_ok=True), one
        assert "VALUE_REFUSED" not in bench.mistakes()


@pytest.mark.parametrize("name", RESOLUTIONS)
def test_the_client_reads_every_register_to_its_resolution(name: str) -> None:
    resolution = RESOLUTIONS[name]
    bench = MoteusBench(FREE | {"torque_constant": 0.5, "motor_temperature": 41.0})
    bench.do(CLIENT.make_position(position=0.4, velocity=0.3, feedforward_torque=1.0))
    bench.held, bench.q, bench.w = True, 0.31, -0.9
    bench.cycles(3)
    x = bench.x
    exact = {
        Register.MODE: 10, Register.POSITION: 0.31, Register.VELOCITY: -0.9,
        Register.TORQUE: bench.u, Register.Q_CURRENT: bench.u / 0.5, Register.D_CURRENT: 0.0,
        Register.ABS_POSITION: 0.31, Register.POWER: bench.u * -0.9 * 2.0 * math.pi,
        Register.MOTOR_TEMPERATURE: 41.0, Register.TRAJECTORY_COMPLETE: 1,
        Register.HOME_STATE: 1, Register.VOLTAGE: 24.0, Register.TEMPERATURE: 25.0,
        Register.FAULT: 0, Register.CONTROL_POSITION: x.way_position,
        Register.CONTROL_VELOCITY: 0.3, Register.CONTROL_TORQUE: bench.u,
        Register.POSITION_ERROR: x.way_position - 0.31, Register.VELOCITY_ERROR: 1.2,
        Register.TORQUE_ERROR: 0.0, Register.POSITION_KP: 200.0 * (x.way_position - 0.31),
        Register.POSITION_KI: x.integral, Register.POSITION_KD: 12.0,
        Register.POSITION_FEEDFORWARD: 1.0, Register.POSITION_COMMAND: bench.u,
        Register.ENCODER_0_POSITION: 0.31, Register.ENCODER_0_VELOCITY: -0.9,
        Register.ENCODER_VALIDITY: 3, Register.MILLISECOND_COUNTER: int(bench.d.k),
        Register.COMMAND_POSITION: 0.4, Register.COMMAND_KP_SCALE: 1.0,
        Register.COMMAND_STOP_POSITION: math.nan, Register.COMMAND_WITHIN_FEEDFORWARD_TORQUE: 1.0,
    }  # fmt: skip
    assert exact[Register.POSITION_KP] + x.integral + 12.0 + 1.0 == pytest.approx(bench.u)
    for register, value in exact.items():
        query = moteus.QueryResolution()
        for one in vars(moteus.QueryResolution):
            if not one.startswith("_"):
                setattr(query, one, mp.IGNORE)
        query._extra = {register: resolution}
        found = bench.do(CLIENT.make_query(query))
        assert found is not None and set(found.response) == {register}
        scale = 1.0 if resolution == mp.F32 else SCALES[3 * KIND[register] + resolution]
        most = scale * (mp.TYPES_MAX[resolution] if resolution != mp.F32 else math.inf)
        wanted = min(max(value, -most), most) if value == value else value
        near = abs(value) * 1e-6 if resolution == mp.F32 else scale
        assert found.response[register] == pytest.approx(wanted, abs=near + 1e-12, nan_ok=True)
        if resolution != mp.F32 and value == value:
            assert abs(found.response[register]) <= abs(wanted) + 1e-12, "cut, as a C cast"


def test_a_query_in_all_resolutions_is_answered_in_one_frame_of_a_length_of_can_fd() -> None:
    bench = MoteusBench()
    for resolution in RESOLUTIONS.values():
        query = of_all(moteus.QueryResolution, mp.IGNORE)
        query._extra = dict.fromkeys(range(16), mp.IGNORE)
        names = ("mode", "position", "velocity", "torque", "q_current", "abs_position", "power")
        for one in (*names, "trajectory_complete", "home_state", "voltage", "fault"):
            setattr(query, one, resolution)
        command = CLIENT.make_query(query)
        found = bench.do(command, source=3)
        assert found is not None and len(found.response) == 11 and not found.errors
        _, can_id, data = bench.said[-1]
        assert can_id == NODE << 8 | 3 and len(data) in LENGTHS
        assert data[command.expected_reply_size :].strip(b"\x50") == b""
    assert bench.mistakes() == {}


def test_identity_and_what_is_not_there() -> None:
    bench = MoteusBench()
    (data,) = bench.send(0x8000 | NODE, bytes([0x1B, 0x80, 0x02, 0x19, 0x90, 0x02, 0x11, 0x77]))
    found = parse_registers(data)
    assert found.response == {0x100: 0, 0x101: 0x010000, 0x102: 5, 0x110: NODE}
    assert found.errors == [(0x77, 1)]
    (data,) = bench.send(0x8000 | NODE, bytes([0x01, 0x01, 5, 0x01, 0x77, 5, 0x01, 0x00, 7]))
    assert parse_registers(data).errors == [(1, 2), (0x77, 1), (0, 3)]
    assert [one.type for one in mp.parse_frame(data)] == [mp.SubframeType.WRITE_ERROR] * 3
    (data,) = bench.send(0x8000 | NODE, bytes([0x11, 0x80, 0x02]))
    assert parse_registers(data).errors == [(0x100, 1)], "an int32 only"
    (data,) = bench.send(0x8000 | NODE, bytes([0x01, 0xE0, 0x02, 5, 0x11, 0xE0, 0x02]))
    assert parse_registers(data).errors == [(0x160, 1)] * 2, "behind the last one"
    assert bench.mistakes() == {"VALUE_REFUSED": 7}
    (data,) = bench.send(0x8000 | NODE, b"\x50")
    assert data == b"" and bench.send(NODE, bytes([0x13, 0x00])) == []
    for stream in (0x20, 0x42, 0x44, 0x60):
        bench.send(NODE, bytes([stream, 1, 0, 0x01, 0x00, 12]))
    assert bench.mistakes()["COMMAND_REFUSED"] == 4 and bench.x.power == 0


def test_an_answer_ends_where_a_frame_ends() -> None:
    bench = MoteusBench()
    (data,) = bench.send(0x8000 | NODE, bytes([0x1C, 60, 0x00]))
    found = parse_registers(data)
    assert len(data) == 64 and list(found.response) == [*range(8), 10, 11, 12, 13, 14]
    assert found.errors == [(8, 1), (9, 1)]
    (data,) = bench.send(0x8000 | NODE, bytes([0x10, 0xFF, 0xFF, 0xFF, 0xFF, 0x0F, 0x7F]))
    assert len(data) <= 64 and len(parse_registers(data).errors) > 10
    (data,) = bench.send(0x8000 | NODE, bytes([0x15, 0x00, *[0x11, 0x77] * 20]))
    assert len(parse_registers(data).errors) == 18, "of 4 + 3 n bytes; one may need 7"


def test_an_answer_has_the_next_length_of_can_fd_and_whole_values() -> None:
    bench = MoteusBench()
    for count in range(1, 15):
        for kind, size in ((0x10, 1), (0x14, 2), (0x1C, 4)):
            (data,) = bench.send(0x8000 | NODE, bytes([kind, count, 0x20]))
            used = (2 if count <= 3 else 3) + count * size
            assert len(data) == min(one for one in LENGTHS if one >= used), (count, size)
            assert (
                data[used:].strip(b"\x50") == b"" and len(parse_registers(data).response) == count
            )
    asks = bytes([0x1C, 12, 0x20, 0x11, 0x00, 0x12, 0x01, 0x10, 6, 0x00])
    (data,) = bench.send(0x8000 | NODE, asks)
    assert len(parse_registers(data).response) == 12 + 3 and data[63] == 0x50


def test_an_answer_has_a_long_id_where_a_short_one_does_not_do() -> None:
    bench = MoteusBench()
    for node, extended in ((7, 0), (8, 1 << 31), (126, 1 << 31)):
        bench.d.node = node
        assert bench.send(0x8000 | node, b"\x50") == [b""]
        assert bench.said[-1][1] == node << 8 | extended


@pytest.mark.parametrize("data", [
    "01", "0100", "0c", "0c03", "0c0320", "0c032000000000", "0d2000", "1080", "10ffffffffff0f",
    "0480", "01ff",
])  # fmt: skip
def test_a_frame_that_ends_too_early_is_counted(data: str) -> None:
    bench = MoteusBench()
    bench.send(NODE, bytes.fromhex(data))
    assert bench.mistakes() == {"FRAME_SHORT": 1} and bench.cycles(1).x.power == 0


def test_whose_a_frame_is() -> None:
    bench, stop = MoteusBench(), CLIENT.make_stop().data
    for can_id, whose in (
        (NODE, Whose.OURS),
        (0x8000 | NODE, Whose.OURS),
        (1 << 31 | 0x8500 | NODE, Whose.OURS),
        (0x807F, Whose.OURS),
        (NODE + 1, Whose.OTHER),
        (0x80 | NODE, Whose.OTHER),
        (1 << 31 | 1 << 16 | NODE, Whose.OTHER),
        (1 << 30 | NODE, Whose.OTHER),
        (NODE << 8, Whose.TWIN),
        (NODE << 8 | 1, Whose.TWIN),
        (NODE << 8 | NODE, Whose.OURS),
        (0x8000 | NODE << 8, Whose.OTHER),
    ):
        bench.send(can_id, stop)
        assert bench.whose == whose, hex(can_id)
    bench.flags = 0
    bench.send(NODE, stop)
    assert bench.whose == Whose.OTHER, "a classic frame"


def test_an_answer_is_as_its_question_was() -> None:
    bench = MoteusBench()
    for flags in (Flag.FD, Flag.FD | Flag.BRS):
        bench.flags = flags
        for source, word in ((0, NODE << 8), (0x7F, NODE << 8 | 0x7F)):
            bench.do(CLIENT.make_query(), source)
            assert bench.said[-1][1] == word and bench.d.outbox[0][5] == flags


def test_a_frame_that_does_not_switch_its_bit_rate_is_counted_where_the_bus_has_two() -> None:
    for switches, flags, times in ((1, Flag.FD, 1), (1, Flag.FD | Flag.BRS, 0), (0, Flag.FD, 0)):
        bench = MoteusBench()
        bench.r.switches, bench.flags = switches, flags
        bench.do(CLIENT.make_query(), 0)
        assert bench.mistakes() == ({"NOT_SWITCHED": times} if times else {}), (switches, flags)


def test_it_is_a_spring_and_a_damper() -> None:
    bench = MoteusBench(FREE)
    bench.d.gains = (50.0, 2.0, 0.0)
    bench.do(CLIENT.make_position(position=0.05))
    natural, damped = math.sqrt(100.0), 1.0
    wave = math.sqrt(natural**2 - damped**2)
    for k in range(1, 1500):
        bench.cycles(1)
        t = (k + 0.5) * 1e-3  # half a cycle: the plant's own step
        swing = math.cos(wave * t) + damped / wave * math.sin(wave * t)
        assert bench.q == pytest.approx(0.05 * (1.0 - math.exp(-damped * t) * swing), abs=2e-4), k


def test_scales_and_limits_of_a_command() -> None:
    bench = MoteusBench(FREE | {"servo.max_current_A": 30.0})
    bench.held, bench.d.gains = True, (50.0, 2.0, 0.0)
    bench.do(CLIENT.make_position(position=0.1, kp_scale=0.5))
    assert bench.cycles(1).u == pytest.approx(0.1 * 50.0)
    bench.do(CLIENT.make_position(position=0.1, kp_scale=0.0, kd_scale=0.5, velocity=3.0))
    assert bench.cycles(1).u == pytest.approx(3.0)
    bench.do(
        CLIENT.make_position(position=0.1, kp_scale=0.0, kd_scale=0.0, feedforward_torque=-4.0)
    )
    assert bench.cycles(1).u == -4.0
    bench.do(CLIENT.make_position(position=9.0, maximum_torque=7.0))
    assert bench.cycles(1).u == 7.0
    bench.do(CLIENT.make_position(position=9.0, maximum_torque=70.0))
    assert bench.cycles(1).u == 30.0, "as the current's limit has it"
    bench.do(CLIENT.make_current(d_A=0.0, q_A=-2.0))
    assert bench.cycles(1).u == -2.0 and bench.x.power == Mode.CURRENT
    bench.d.gains = (50.0, 2.0, 3.0)
    bench.do(CLIENT.make_position(position=0.01))
    bench.cycles(100)
    assert bench.x.integral == pytest.approx(0.01 * 300.0 * 0.1), "(2)"
    bench.cycles(100_000)
    assert bench.x.integral == pytest.approx(30.0), "(2)"


def test_a_position_that_is_none_goes_on_from_where_it_is() -> None:
    bench = MoteusBench(FREE)
    bench.do(CLIENT.make_position(position=math.nan, velocity=2.0))
    for _ in range(2000):
        bench.cycles(1)
    assert bench.x.way_position == pytest.approx(4.0) and bench.w == pytest.approx(2.0, abs=1e-2)
    at = bench.x.way_position
    bench.do(CLIENT.make_position(position=math.nan))
    bench.cycles(3000)
    assert bench.q == pytest.approx(at, abs=1e-2) and bench.mistakes() == {}


@pytest.mark.parametrize(("a", "most", "goal"), [(8.0, 2.0, 3.0), (8.0, 2.0, -0.2), (None, 2.0, 1)])
def test_with_limits_it_gets_there_as_fast_as_they_let_it(
    a: float | None, most: float, goal: float
) -> None:
    bench = MoteusBench(FREE)
    bench.do(CLIENT.make_position(position=goal, velocity_limit=most, accel_limit=a))
    far, took, fastest = abs(goal), 0, 0.0
    while bench.x.arrived == 0 and took < 5000:
        before = bench.x.way_velocity
        bench.cycles(1)
        took += 1
        fastest = max(fastest, abs(bench.x.way_velocity))
        if a is not None and not bench.x.arrived:
            assert abs(bench.x.way_velocity - before) <= a * 1e-3 + 1e-12
    if a is None:
        exact = far / most
    elif far > most * most / a:
        exact = far / most + most / a
    else:
        exact = 2.0 * math.sqrt(far / a)
    assert took * 1e-3 == pytest.approx(exact, abs=8e-3) and fastest <= most + 1e-12
    assert bench.cycles(1).x.way_position == pytest.approx(goal) and bench.x.way_velocity == 0.0
    found = bench.do(CLIENT.make_query(of_all(moteus.QueryResolution, mp.INT8)))
    assert found is not None and found.response[Register.TRAJECTORY_COMPLETE] == 1


def test_a_limit_of_nought_is_a_limit_and_one_below_is_none() -> None:
    for limit, moves in ((0.0, False), (-1.0, True)):
        bench = MoteusBench(FREE)
        bench.do(CLIENT.make_position(position=1.0, velocity_limit=limit, watchdog_timeout=10.0))
        assert (bench.cycles(50).x.way_position != 0.0) == moves, limit


def test_a_target_that_moves_is_met_with_its_velocity() -> None:
    bench = MoteusBench(FREE)
    bench.do(CLIENT.make_position(position=1.0, velocity=0.5, velocity_limit=2.0, accel_limit=4.0))
    k = 0
    while bench.x.arrived == 0 and k < 2500:
        bench.cycles(1)
        k += 1
    assert bench.x.way_position == pytest.approx(1.0 + 0.5e-3 * k, abs=3e-3)
    assert bench.x.way_velocity == 0.5 and k < 2500
    bench.do(
        CLIENT.make_position(position=math.nan, velocity=-9.0, velocity_limit=2.0, accel_limit=4.0)
    )
    assert bench.cycles(625).x.way_velocity == pytest.approx(-2.0, abs=4e-3)
    assert bench.cycles(10).x.way_velocity == -2.0 and bench.x.arrived == 1


def test_a_stop_position_ends_the_way() -> None:
    for velocity, position in ((2.0, 0.5), (2.0, -0.5), (-2.0, 0.5)):
        bench = MoteusBench(FREE)
        bench.do(CLIENT.make_position(position=math.nan, velocity=velocity, stop_position=position))
        assert bench.cycles(240).x.arrived == 1 and abs(bench.x.way_position) < 0.5
        assert bench.cycles(20).x.way_position == pytest.approx(position)
        assert bench.cycles(2000).q == pytest.approx(position, abs=1e-2)


def test_bounds_and_slip_hold_the_target() -> None:
    bench = MoteusBench(FREE | {"servopos.position_min": -1.0, "servopos.position_max": 0.5})
    bench.do(CLIENT.make_position(position=3.0))
    assert bench.cycles(1).x.way_position == 0.5 and bench.mistakes() == {"TARGET_CLIPPED": 1}
    bench.do(CLIENT.make_position(position=-3.0))
    assert bench.cycles(1).x.way_position == -1.0
    bench.do(CLIENT.make_position(position=3.0, ignore_position_bounds=1))
    assert bench.cycles(1).x.way_position == 3.0
    bench = MoteusBench(FREE | {"servo.max_position_slip": 0.1})
    bench.held = True
    bench.do(CLIENT.make_position(position=math.nan, velocity=1.0))
    assert bench.cycles(1000).x.way_position == pytest.approx(0.1)


def test_a_silent_master_is_a_time_out_until_it_stops() -> None:
    for timeout, after in ((None, 101), (0.25, 251)):
        bench = MoteusBench({"servo.default_timeout_s": 0.1})
        bench.do(CLIENT.make_position(position=math.nan, velocity=1.0, watchdog_timeout=timeout))
        assert bench.cycles(after - 1).x.power == Mode.POSITION
        bench.do(CLIENT.make_query())
        assert bench.cycles(1).x.power == Mode.POSITION, "a query is not a command"
        assert bench.cycles(1).x.power == Mode.TIMEOUT and bench.mistakes() == {"SILENT": 1}
        assert bench.u == pytest.approx(-10.0 * bench.x.velocity, rel=0.05), "damping alone"
        bench.do(CLIENT.make_position(position=0.0))
        assert bench.cycles(1).x.power == Mode.TIMEOUT
        assert bench.mistakes()["COMMAND_REFUSED"] == 1
        bench.do(CLIENT.make_stop())
        bench.do(CLIENT.make_position(position=0.0))
        assert bench.cycles(1).x.power == Mode.POSITION
    bench = MoteusBench()
    bench.do(CLIENT.make_position(position=0.0, watchdog_timeout=math.nan))
    assert bench.cycles(100_000).x.power == Mode.POSITION and bench.mistakes() == {}


def test_each_mode_that_moves_by_itself_is_left_when_the_master_is_silent() -> None:
    for command, left in (
        (CLIENT.make_stay_within(lower_bound=-0.5, upper_bound=0.5), True),
        (CLIENT.make_zero_velocity(), True),
        (CLIENT.make_current(q_A=0.0, d_A=0.0), False),
        (CLIENT.make_brake(), False),
    ):
        bench = MoteusBench({"servo.default_timeout_s": 0.1})
        bench.do(command)
        mode = bench.cycles(100).x.power
        assert mode not in (Mode.STOPPED, Mode.TIMEOUT)
        assert bench.cycles(2).x.power == (Mode.TIMEOUT if left else mode)


@pytest.mark.parametrize(("mode", "torque"), [(0, 0.0), (15, 0.0), (12, -10.0), (10, None)])
def test_the_time_out_does_what_its_setting_says(mode: int, torque: float | None) -> None:
    bench = MoteusBench({"servo.timeout_mode": mode})
    bench.do(CLIENT.make_position(position=math.nan, velocity=1.0))
    bench.cycles(102)
    bench.held, bench.w = True, 1.0
    bench.cycles(1)
    assert bench.x.power == Mode.TIMEOUT
    if torque is None:
        bench.held = False
        assert abs(bench.cycles(3000).w) < 1e-2
        assert bench.x.way_position == pytest.approx(bench.q, abs=1e-3)
    else:
        assert bench.cycles(1).u == pytest.approx(torque)


def test_a_fault_is_there_until_it_is_stopped() -> None:
    bench = MoteusBench(FREE | {"servopos.position_max": 0.5})
    bench.held, bench.q = True, 0.6
    bench.cycles(1)
    for command, fault in (
        (CLIENT.make_position(position=0.0), 39),
        (CLIENT.make_position(position=0.0, stop_position=1.0, accel_limit=1.0), 45),
        (CLIENT.make_position(position=0.0, stop_position=1.0, velocity_limit=1.0), 45),
    ):
        bench.q = 0.6 if fault == 39 else 0.0
        bench.cycles(1).do(command)
        state = bench.do(CLIENT.make_position(position=0.0, query=True))
        assert state is not None and bench.cycles(1).u == 0.0
        assert state.response[Register.MODE] == 1 and state.response[Register.FAULT] == fault
        bench.do(CLIENT.make_stop())
        state = bench.do(CLIENT.make_query())
        assert state is not None
        assert state.response[Register.MODE] == 0 and state.response[Register.FAULT] == 0
    bench.q = 0.6
    bench.cycles(1).do(CLIENT.make_position(position=0.6, ignore_position_bounds=1))
    assert bench.x.power == Mode.POSITION


MADE = {
    Mode.STOPPED: CLIENT.make_stop, Mode.CURRENT: lambda: CLIENT.make_current(d_A=0.0, q_A=1.0),
    Mode.POSITION: lambda: CLIENT.make_position(position=0.1),
    Mode.ZERO_VELOCITY: CLIENT.make_zero_velocity, Mode.BRAKE: CLIENT.make_brake,
    Mode.STAY_WITHIN: lambda: CLIENT.make_stay_within(lower_bound=-1.0, upper_bound=1.0),
}  # fmt: skip


@pytest.mark.parametrize("asked", [*MADE, "pwm", "vfoc"])
@pytest.mark.parametrize("before", [*MADE, Mode.FAULT, Mode.TIMEOUT])
def test_every_mode_is_asked_for_in_every_mode(before: Mode, asked: Mode | str) -> None:
    bench = MoteusBench({"servo.default_timeout_s": 0.05})
    if before in MADE:
        bench.do(MADE[before]())
    elif before == Mode.FAULT:
        bench.do(CLIENT.make_position(position=0.0, stop_position=1.0, velocity_limit=1.0))
    else:
        bench.do(CLIENT.make_position(position=0.0))
        bench.cycles(60)
    bench.cycles(1)
    assert bench.x.power == before
    counted = bench.mistakes()
    if asked in MADE:
        bench.do(MADE[asked]())
        stuck = before in (Mode.FAULT, Mode.TIMEOUT) and asked != Mode.STOPPED
        assert bench.cycles(1).x.power == (before if stuck else asked)
        more = bench.mistakes().get("COMMAND_REFUSED", 0) - counted.get("COMMAND_REFUSED", 0)
        assert more == stuck
        return
    wanted = CLIENT.make_vfoc(theta=0.0, voltage=1.0).data if asked == "vfoc" else b"\x01\x00\x05"
    bench.send(NODE, wanted)
    assert bench.cycles(1).x.power == before and bench.mistakes()["VALUE_REFUSED"] >= 1


def test_it_stays_within_bounds() -> None:
    bench = MoteusBench(FREE)
    bench.held = True
    bench.do(CLIENT.make_stay_within(lower_bound=-0.5, upper_bound=0.5, feedforward_torque=0.75))
    for q, torque in ((0.0, 0.75), (0.49, 0.75), (0.6, 0.75 - 20.0), (-0.7, 0.75 + 40.0)):
        bench.q = q
        bench.cycles(2)
        assert bench.u == pytest.approx(torque, abs=0.6), q
    bench.w = 5.0
    bench.do(CLIENT.make_zero_velocity(kd_scale=0.5))
    assert bench.cycles(2).u == pytest.approx(-0.5 * 10.0 * 5.0)
    bench.do(CLIENT.make_brake())
    assert bench.cycles(1).u == 0.0


def test_the_output_is_set_and_the_target_moves_along() -> None:
    bench = MoteusBench(FREE)
    bench.do(CLIENT.make_position(position=0.2))
    bench.cycles(2000)
    for make in (CLIENT.make_set_output_exact, CLIENT.make_set_output_nearest):
        bench.do(make(position=-3.0))
        assert bench.x.position == -3.0 and bench.x.way_position == pytest.approx(-3.0, abs=1e-2)
        bench.cycles(10)
        assert abs(bench.q - 0.2) < 1e-2
    bench.do(CLIENT.make_set_output_exact(position=math.nan))
    assert bench.x.position == pytest.approx(-3.0, abs=1e-2) and "NOT_FINITE" in bench.mistakes()


def test_what_is_not_finite_is_refused_but_none_has_its_meaning() -> None:
    bench = MoteusBench(FREE)
    bench.do(CLIENT.make_position(position=math.inf, velocity=-math.inf))
    assert bench.mistakes()["NOT_FINITE"] == 2 and math.isfinite(bench.cycles(1).u)
    nothing = dict.fromkeys(list(SENT)[:10], math.nan)
    bench.do(CLIENT.make_position(**nothing))
    assert math.isfinite(bench.cycles(1).u) and bench.x.power == Mode.POSITION


def test_random_and_mutated_frames_leave_it_finite_and_alive() -> None:
    rng = np.random.default_rng(20261127)
    bench = MoteusBench(FREE)
    made = [MADE[one]().data for one in MADE] + [CLIENT.make_query().data]
    made += [CLIENT.make_position(**{one: SENT[one][0] for one in list(SENT)[:9]}).data]
    for _ in range(20_000):
        if rng.random() < 0.5:
            data = bytearray(rng.bytes(int(rng.choice(LENGTHS))))
        else:
            data = bytearray(made[int(rng.integers(len(made)))])
            for _ in range(int(rng.integers(4))):
                data[int(rng.integers(len(data)))] = int(rng.integers(256))
        said = bench.send(int(rng.choice([0, 0x8000])) | NODE, bytes(data))
        assert all(len(one) in LENGTHS for one in said)
        if rng.random() < 0.3:
            bench.cycles(1)
            assert math.isfinite(bench.u), bench.x
            assert math.isfinite(bench.x.way_position) and math.isfinite(bench.x.integral)
            bench.q, bench.w = min(max(bench.q, -1e3), 1e3), min(max(bench.w, -1e3), 1e3)
            bench.said.clear()
    bench.do(CLIENT.make_stop())
    bench.do(CLIENT.make_current(d_A=0.0, q_A=1.0))
    assert bench.cycles(1).u == 1.0


def test_a_wrong_setting_is_named() -> None:
    for starts, said in (
        ({"max_current_A": 1.0}, "no such setting; servo.max_current_A?"),
        ({"torque_constant": 0.0}, "0 is not a number from 1e-09"),
        ({"servo.timeout_mode": 1.5}, "1.5 is not a whole number from 0 to 15"),
    ):
        with pytest.raises(ValueError, match=said):
            settings.changed_settings(moteus_registers.SETTINGS, starts)
