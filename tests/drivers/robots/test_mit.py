"""MIT mode and its registers: bits against another's client, motion in closed form."""

import math
import struct

import can
import numpy as np
import pytest
from benches import NODE, Bench
from damiao_motor.core.motor import REGISTER_TABLE, DaMiaoMotor

from pcpc.drivers.canopen.node import Whose
from pcpc.drivers.robots import mit
from pcpc.drivers.robots.mit import Key

ON, OFF, ZERO, FORGET = (bytes([0xFF] * 7 + [order]) for order in (0xFC, 0xFD, 0xFE, 0xFB))
MASTER = {"MST_ID": 0x15}


@pytest.fixture
def client() -> DaMiaoMotor:
    """Return the client's motor 5, of type 4310: 12.5 rad, 30 rad/s, 10 N m."""
    with can.Bus("mit", interface="virtual") as bus:
        return DaMiaoMotor(NODE, 0x15, bus, motor_type="4310")


def test_commands_of_the_client_are_decoded_to_its_resolution(client: DaMiaoMotor) -> None:
    rng = np.random.default_rng(1)
    bench = Bench(MASTER)
    bench.send(NODE, ON)
    for _ in range(300):
        p, v, t = (float(rng.uniform(-1.1, 1.1) * most) for most in (12.5, 30.0, 10.0))
        kp, kd = float(rng.uniform(-50, 550)), float(rng.uniform(-0.5, 5.5))
        bench.send(NODE, client.encode_cmd_msg(p, v, t, kp, kd))
        x = bench.x
        for found, wanted, low, high, bits in (
            (x.target_position, p, -12.5, 12.5, 16),
            (x.target_velocity, v, -30.0, 30.0, 12),
            (x.target_torque, t, -10.0, 10.0, 12),
            (x.stiffness, kp, 0.0, 500.0, 12),
            (x.damping, kd, 0.0, 5.0, 12),
        ):
            wanted = min(max(wanted, low), high)
            assert 0.0 <= wanted - found + 1e-9 <= (high - low) / (2**bits - 1) + 2e-9


def test_the_client_reads_the_feedback_to_its_resolution(client: DaMiaoMotor) -> None:
    bench = Bench(MASTER)
    bench.send(NODE, ON)
    for q, w in ((0.0, 0.0), (3.1, -7.0), (-12.4, 29.0), (40.0, -90.0)):
        bench.q, bench.w, bench.held = q, w, True
        bench.cycles(1)
        (data,) = bench.send(NODE, client.encode_cmd_msg(0.0, 0.0, 2.5, 0.0, 0.0))
        bench.cycles(1)
        (data,) = bench.send(NODE, client.encode_cmd_msg(0.0, 0.0, 2.5, 0.0, 0.0))
        found = client.decode_sensor_feedback(data, 0x15)
        assert found["status"] == "ENABLED" and found["can_id"] == NODE
        assert found["pos"] == pytest.approx(min(max(q, -12.5), 12.5), abs=25.0 / 65535)
        assert found["vel"] == pytest.approx(min(max(w, -30.0), 30.0), abs=60.0 / 4095)
        assert found["torq"] == pytest.approx(2.5, abs=2 * 20.0 / 4095)
        assert bench.said[-1][1] == 0x15


def test_in_mit_mode_it_is_a_spring_and_a_damper(client: DaMiaoMotor) -> None:
    bench = Bench(MASTER)
    bench.send(NODE, ON)
    bench.send(NODE, client.encode_cmd_msg(0.05, 0.0, 0.0, 100.0, 2.0))
    x = bench.x
    natural, damped = math.sqrt(x.stiffness), 0.5 * x.damping
    wave = math.sqrt(natural**2 - damped**2)
    for k in range(1, 1500):
        bench.cycles(1)
        t = (k + 0.5) * 1e-3  # half a cycle: the plant's own step
        swing = math.cos(wave * t) + damped / wave * math.sin(wave * t)
        exact = x.target_position * (1.0 - math.exp(-damped * t) * swing)
        assert bench.q == pytest.approx(exact, abs=1e-3), k
    bench.send(NODE, client.encode_cmd_msg(12.0, 0.0, 0.0, 500.0, 0.0))
    bench.cycles(1)
    assert bench.u == 10.0, "limited"


