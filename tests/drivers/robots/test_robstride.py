"""RobStride's private protocol: others' clients against it, motion and heat in closed form."""

import math
import struct

import numpy as np
import pytest
from benches import NODE, BenchBus, RobStrideBench
from robstride import Client, RunMode
from robstride.client import FeedbackResp, MotorError, MotorMode, params
from robstride_dynamics import Motor, ParameterType, RobstrideBus

from pcpc.drivers.drive.layout import Whose
from pcpc.drivers.robots import robstride, settings
from pcpc.drivers.robots.robstride import Key

RS01 = {"V_MAX": 44.0, "T_MAX": 17.0, "limit_torque": 17.0}
TURN = 4.0 * math.pi
ORDER = bytes(range(1, 7))  # of what is not to come by chance


@pytest.fixture
def bench() -> RobStrideBench:
    """Return a motor 5 that is scaled as an RS 01."""
    return RobStrideBench(RS01)


def operation(bench: RobStrideBench, *numbers: float) -> list[bytes]:
    """Send position, velocity, stiffness, damping, torque as the other client does."""
    with BenchBus(bench, cycles=0) as bus:
        client = dynamics(bus)
        position, velocity, kp, kd, torque = numbers
        client.write_operation_frame("joint", position, kp, kd, velocity, torque)
        client.channel_handler = None  # else it switches the motor off when it is gone
        return [bytes(message.data) for message in bus.waiting]


def dynamics(bus: BenchBus) -> RobstrideBus:
    """Return the other client; its `connect` knows SocketCAN alone."""
    client = RobstrideBus("bench", {"joint": Motor(NODE, "rs-01")})
    client.channel_handler = bus
    return client


def test_the_client_robstride_moves_it(bench: RobStrideBench) -> None:
    with BenchBus(bench) as bus:
        client = Client(bus)
        found = client.disable(NODE)
        assert (found.mode, found.errors, found.temp) == (MotorMode.Reset, [], 25.0)
        client.write_param(NODE, "run_mode", RunMode.Speed)
        assert client.read_param(NODE, "run_mode") == RunMode.Speed
        client.enable(NODE)
        client.write_param(NODE, "spd_ref", 3.0)
        bench.cycles(4000)
        found = client.write_param(NODE, "spd_ref", 3.0)
        assert isinstance(found, FeedbackResp)
        assert found.velocity == pytest.approx(3.0, abs=88 / 65535 + 1e-3)
        for name, _ in params[1:]:
            client.read_param(NODE, name)
        assert client.read_param(NODE, "mechvel") == pytest.approx(3.0, abs=1e-3)
        client.update_id(NODE, 9)
        client.enable(9)  # it reads one bit of the mode, which is 2
        assert bench.x.power == 2
        assert client.error_rate() == 0.0 and bench.mistakes() == {}


def test_the_client_robstride_dynamics_moves_it(bench: RobStrideBench) -> None:
    with BenchBus(bench) as bus:
        client = dynamics(bus)
        assert client.read_id("joint")[0] == NODE
        client.enable("joint")
        for _ in range(6000):
            client.write_operation_frame("joint", 1.0, 30.0, 5.0)
            place, speed, torque, degrees = client.read_operation_frame("joint")
        assert place == pytest.approx(1.0, abs=1e-3) and abs(speed) < 2e-3 and degrees == 25.0
        assert abs(torque) < 1e-2
        public = [kind for name, kind in vars(ParameterType).items() if name[0] != "_"]
        known = {kind for kind in public if isinstance(kind, tuple)}
        numbers = {one.number for one in robstride.SETTINGS}
        for kind in sorted(known, key=lambda one: int(one[0])):
            if kind[0] in numbers:
                client.read("joint", kind)
        client.write("joint", ParameterType.VELOCITY_LIMIT, 2.5)
        assert client.read("joint", ParameterType.VELOCITY_LIMIT) == 2.5
        client.disconnect()
        assert bench.mistakes() == {} and bench.x.power == 0


