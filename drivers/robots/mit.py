"""Damiao's motors and their like: MIT mode, with position and velocity modes and registers.

    id            8 bytes
    node          FF x 7 and FC on, FD off, FE here is 0, FB forget the error
    node          mode 1, MIT: position 16, velocity 12, stiffness 12, damping 12, torque 12 bits
    0x100 + node  mode 2: position, largest velocity      float32 each
    0x200 + node  mode 3: velocity                        float32
    0x300 + node  mode 4: position float32, largest velocity in 0.01, torque in 0.0001 of T_max
    0x7FF         node 2 bytes; 33 read, 55 write, AA save, CC say where you are; register; value

    T = stiffness (q_d - q) + damping (w_d - w) + t,  |T| <= T_max       MIT                  (1)

Positions go from -P_max to P_max, as velocities and torques; stiffness to 500, damping to 5. The
bits are the whole part of (x - low) (2^n - 1)/(high - low). Each command is answered with the
feedback: error << 4 | node, position 16, velocity 12, torque 12 bits, two temperatures, with the id
in register 7. A mode's command in another mode does nothing. With a time-out in register 9 (50 us
each) a motor that is on and hears no command has error D. Source: the motors' manual.
"""

import numpy as np

from pcpc.drivers.can.codec import four_bytes
from pcpc.drivers.canopen.frames import put
from pcpc.drivers.canopen.layout import Drive
from pcpc.drivers.canopen.node import Whose
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import LENGTH
from pcpc.drivers.compiled.structures import data_of
from pcpc.drivers.robots.layout import Mistake, Robot
from pcpc.drivers.robots.loops import (
    FINITE,
    number_at,
    start_here,
    torque_for,
    wanted_velocity,
    word_of,
)
from pcpc.drivers.robots.settings import Setting

NODES = 256
REGISTERS = 0x7FF
STIFFEST, MOST_DAMPED = 500.0, 5.0
ON, OFF, ZERO, FORGET = 0xFC, 0xFD, 0xFE, 0xFB
READ, WRITE, SAVE, REFRESH = 0x33, 0x55, 0xAA, 0xCC
TICK_S = 50e-6


class Power(NumberedEnum):
    """What the upper half of the feedback's first byte says."""

    OFF, ON, LOST = 0, 1, 13


class MitMode(NumberedEnum):
    """Register 10."""

    MIT, POSITION, VELOCITY, FORCE = 1, 2, 3, 4


class MitKey(NumberedEnum):
    """Rows of the settings: registers by name."""

    (
        MASTER, NODE, TIMEOUT, MODE, VERSION, POLES, P_MAX, V_MAX, T_MAX, VOLTAGE, BOARD, ROTOR,
        POSITION, OUTPUT,
    ) = range(14)  # fmt: skip


_REGISTERS: tuple[tuple[str, int, float, float, float, bool, bool], ...] = (
    ("MST_ID", 7, 0.0, 0.0, 2047.0, True, True),
    ("ESC_ID", 8, 1.0, 0.0, 2047.0, True, False),
    ("TIMEOUT", 9, 0.0, 0.0, 4294967295.0, True, True),
    ("CTRL_MODE", 10, 1.0, 1.0, 4.0, True, True),
    ("sw_ver", 14, 1.0, 0.0, 4294967295.0, True, False),
    ("NPP", 16, 14.0, 0.0, 255.0, True, False),
    ("PMAX", 21, 12.5, 1e-6, 3.4e38, False, True),
    ("VMAX", 22, 30.0, 1e-6, 3.4e38, False, True),
    ("TMAX", 23, 10.0, 1e-6, 3.4e38, False, True),
    ("VBus", 60, 24.0, 0.0, 1e6, False, False),
    ("Tpcb", 61, 25.0, 0.0, 255.0, False, False),
    ("Tmtr", 62, 25.0, 0.0, 255.0, False, False),
    ("p_m", 80, 0.0, -3.4e38, 3.4e38, False, False),
    ("xout", 81, 0.0, -3.4e38, 3.4e38, False, False),
)
SETTINGS = tuple(
    Setting(name, number, start, low, high, whole, writable)
    for name, number, start, low, high, whole, writable in _REGISTERS
)


@loop_inline
def raw_value(x: float, low: float, high: float, bits: int) -> int:
    """Return a value as so many bits."""
    x = min(max(x, low), high)
    return int64((x - low) * ((int64(1) << int64(bits)) - 1) / (high - low))