def test_orders_switch_it(client: DaMiaoMotor) -> None:
    bench = Bench(MASTER)
    assert bench.send(NODE, client.encode_cmd_msg(1.0, 0.0, 1.0, 0.0, 0.0))[0][0] >> 4 == 0
    assert bench.mistakes() == {"COMMAND_REFUSED": 1} and bench.cycles(1).u == 0.0
    assert bench.send(NODE, ON)[0][0] == 1 << 4 | NODE
    bench.send(NODE, client.encode_cmd_msg(0.0, 0.0, 1.0, 0.0, 0.0))
    assert bench.cycles(500).q > 0.1
    left = bench.x.target_position - bench.x.position
    bench.send(NODE, ZERO)
    assert bench.x.target_position - bench.x.position == left != 0.0, "it does not move by that"
    assert bench.send(NODE, FORGET)[0][0] == 1 << 4 | NODE, "there is no error"
    assert bench.x.position == 0.0 and abs(bench.cycles(1).x.position) < 1e-2
    assert bench.send(NODE, OFF)[0][0] == NODE and bench.cycles(1).u == 0.0
    assert bench.mistakes() == {"COMMAND_REFUSED": 1}


def test_a_silent_master_is_noticed_and_the_error_forgotten() -> None:
    bench = Bench(MASTER | {"TIMEOUT": 2000})  # 100 ms
    bench.send(NODE, ON)
    assert bench.cycles(101).x.power == 1 and bench.cycles(1).x.power == 13 and bench.u == 0.0
    assert bench.send(NODE, ON)[0][0] >> 4 == 13
    assert bench.mistakes() == {"SILENT": 1, "COMMAND_REFUSED": 1}
    bench.send(NODE, FORGET)
    assert bench.send(NODE, ON)[0][0] >> 4 == 1


def test_the_other_modes_reach_their_targets() -> None:
    bench = Bench(MASTER | {"CTRL_MODE": 2})
    bench.send(NODE, ON)
    bench.send(0x100 + NODE, struct.pack("<ff", 2.0, 1.0))
    fastest = max(abs(bench.cycles(1).w) for _ in range(5000))
    assert bench.q == pytest.approx(2.0, abs=1e-2) and fastest < 1.25
    write(bench, 10, 3)
    bench.send(0x200 + NODE, struct.pack("<f", -4.0))
    assert bench.cycles(4000).w == pytest.approx(-4.0, abs=1e-2)
    write(bench, 10, 4)
    bench.send(0x300 + NODE, struct.pack("<fHH", 0.0, 300, 65535))
    assert bench.x.most_torque == 10.0, "all of it, no more"
    bench.send(0x300 + NODE, struct.pack("<fHH", 0.0, 300, 500))
    most = max(abs(bench.cycles(1).u) for _ in range(8000))
    assert most == pytest.approx(0.05 * 10.0) and bench.mistakes() == {}
    bench.send(0x100 + NODE, struct.pack("<ff", 2.0, 1.0))
    assert bench.mistakes() == {"COMMAND_REFUSED": 1}, "of another mode"


def write(bench: Bench, number: int, value: float) -> bytes:
    """Write a register; return the answer's last four bytes."""
    whole = REGISTER_TABLE[number].data_type == "uint32"
    raw = struct.pack("<I", int(value)) if whole else struct.pack("<f", value)
    (answer,) = bench.send(0x7FF, bytes([NODE, 0, 0x55, number]) + raw)
    assert answer[:4] == bytes([NODE, 0, 0x55, number])
    return answer[4:]


def test_registers_are_those_of_the_client() -> None:
    bench = Bench(MASTER)
    for row, one in enumerate(mit.SETTINGS):
        known = REGISTER_TABLE[one.number]
        assert (known.data_type == "uint32") == one.whole, one
        assert (known.access == "RW") == (one.writable or one.name == "ESC_ID"), one
        (answer,) = bench.send(0x7FF, bytes([NODE, 0, 0x33, one.number]) + bytes(4))
        found = struct.unpack("<I" if one.whole else "<f", answer[4:])[0]
        other = {"ESC_ID": NODE} | MASTER
        assert found == pytest.approx(other.get(one.name, one.start)), one
        assert row == Key(row)
    assert struct.unpack("<f", write(bench, 23, 7.5))[0] == 7.5
    assert struct.unpack("<f", write(bench, 60, 12.0))[0] == 24.0, "it is read only"
    assert bench.send(0x7FF, bytes([NODE, 0, 0xAA, 1]) + bytes(4))[0][2] == 0xAA
    assert bench.send(0x7FF, bytes([NODE, 0, 0xCC, 0]) + bytes(4))[0][0] == NODE, "feedback"
    for odd in ("33 63 00000000", "11 07 00000000", "55 17 000000"):
        assert bench.send(0x7FF, bytes([NODE, 0]) + bytes.fromhex(odd)) == []
    assert bench.mistakes() == {"VALUE_REFUSED": 4}