def test_operation_is_decoded_to_its_resolution(bench: RobStrideBench) -> None:
    rng = np.random.default_rng(3)
    bench.on()
    for _ in range(300):
        numbers = [float(rng.uniform(-1.1, 1.1) * most) for most in (TURN, 44.0)]
        numbers += [float(rng.uniform(0.0, 1.1) * most) for most in (500.0, 5.0)]
        numbers += [float(rng.uniform(-1.0, 1.0) * 17.0)]
        operation(bench, *numbers)
        x = bench.x
        found = x.target_position, x.target_velocity, x.stiffness, x.damping, x.target_torque
        spans = (-TURN, TURN), (-44.0, 44.0), (0.0, 500.0), (0.0, 5.0), (-17.0, 17.0)
        for value, wanted, (low, high) in zip(found, numbers, spans, strict=True):
            step = (high - low) / 65535  # the client takes 0x7FFF for the middle
            assert abs(value - min(max(wanted, low), high)) <= 2 * step, (value, wanted)


def test_feedback_has_mode_faults_and_full_scale(bench: RobStrideBench) -> None:
    bench.held = True
    for q, w, degrees in (
        (0.0, 0.0, 25.0),
        (3.1, -7.0, 80.0),
        (-12.0, 43.0, 120.0),
        (40.0, -90.0, 25.0),
    ):
        bench.q, bench.w, bench.r.value[Key.TEMPERATURE_C] = q, w, degrees
        bench.r.value[Key.AMBIENT_C] = degrees
        bench.on().cycles(1)
        with BenchBus(bench, 0) as bus:
            found = Client(bus).enable(NODE)
        assert found.angle == pytest.approx(min(max(q, -TURN), TURN), abs=2 * TURN / 65535)
        assert found.velocity == pytest.approx(min(max(w, -44.0), 44.0), abs=88 / 65535)
        assert found.temp == pytest.approx(degrees, abs=0.1)
        assert bench.said[-1][1] >> 22 & 3 == 2, "it runs"


def test_in_operation_it_is_a_spring_and_a_damper(bench: RobStrideBench) -> None:
    operation(bench.on(), 0.05, 0.0, 100.0, 2.0, 0.0)
    x = bench.x
    bench.q = start = 0.0
    middle = x.target_position + (x.damping * x.target_velocity + x.target_torque) / x.stiffness
    natural, damped = math.sqrt(x.stiffness), 0.5 * x.damping
    wave = math.sqrt(natural**2 - damped**2)
    for k in range(1, 1500):
        bench.cycles(1)
        t = (k + 0.5) * 1e-3  # half a cycle: the plant's own step
        swing = math.cos(wave * t) + damped / wave * math.sin(wave * t)
        exact = middle + (start - middle) * math.exp(-damped * t) * swing
        assert bench.q == pytest.approx(exact, abs=1e-3), k
    operation(bench, 12.0, 0.0, 500.0, 0.0, 0.0)
    assert bench.cycles(1).u == 17.0, "limited"
    bench.write(0x700B, 3.0)
    assert bench.cycles(1).u == 3.0, "limit_torque"


def test_a_current_is_a_torque() -> None:
    bench = RobStrideBench(RS01 | {"torque_constant": 1.5, "limit_torque": 6.0}).on(3)
    for current, torque in ((2.0, 3.0), (-3.0, -4.5), (5.0, 6.0), (-500.0, -6.0)):
        bench.write(0x7006, current)
        assert bench.cycles(1).u == pytest.approx(torque)
        assert bench.read(0x701A) == pytest.approx(torque / 1.5)
        assert bench.read(0x302C) == pytest.approx(torque)


def test_velocity_is_a_ramp_and_then_a_lag(bench: RobStrideBench) -> None:
    bench.d.gains = (20.0, 10.0, 0.0)
    bench.write(0x7022, 4.0)
    bench.on(2).write(0x700A, 2.0)
    for k in range(1, 400):
        bench.cycles(1)
        t = k * 1e-3  # w' = 10 (4 t - w): a ramp behind a lag of 0.1 s
        assert bench.w == pytest.approx(4.0 * (t - 0.1 * (1.0 - math.exp(-10.0 * t))), abs=8e-3)
    assert bench.cycles(2000).w == pytest.approx(2.0, abs=1e-6)
    bench.write(0x7018, 0.5)  # limit_cur
    bench.write(0x700A, -2.0)
    assert bench.cycles(900).u == -0.5, "k limit_cur"