@loop_inline
def decoded(code: int, low: float, high: float, bits: int) -> float:
    """Return the value that so many bits are."""
    return code * (high - low) / ((int64(1) << int64(bits)) - 1) + low


@loop_function
def boot(r: Robot, d: Drive) -> None:
    """Be as after power-on."""
    x = r.state
    x.boots += 1
    x.power, x.offset, x.torque = Power.OFF, 0.0, 0.0
    r.value[MitKey.NODE] = d.node
    start_here(r)


@loop_function
def hear(r: Robot, d: Drive, frame: Cells[Byte]) -> int:
    """Take a frame that came; return whose it is."""
    if r.state.boots == 0:
        boot(r, d)
    can_id, n, data = four_bytes(frame, 0), int64(frame[LENGTH]), data_of(frame)
    if can_id == REGISTERS:
        if n < 4 or (int64(data[0]) | int64(data[1]) << int64(8)) != d.node:
            return int64(Whose.OTHER)
        serve(r, d, data, n)
        return int64(Whose.OURS)
    mode = can_id >> 8
    if can_id & 0xFF == d.node and 1 <= mode <= 3:
        take_target(r, d, mode + 1, data, n)
    elif can_id == d.node:
        take_mit(r, d, data, n)
    elif can_id == int64(r.value[MitKey.MASTER]):
        return int64(Whose.TWIN)
    else:
        return int64(Whose.OTHER)
    feed_back(r, d)
    return int64(Whose.OURS)


@loop_function
def take_mit(r: Robot, d: Drive, data: Cells[Byte], n: int) -> None:
    """Take an order or a command of MIT mode."""
    x = r.state
    if n < 8:
        r.mistakes[Mistake.FRAME_SHORT] += 1
        return
    if four_bytes(data, 0) == 0xFFFFFFFF and four_bytes(data, 4) & 0xFFFFFF == 0xFFFFFF:
        order = int64(data[7])
        if FORGET <= order <= ZERO:
            obey(r, d, order)
            return
    if int64(r.value[MitKey.MODE]) != MitMode.MIT or x.power != Power.ON:
        r.mistakes[Mistake.COMMAND_REFUSED] += 1
        return
    x.fed_at = d.k
    p, v, t = r.value[MitKey.P_MAX], r.value[MitKey.V_MAX], r.value[MitKey.T_MAX]
    one, two, three, four, five, six = data[2], data[3], data[4], data[5], data[6], data[7]
    position = int64(data[0]) << int64(8) | int64(data[1])
    velocity = int64(one) << int64(4) | int64(two) >> int64(4)
    stiffness = (int64(two) & 15) << int64(8) | int64(three)
    damping = int64(four) << int64(4) | int64(five) >> int64(4)
    torque = (int64(five) & 15) << int64(8) | int64(six)
    x.target_position = decoded(position, -p, p, 16)
    x.target_velocity = decoded(velocity, -v, v, 12)
    x.stiffness = decoded(stiffness, 0.0, STIFFEST, 12)
    x.damping = decoded(damping, 0.0, MOST_DAMPED, 12)
    x.target_torque = decoded(torque, -t, t, 12)


@loop_function
def obey(r: Robot, d: Drive, order: int) -> None:
    """Switch on or off, let here be 0, or forget an error."""
    x = r.state
    x.fed_at = d.k
    if order == ON and x.power == Power.LOST:
        r.mistakes[Mistake.COMMAND_REFUSED] += 1
    elif order == ON:
        if x.power != Power.ON:
            start_here(r)
        x.power = Power.ON
    elif (order == OFF and x.power == Power.ON) or (order == FORGET and x.power == Power.LOST):
        x.power = Power.OFF
    elif order == ZERO:
        x.offset -= x.position
        x.target_position -= x.position
        x.position = 0.0


@loop_function
def take_target(r: Robot, d: Drive, mode: int, data: Cells[Byte], n: int) -> None:
    """Take a command of another mode than MIT."""
    x = r.state
    if n < (4 if mode == MitMode.VELOCITY else 8):
        r.mistakes[Mistake.FRAME_SHORT] += 1
        return
    if int64(r.value[MitKey.MODE]) != mode or x.power != Power.ON:
        r.mistakes[Mistake.COMMAND_REFUSED] += 1
        return
    first, second = number_at(data, 0), 0.0
    if mode == MitMode.POSITION:
        second = number_at(data, 4)
    if not abs(first) < FINITE or not abs(second) < FINITE:
        r.mistakes[Mistake.NOT_FINITE] += 1
        return
    x.fed_at = d.k
    limit = r.value[MitKey.P_MAX]
    x.most_torque = r.value[MitKey.T_MAX]
    if mode == MitMode.VELOCITY:
        limit = r.value[MitKey.V_MAX]
        x.target_velocity, x.most_velocity = min(max(first, -limit), limit), limit
    else:
        x.target_position, x.most_velocity = min(max(first, -limit), limit), abs(second)
    r.mistakes[Mistake.TARGET_CLIPPED] += 1 if abs(first) > limit else 0
    if mode == MitMode.FORCE:
        word = four_bytes(data, 4)
        x.most_velocity = 0.01 * (word & 0xFFFF)
        x.most_torque = 1e-4 * min(word >> 16, 10_000) * r.value[MitKey.T_MAX]


