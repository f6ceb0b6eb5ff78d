"""A million mutants of what masters send, to a drive of each dialect: it stays finite and alive."""

import struct

import moteus
import numpy as np
import pytest
from benches import NODE, Bench, MoteusBench, ODriveBench, RobStrideBench

from pcpc.drivers.robots import mit, moteus_registers, robstride
from pcpc.drivers.robots.odrive_settings import SETTINGS, CommandId

EXT = 1 << 31
NUMBERS = (b"\0\0\0\0", b"\0\0\x80\x3f", b"\0\0\xc0\xff", b"\0\0\x80\x7f", b"\xff\xff\x7f\x7f")
Frames = list[tuple[int, bytes]]


def of_odrive() -> Frames:
    """Return commands, and a write of each setting."""
    frames = [
        (NODE << 5 | command, value + value) for command in CommandId for value in NUMBERS[:2]
    ]
    frames += [(NODE << 5 | CommandId.STATE, struct.pack("<I", 8))] * 8
    frames += [(NODE << 5 | CommandId.CLEAR, b"")] * 4
    numbers = range(len(SETTINGS))
    return frames + [
        (NODE << 5 | 4, bytes([1, i, 0, 0]) + value) for i in numbers for value in NUMBERS
    ]


def of_mit() -> Frames:
    """Return orders, commands of all modes, and a write of each register."""
    frames = [(NODE, bytes([255] * 7 + [order])) for order in (0xFC, 0xFC, 0xFC, 0xFD, 0xFE, 0xFB)]
    frames += [(NODE, bytes(range(i, i + 8))) for i in range(0, 240, 8)]
    frames += [
        (base + NODE, x + y) for base in (0x100, 0x200, 0x300) for x in NUMBERS for y in NUMBERS
    ]
    numbers = [one.number for one in mit.SETTINGS]
    return frames + [
        (0x7FF, bytes([NODE, 0, 0x55, i]) + value) for i in numbers for value in NUMBERS
    ]


def of_moteus() -> Frames:
    """Return commands of the client, and a write of each register."""
    client = moteus.Controller(id=NODE)
    made = [
        client.make_position(query=True, position=1.0, velocity=0.5, watchdog_timeout=100.0),
        client.make_position(query=True, position=-1.0, accel_limit=2.0, velocity_limit=1.0),
        client.make_position(query=True, velocity=0.5, stop_position=2.0), client.make_stop(),
        client.make_stay_within(lower_bound=-1.0, upper_bound=1.0), client.make_query(),
        client.make_current(q_A=1.0, d_A=0.0), client.make_brake(query=True),
        client.make_set_output_exact(position=0.3), client.make_stop(query=True),
    ]  # fmt: skip
    word = EXT | 0x8000 | NODE
    numbers = [one.number for one in moteus_registers.SETTINGS if 0 <= one.number < 128]
    frames = [(word, bytes(one.data)) for one in made] * 4
    return frames + [(word, bytes([0x0D, i]) + value) for i in numbers for value in NUMBERS]


def of_robstride() -> Frames:
    """Return an order of each type, and a write and read of each setting."""
    word = EXT | 0xFD << 8 | NODE
    frames = [(word | kind << 24, bytes([1, 2, 3, 4, 5, 6, 1, 0])) for kind in robstride.Kind]
    frames += [(word | 3 << 24, bytes(8)), (word | 4 << 24, bytes([1] + [0] * 7))] * 8
    frames += [(word | 1 << 24, bytes(range(i, i + 8))) for i in range(0, 240, 8)]
    frames = [one for one in frames if one[0] >> 24 & 31 != robstride.Kind.NODE]  # it would be gone
    for number in (one.number for one in robstride.SETTINGS if one.number > 0):
        head = struct.pack("<HH", number, 0)
        frames += [
            (word | 0x12 << 24, head + value) for value in (*NUMBERS, b"\1\0\0\0", b"\5\0\0\0")
        ]
        frames += [(word | 0x11 << 24, head + bytes(4))]
    return frames


@pytest.mark.parametrize(("bench", "frames", "loose"), [
    (ODriveBench, of_odrive, 0x1F), (Bench, of_mit, 0x300), (MoteusBench, of_moteus, 0x7F00),
    (RobStrideBench, of_robstride, 0x00FF_0000),
])  # fmt: skip
@pytest.mark.parametrize("count", [20_000, pytest.param(1_000_000, marks=pytest.mark.deep)])
def test_mutants_leave_it_finite_and_alive(
    bench: type[Bench], frames: object, loose: int, count: int
) -> None:
    one = bench({"MST_ID": 0x15} if bench is Bench else None)
    assert callable(frames)
    cycles = one.storm(frames(), loose, count)
    assert cycles > count // 6, cycles
    x, alive = one.x, {ODriveBench: 8, Bench: 1, MoteusBench: 10, RobStrideBench: 2}[bench]
    assert x.boots > 0 and sum(one.mistakes().values()) > count // 100, one.mistakes()
    values = np.array(one.r.value[: one.r.n])
    assert np.all(np.isfinite(values[~np.isnan([row.start for row in one.kind[1]])])), values
    one.q = one.w = 0.0
    one.cycles(1)
    if bench is ODriveBench:
        one.send(NODE << 5 | CommandId.REBOOT, b"\0")
        one.send(NODE << 5 | CommandId.STATE, struct.pack("<I", 8))
    elif bench is Bench:
        for order in (0xFB, 0xFC):
            one.send(NODE, bytes([255] * 7 + [order]))
    elif bench is MoteusBench:
        client = moteus.Controller(id=NODE)
        for command in (client.make_stop(), client.make_position(position=float("nan"))):
            one.send(EXT | NODE, bytes(command.data))
    else:
        one.send(EXT | 4 << 24 | NODE, bytes([1] + [0] * 7))
        one.send(EXT | 3 << 24 | NODE, bytes(8))
    assert one.x.power == alive, x