def test_profile_position_is_a_trapezoid(bench: RobStrideBench) -> None:
    bench.write(0x7024, 1.5)
    bench.write(0x7025, 5.0)
    bench.on(1).write(0x7016, 2.0)
    fastest, done = 0.0, 0
    for k in range(1, 4000):
        bench.cycles(1)
        fastest = max(fastest, bench.x.way_velocity)
        done = done or (k if bench.x.way_position == 2.0 else 0)
    assert fastest == 1.5 and done == pytest.approx(1e3 * (2.0 / 1.5 + 1.5 / 5.0), abs=3)
    assert bench.q == pytest.approx(2.0, abs=1e-3)
    assert bench.do(6, bytes([1] + [0] * 7)) and bench.mistakes() == {"COMMAND_REFUSED": 1}


def test_a_mode_begins_as_fast_as_the_motor_is(bench: RobStrideBench) -> None:
    bench.d.gains = (20.0, 50.0, 0.0)
    bench.on(2).write(0x700A, 3.0)
    bench.cycles(500).write(0x7025, 10.0)
    bench.write(0x7005, 1)
    assert bench.read(0x7016) == pytest.approx(bench.q, abs=1e-6), "loc_ref is here"
    bench.cycles(1)
    assert bench.x.way_velocity == pytest.approx(3.0 - 10.0e-3, abs=1e-6), (
        "acc_set from its speed on"
    )
    hardest = max(abs(bench.cycles(1).u) for _ in range(100))
    assert 10.0 < hardest < 13.0, (
        "acc_set of an inertia of 1, and the loop's overshoot; from rest 150"
    )


def test_cyclic_position_is_a_lag_below_its_limit(bench: RobStrideBench) -> None:
    bench.d.gains = (5.0, 200.0, 0.0)
    bench.write(0x7017, 1.0)
    bench.on(5).write(0x7016, 2.0)
    bench.cycles(1000)
    assert bench.w == pytest.approx(1.0, abs=1e-3), "limit_spd"
    bench.cycles(850)
    far = 2.0 - bench.q
    assert bench.cycles(200).q == pytest.approx(2.0 - far * math.exp(-1.0), abs=0.02 * far)


def test_heat_is_a_lag_and_too_much_of_it_a_fault() -> None:
    heat = {"resistance_ohm": 2.0, "thermal_K_W": 3.0, "thermal_J_K": 0.5, "torque_constant": 0.5}
    bench = RobStrideBench(RS01 | heat | {"hot_C": 110.0, "warm_C": 60.0}).on(3)
    bench.held = True
    bench.write(0x7006, 4.0)
    end = 25.0 + 2.0 * 16.0 * 3.0  # of (6): ambient + R i^2 R_th
    for k in range(1, 4000):
        bench.cycles(1)
        exact = end + (25.0 - end) * math.exp(-max(k - 1, 0) * 1e-3 / 1.5)
        if bench.x.errors:
            break
        assert bench.r.value[Key.TEMPERATURE_C] == pytest.approx(exact, abs=0.05)
    due = 1.5 * math.log((end - 25.0) / (end - 110.0))
    assert k * 1e-3 == pytest.approx(due, abs=4e-3) and bench.u == 0.0 and bench.x.power == 0
    assert bench.said[-1][1:] == (1 << 31 | 0x15 << 24 | NODE << 8 | 0xFD, struct.pack("<II", 1, 1))
    with BenchBus(bench, 0) as bus:
        client = Client(bus)
        assert client.enable(NODE).errors == [MotorError.Overtemp], "not before it is forgotten"
        assert bench.x.power == 0
        bench.r.value[Key.TEMPERATURE_C] = 120.0
        bench.do(4, bytes([1] + [0] * 7))
        assert bench.x.errors == 0 and bench.cycles(1).x.errors == 1, "it still is too hot"
        bench.r.value[Key.TEMPERATURE_C] = 100.0
        bench.cycles(1)
        assert client.disable(NODE).errors == [MotorError.Overtemp]
        bench.do(4, bytes([1] + [0] * 7))
        assert client.enable(NODE).mode.value == 0 and bench.x.power == 2
    assert bench.do(0x15) == [struct.pack("<II", 0, int(bench.r.value[Key.TEMPERATURE_C] > 60))]