def test_a_register_takes_its_limits_and_a_mode_begins_where_it_stands() -> None:
    bench = Bench(MASTER | {"CTRL_MODE": 2})
    bench.send(NODE, ON)
    bench.send(0x100 + NODE, struct.pack("<ff", 2.0, -1.0))
    assert bench.x.most_velocity == 1.0
    assert 0.0 < bench.cycles(200).x.position < bench.x.target_position == 2.0
    for value, kept in ((4, 4), (1, 1), (5, 1), (0, 1)):
        assert struct.unpack("<I", write(bench, 10, value))[0] == kept, value
    assert bench.x.target_position == bench.x.position and bench.mistakes() == {"VALUE_REFUSED": 2}


@pytest.mark.parametrize(("can_id", "data", "kind"), [
    (NODE, b"1234567", "FRAME_SHORT"), (0x100 + NODE, b"1234", "FRAME_SHORT"),
    (0x200 + NODE, b"123", "FRAME_SHORT"), (0x300 + NODE, b"", "FRAME_SHORT"),
    (0x100 + NODE, struct.pack("<ff", math.nan, 1.0), "NOT_FINITE"),
    (0x100 + NODE, struct.pack("<ff", 1.0, math.inf), "NOT_FINITE"),
])  # fmt: skip
def test_what_a_master_does_wrong_is_counted(can_id: int, data: bytes, kind: str) -> None:
    bench = Bench(MASTER | {"CTRL_MODE": 2})
    bench.send(NODE, ON)
    before = bytes(bench.r.state)
    bench.send(can_id, data)
    assert bench.mistakes() == {kind: 1} and bytes(bench.r.state) == before


def test_whose_a_frame_is() -> None:
    bench = Bench(MASTER)
    for can_id, whose in (
        (NODE, Whose.OURS),
        (0x100 + NODE, Whose.OURS),
        (0x300 + NODE, Whose.OURS),
        (0x400 + NODE, Whose.OTHER),
        (0x15, Whose.TWIN),
        (NODE + 1, Whose.OTHER),
        (NODE | 1 << 31, Whose.OTHER),
        (NODE | 1 << 30, Whose.OTHER),
    ):
        bench.send(can_id, bytes(8))
        assert bench.whose == whose, hex(can_id)
    for data, whose in (
        (bytes([NODE + 1, 0, 0x33, 7, 0, 0, 0, 0]), Whose.OTHER),
        (bytes([NODE, 0, 0x33, 7]), Whose.OURS),
        (bytes([NODE, 0, 0x33]), Whose.OTHER),
    ):
        bench.send(0x7FF, data)
        assert bench.whose == whose, data


def test_random_frames_leave_it_finite_and_alive() -> None:
    rng = np.random.default_rng(20261128)
    bench = Bench(MASTER)
    ids = (NODE, NODE, 0x100 + NODE, 0x200 + NODE, 0x300 + NODE, 0x7FF)
    for _ in range(20_000):
        can_id, data = int(rng.choice(ids)), rng.bytes(int(rng.integers(9)))
        if can_id == 0x7FF:
            data = bytes([NODE, 0, int(rng.choice((0x33, 0x55, 0xAA, 0xCC)))]) + data[:5]
        elif rng.random() < 0.2:
            data = (ON, OFF, ZERO, FORGET)[int(rng.integers(4))]
        bench.send(can_id, data)
        if rng.random() < 0.3:
            bench.cycles(1)
            assert math.isfinite(bench.u), bench.x
            bench.q, bench.w = min(max(bench.q, -1e3), 1e3), min(max(bench.w, -1e3), 1e3)
    for order in (FORGET, ON):
        bench.send(NODE, order)
    assert bench.x.power == 1