@loop_function
def serve(r: Robot, d: Drive, data: Cells[Byte], n: int) -> None:
    """Read, write or save a register, or say where the motor is."""
    request, number, row = int64(data[2]), int64(data[3]), -1
    if request == REFRESH:
        feed_back(r, d)
        return
    for i in range(r.n):
        if r.settings[i].number == number:
            row = i
    if request == SAVE:
        reply(r, d, request, int64(1), int64(0))
        return
    if row < 0 or (request != READ and request != WRITE) or (request == WRITE and n < 8):
        r.mistakes[Mistake.VALUE_REFUSED] += 1
        return
    setting = r.settings[row]
    if request == WRITE:
        value = np.float64(four_bytes(data, 4)) if setting.whole != 0 else number_at(data, 4)
        if not setting.low <= value <= setting.high or setting.writable == 0:
            r.mistakes[Mistake.VALUE_REFUSED] += 1
        else:
            r.value[row] = value
            if row == MitKey.MODE:
                start_here(r)
    r.value[MitKey.POSITION] = r.value[MitKey.OUTPUT] = r.state.position
    value = r.value[row]
    reply(r, d, request, number, int64(value) if setting.whole != 0 else word_of(value))


@loop_function
def reply(r: Robot, d: Drive, what: int, number: int, word: int) -> None:
    """Answer about a register."""
    low = d.node | what << int64(16) | number << int64(24)
    put(d, int64(r.value[MitKey.MASTER]), 8, low, word)


@loop_function
def feed_back(r: Robot, d: Drive) -> None:
    """Say where the motor is, and how it is."""
    x = r.state
    p, v, t = r.value[MitKey.P_MAX], r.value[MitKey.V_MAX], r.value[MitKey.T_MAX]
    first = d.node & 15 | x.power << int64(4)
    position, velocity = raw_value(x.position, -p, p, 16), raw_value(x.velocity, -v, v, 12)
    torque = raw_value(x.torque, -t, t, 12)
    low = first | (position >> 8) << 8 | (position & 255) << 16 | (velocity >> 4) << 24
    high = (velocity & 15) << 4 | torque >> 8 | (torque & 255) << 8
    high |= int64(r.value[MitKey.BOARD]) << 16 | int64(r.value[MitKey.ROTOR]) << 24
    put(d, int64(r.value[MitKey.MASTER]), 8, low, high)


@loop_function
def work(r: Robot, d: Drive) -> float:
    """Do a cycle; return the torque."""
    x = r.state
    if x.boots == 0:
        boot(r, d)
    patience = r.value[MitKey.TIMEOUT] * TICK_S * d.rate_hz
    if patience > 0.0 and x.power == Power.ON and d.k - x.fed_at > patience:
        x.power = Power.LOST
        r.mistakes[Mistake.SILENT] += 1
    x.torque = 0.0
    if x.power != Power.ON:
        x.integral = 0.0
        return 0.0
    mode, torque_limit = int64(r.value[MitKey.MODE]), r.value[MitKey.T_MAX]
    if mode == MitMode.MIT:
        stiff = x.stiffness * (x.target_position - x.position)
        torque = stiff + x.damping * (x.target_velocity - x.velocity) + x.target_torque  # (1)
        x.torque = min(max(torque, -torque_limit), torque_limit)
    elif mode == MitMode.VELOCITY:
        x.torque = torque_for(r, d, x.target_velocity, torque_limit)
    else:
        x.way_position, x.way_velocity = x.target_position, 0.0
        limit = min(x.most_torque, torque_limit)
        x.torque = torque_for(r, d, wanted_velocity(r, d, x.most_velocity), limit)
    return x.torque


@loop_function
def speak(r: Robot, d: Drive) -> None:
    """Send nothing: a motor only answers."""