@pytest.mark.parametrize(
    ("w", "bit", "error"), [(20.0, 4, [MotorError.Undervoltage]), (-20.0, 8, [])]
)
def test_the_supply_gives_way(w: float, bit: int, error: list[MotorError]) -> None:
    source = {"supply_V": 40.0, "supply_ohm": 2.0, "low_V": 33.0, "high_V": 47.0}
    bench = RobStrideBench(RS01 | source | {"VBUS": 40.0}).on(3)
    bench.held, bench.w = True, w
    bench.write(0x7006, 4.0)
    assert bench.cycles(3).read(0x701C) == pytest.approx(40.0 - 2.0 * 4.0 * w / 40.0)  # (7)
    assert bench.x.errors == 0
    bench.write(0x7006, 8.0)
    bench.cycles(2)
    assert bench.x.errors == bit and bench.u == 0.0 and bench.read(0x3022, "I") == bit
    with BenchBus(bench, 0) as bus:
        assert Client(bus).disable(NODE).errors == error


def test_without_orders_it_lets_go() -> None:
    bench = RobStrideBench(RS01)
    bench.write(0x7028, 2000)  # of 50 us
    bench.on()
    assert bench.cycles(101).x.power == 2 and bench.cycles(1).x.power == 0
    assert bench.mistakes() == {"SILENT": 1}
    bench.do(3)
    assert bench.x.power == 2, "no fault"
    for _ in range(5):
        operation(bench.cycles(90), 0.0, 0.0, 0.0, 0.0, 0.0)
    assert bench.x.power == 2 and bench.mistakes() == {"SILENT": 1}


def test_every_setting_is_read_back(bench: RobStrideBench) -> None:
    rng = np.random.default_rng(9)
    assert [one.name.upper().replace(".", "_") for one in robstride.SETTINGS] == list(
        Key.__members__
    )
    for row, one in enumerate(robstride.SETTINGS):
        if one.number < 0:
            continue
        form, fresh = ("I" if one.whole else "f"), bench.read(one.number, "I" if one.whole else "f")
        high = min(one.high, 1e3)
        value: float = int(one.high) if one.whole else float(np.float32(rng.uniform(one.low, high)))
        bench.write(one.number, value)
        after = bench.read(one.number, form)
        assert after == (pytest.approx(value, rel=1e-6) if one.writable else fresh), one
        for wrong in (one.high * 2.0 + 1.0, one.low - 1.0, math.nan):
            if one.whole or abs(wrong) > 3e38:
                continue
            bench.write(one.number, wrong)
            assert bench.read(one.number, form) == after or not one.writable, (one, wrong)
        assert row == Key[one.name.upper()]
    before = bench.mistakes()
    bench.write(0x7005, 4)
    bench.write(0x7FFF, 1.0)
    assert bench.do(0x11, struct.pack("<HHI", 0x7FFF, 0, 0)) == [struct.pack("<HHI", 0x7FFF, 0, 0)]
    assert bench.said[-1][1] >> 16 & 255 == 1, "its status"
    assert bench.mistakes()["VALUE_REFUSED"] == before["VALUE_REFUSED"] + 3


def test_gains_of_the_loops_are_those_of_the_drive() -> None:
    bench = RobStrideBench(RS01 | {"torque_constant": 0.5})
    bench.d.rated = 4.0
    bench.write(0x701E, 7.0)
    bench.write(0x701F, 3.0)
    bench.write(0x7020, 1.5)
    assert tuple(bench.d.gains.tolist() if hasattr(bench.d.gains, "tolist") else bench.d.gains) == (
        7.0, 3.0 * 0.5 * 4.0, 0.5,
    )  # fmt: skip
    assert bench.x.regained == 1
    assert [bench.read(number) for number in (0x701E, 0x701F, 0x7020)] == [7.0, 3.0, 1.5]
    bench.write(0x701F, 0.0)
    assert bench.d.gains.integral_per_s == 0.0


