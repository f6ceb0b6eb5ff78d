"""Whose order a frame is, of frames that others' clients make."""

import struct
from functools import partial
from typing import Any

import can
import moteus
import numpy as np
import pytest
from benches import NODE, BenchBus, RobStrideBench
from damiao_motor.core.motor import DaMiaoMotor
from robstride import Client

from pcpc.drivers.can.wire_layout import Flag
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.structures import structure
from pcpc.drivers.drive.foreign import Maker, maker_of
from pcpc.drivers.robots.layout import Robot

EXT, REMOTE = 1 << 31, 1 << 30
STOP = bytes([1, 0, 0])  # to a moteus
structure(Robot.dtype)


@loop_function
def heard(r: Any, node: int) -> Any:
    """Return it of the frame in `rx`: in compiled code frames lie in structures."""
    return maker_of(r.rx, node)


def maker(word: int, data: bytes, flags: int = 0, node: int = NODE) -> int:
    """Return whose order to a node a frame is."""
    robot: Any = np.zeros(1, Robot.dtype).view(np.recarray)[0]
    frame = robot.rx
    frame[:4] = list(word.to_bytes(4, "little"))
    frame[4], frame[5] = len(data), flags
    frame[8 : 8 + len(data)] = list(data)
    return int(heard(robot, node))


def test_what_clients_send_to_switch_a_drive_on_is_recognised() -> None:
    bus = partial(can.Bus, "foreign", interface="virtual")
    with bus() as sending, bus() as other:
        DaMiaoMotor(NODE, 0x15, sending, motor_type="4310").enable()
        message = other.recv(1.0)
    assert message is not None
    assert maker(message.arbitration_id, bytes(message.data)) == Maker.MIT
    stop = moteus.Controller(id=NODE).make_stop()
    assert maker(EXT | 0x8000 | NODE, bytes(stop.data), Flag.FD) == Maker.MOTEUS
    bench = RobStrideBench()
    with BenchBus(bench, 0) as bus:
        Client(bus).enable(NODE)
    rx = bytes(bench.r.rx)
    assert maker(int.from_bytes(rx[:4], "little"), rx[8:16]) == Maker.ROBSTRIDE
    assert maker(NODE << 5 | 7, struct.pack("<I", 8)) == Maker.ODRIVE
    assert maker(0, bytes([1, NODE])) == maker(0, bytes([0x81, NODE])) == Maker.CIA402
    write = EXT | 0x1200_FD00 | NODE
    assert maker(write, bytes(8)) == Maker.ROBSTRIDE
    assert maker(0x600 + NODE, bytes([0x40, 0x41, 0x60, 0, 0, 0, 0, 0])) == Maker.CIA402


@pytest.mark.parametrize(("word", "data", "flags"), [
    (NODE + 1, bytes([255] * 7 + [0xFC]), 0), (NODE, bytes([255] * 7 + [0xFA]), 0),
    (NODE, bytes([255] * 6 + [0, 0xFC]), 0), (NODE, bytes([255] * 7), 0),
    (NODE | REMOTE, bytes([255] * 7 + [0xFC]), 0), (NODE | EXT, bytes([255] * 7 + [0xFC]), 0),
    (EXT | 0x0300_FD00 | NODE + 1, bytes(8), 0), (EXT | 0x1B00_FD00 | NODE, bytes(8), 0),
    (EXT | 0x8000 | NODE + 1, STOP, Flag.FD), (EXT | 0x1_0000 | NODE, STOP, Flag.FD),
    (EXT | 0x8000 | NODE, bytes(64), Flag.FD), (NODE, b"\x01", Flag.FD),
    (EXT | 0x18FE_F100 | NODE, bytes(8), 0), (EXT | 0x0CF0_0400 | NODE, bytes(8), 0),  # J1939
    (EXT | 0x0300_FD00 | NODE, bytes(7), 0),
    ((NODE + 1) << 5 | 7, struct.pack("<I", 8), 0), (NODE << 5 | 7, struct.pack("<I", 2), 0),
    (NODE << 5 | 7, b"\x08\0\0", 0), (NODE << 5 | 6, struct.pack("<I", 8), 0),
    (0, bytes([1, NODE + 1]), 0), (0, bytes([1, 0]), 0), (0, bytes([0x81, 0]), 0),
    (0, bytes([1, NODE, 0]), 0),
    (0x600 + NODE, bytes(7), 0), (0x601 + NODE, bytes(8), 0), (0x123, bytes(8), 0),
])  # fmt: skip
def test_what_is_nobodys_order_to_this_node(word: int, data: bytes, flags: int) -> None:
    assert maker(word, data, flags) == -1