def test_here_is_zero(bench: RobStrideBench) -> None:
    bench.on(5)
    bench.q = 1.25
    bench.cycles(1)
    bench.do(6, bytes([1] + [0] * 7))
    assert bench.read(0x7019) == 0.0 and bench.read(0x7016) == 0.0
    assert bench.cycles(20).u == pytest.approx(0.0, abs=1e-9)


def test_another_node_from_now_on(bench: RobStrideBench) -> None:
    (answer,) = bench.do(7, bytes(8), 9 << 8 | 0xFD)
    assert bench.said[-1][1] == 1 << 31 | 9 << 8 | 0xFE and answer == struct.pack(
        "<II", robstride.SERIAL, NODE
    )
    assert bench.do(3) == [] and bench.whose == Whose.OTHER and bench.x.power == 0
    bench.send(1 << 31 | 3 << 24 | 0xFD << 8 | 9, bytes(8))
    assert bench.x.power == 2 and bench.said[-1][1] == 1 << 31 | 0x0280_09FD
    for node in (0, 128, 255):
        bench.send(1 << 31 | 7 << 24 | (node << 8 | 0xFD) << 8 | 9, bytes(8))
        assert bench.said[-1][1] >> 24 & 31 == 2, "no identity"
    assert bench.mistakes() == {"VALUE_REFUSED": 3}


def test_it_reports_by_itself(bench: RobStrideBench) -> None:
    def reports(cycles: int) -> list[int]:
        bench.said.clear()
        bench.cycles(cycles)
        return [cycle for cycle, _, _ in bench.said]

    bench.cycles(50)
    assert reports(50) == []
    bench.do(0x18, ORDER + b"\1\0")
    assert set(np.diff(reports(100))) == {10}
    bench.write(0x7026, 3)
    assert set(np.diff(reports(200))) == {20}
    bench.do(0x18, ORDER + b"\0\0")
    assert reports(100) == []


@pytest.mark.parametrize(("kind", "data", "counted"), [
    (0x19, ORDER + b"\1\0", "TO_CANOPEN"), (0x19, ORDER + b"\2\0", "TO_MIT"),
    (0x17, ORDER + b"\2\0", "COMMAND_REFUSED"), (5, bytes(8), "COMMAND_REFUSED"),
    (0x1F, bytes(8), "COMMAND_REFUSED"), (1, bytes(8), "COMMAND_REFUSED"),
    (3, bytes(7), "FRAME_SHORT"),
])  # fmt: skip
def test_what_a_master_does_wrong_is_counted(
    bench: RobStrideBench, kind: int, data: bytes, counted: str
) -> None:
    bench.do(kind, data)
    assert bench.mistakes() == {counted: 1} and bench.x.power == 0


def test_what_is_no_mistake(bench: RobStrideBench) -> None:
    for kind, data in (
        (0x16, bytes(range(1, 9))),
        (0x19, ORDER + b"\0\0"),
        (0, bytes(8)),
    ):
        assert len(bench.do(kind, data)) == 1
    assert bench.mistakes() == {}


def test_whose_a_frame_is(bench: RobStrideBench) -> None:
    ext = 1 << 31
    for word, whose in (
        (ext | 3 << 24 | 0xFD << 8 | NODE, Whose.OURS),
        (ext | 3 << 24 | 0xFD << 8 | NODE + 1, Whose.OTHER),
        (3 << 8 | NODE, Whose.OTHER),
        (ext | 1 << 30 | 3 << 24 | NODE, Whose.OTHER),
        (ext | 2 << 24 | NODE << 8 | 0xFD, Whose.TWIN),
        (ext | 0x80 << 16 | 2 << 24 | NODE << 8 | 0xFD, Whose.TWIN),
        (ext | 2 << 24 | (NODE + 1) << 8 | 0xFD, Whose.OTHER),
        (ext | NODE << 8 | 0xFE, Whose.TWIN),
    ):
        bench.send(word, bytes(8))
        assert bench.whose == whose, hex(word)
    bench.flags = 1
    assert bench.do(3) == [] and bench.whose == Whose.OTHER, "CAN FD"


def test_a_wrong_setting_is_named() -> None:
    with pytest.raises(ValueError, match="limit_spd: -1 is not a number from 0"):
        settings.changed_settings(robstride.SETTINGS, {"limit_spd": -1.0})
