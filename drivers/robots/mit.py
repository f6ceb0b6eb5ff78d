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

from pcpc.drivers.can.codec import four_bytes
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import LENGTH
from pcpc.drivers.compiled.structures import data_of
from pcpc.drivers.drive.layout import Whose
from pcpc.drivers.drive.outbox import put
from pcpc.drivers.robots.fields import (
    FINITE,
    big_word,
    coded,
    decoded,
    is_taken,
    number_at,
    put_big,
    row_of,
    value_in,
    value_word,
)
from pcpc.drivers.robots.layout import Mistake, Robot
from pcpc.drivers.robots.loops import start_here, torque_for, wanted_velocity
from pcpc.drivers.robots.settings import Setting, keys_of

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


SETTINGS = tuple(Setting(*row) for row in (
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
))  # fmt: skip


Key = keys_of("Mit", SETTINGS)
P_MAX, V_MAX, T_MAX = Key.PMAX, Key.VMAX, Key.TMAX


@loop_function
def boot(r: Robot) -> None:
    """Be as after power-on."""
    x = r.state
    x.boots += 1
    x.power, x.offset, x.torque = Power.OFF, 0.0, 0.0
    r.value[Key.ESC_ID] = r.node
    start_here(r)


@loop_function
def hear(r: Robot) -> int:
    """Take the frame in `rx`; return whose it is."""
    if r.state.boots == 0:
        boot(r)
    can_id, n, data = four_bytes(r.rx, 0), int64(r.rx[LENGTH]), data_of(r.rx)
    if can_id == REGISTERS:
        if n < 4 or (int64(data[0]) | int64(data[1]) << int64(8)) != r.node:
            return int64(Whose.OTHER)
        serve(r, data, n)
        return int64(Whose.OURS)
    mode = can_id >> 8
    if can_id & 0xFF == r.node and 1 <= mode <= 3:
        take_target(r, mode + 1, data, n)
    elif can_id == r.node:
        take_mit(r, n)
    elif can_id == int64(r.value[Key.MST_ID]):
        return int64(Whose.TWIN)
    else:
        return int64(Whose.OTHER)
    feed_back(r)
    return int64(Whose.OURS)


@loop_function
def take_mit(r: Robot, n: int) -> None:
    """Take an order or a command of MIT mode."""
    x, word = r.state, big_word(r)
    if n < 8:
        r.mistakes[Mistake.FRAME_SHORT] += 1
        return
    order = word & 255
    if word >> int64(8) == -1 and FORGET <= order <= ZERO:
        obey(r, order)
        return
    if int64(r.value[Key.CTRL_MODE]) != MitMode.MIT or x.power != Power.ON:
        r.mistakes[Mistake.COMMAND_REFUSED] += 1
        return
    x.fed_at = r.k
    p, v, t = r.value[P_MAX], r.value[V_MAX], r.value[T_MAX]
    x.target_position = decoded(word, 48, 16, -p, p)
    x.target_velocity = decoded(word, 36, 12, -v, v)
    x.stiffness = decoded(word, 24, 12, 0.0, STIFFEST)
    x.damping = decoded(word, 12, 12, 0.0, MOST_DAMPED)
    x.target_torque = decoded(word, 0, 12, -t, t)


@loop_function
def obey(r: Robot, order: int) -> None:
    """Switch on or off, let here be 0, or forget an error."""
    x = r.state
    x.fed_at = r.k
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
def take_target(r: Robot, mode: int, data: Cells[Byte], n: int) -> None:
    """Take a command of another mode than MIT."""
    x = r.state
    if n < (4 if mode == MitMode.VELOCITY else 8):
        r.mistakes[Mistake.FRAME_SHORT] += 1
        return
    if int64(r.value[Key.CTRL_MODE]) != mode or x.power != Power.ON:
        r.mistakes[Mistake.COMMAND_REFUSED] += 1
        return
    first, second = number_at(data, 0), 0.0
    if mode == MitMode.POSITION:
        second = number_at(data, 4)
    if not abs(first) < FINITE or not abs(second) < FINITE:
        r.mistakes[Mistake.NOT_FINITE] += 1
        return
    x.fed_at = r.k
    limit = r.value[P_MAX]
    x.most_torque = r.value[T_MAX]
    if mode == MitMode.VELOCITY:
        limit = r.value[V_MAX]
        x.target_velocity, x.most_velocity = min(max(first, -limit), limit), limit
    else:
        x.target_position, x.most_velocity = min(max(first, -limit), limit), abs(second)
    r.mistakes[Mistake.TARGET_CLIPPED] += 1 if abs(first) > limit else 0
    if mode == MitMode.FORCE:
        word = four_bytes(data, 4)
        x.most_velocity = 0.01 * (word & 0xFFFF)
        x.most_torque = 1e-4 * min(word >> 16, 10_000) * r.value[T_MAX]


@loop_function
def serve(r: Robot, data: Cells[Byte], n: int) -> None:
    """Read, write or save a register, or say where the motor is."""
    request, number = int64(data[2]), int64(data[3])
    row = row_of(r, number)
    if request == REFRESH:
        feed_back(r)
        return
    if request == SAVE:
        reply(r, request, int64(1), int64(0))
        return
    if row < 0 or (request != READ and request != WRITE) or (request == WRITE and n < 8):
        r.mistakes[Mistake.VALUE_REFUSED] += 1
        return
    if request == WRITE:
        value = value_in(r, row, data, 4)
        if is_taken(r, row, value):
            r.value[row] = value
            if row == Key.CTRL_MODE:
                start_here(r)
    r.value[Key.P_M] = r.value[Key.XOUT] = r.state.position
    reply(r, request, number, value_word(r, row))


@loop_function
def reply(r: Robot, what: int, number: int, word: int) -> None:
    """Answer about a register."""
    low = r.node | what << int64(16) | number << int64(24)
    put(r, int64(r.value[Key.MST_ID]), 8, low, word)


@loop_function
def feed_back(r: Robot) -> None:
    """Say where the motor is, and how it is."""
    x = r.state
    p, v, t = r.value[P_MAX], r.value[V_MAX], r.value[T_MAX]
    word = (r.node & 15 | x.power << int64(4)) << int64(56)
    word |= coded(x.position, 40, 16, -p, p) | coded(x.velocity, 28, 12, -v, v)
    word |= coded(x.torque, 16, 12, -t, t)
    word |= int64(r.value[Key.TPCB]) << int64(8) | int64(r.value[Key.TMTR])
    put_big(r, int64(r.value[Key.MST_ID]), word)


@loop_function
def work(r: Robot) -> int:
    """Do a cycle, to the torque."""
    x = r.state
    if x.boots == 0:
        boot(r)
    patience = r.value[Key.TIMEOUT] * TICK_S * r.rate_hz
    if patience > 0.0 and x.power == Power.ON and r.k - x.fed_at > patience:
        x.power = Power.LOST
        r.mistakes[Mistake.SILENT] += 1
    x.torque = 0.0
    if x.power != Power.ON:
        x.integral = 0.0
        return int64(0)
    mode, torque_limit = int64(r.value[Key.CTRL_MODE]), r.value[T_MAX]
    if mode == MitMode.MIT:
        stiff = x.stiffness * (x.target_position - x.position)
        torque = stiff + x.damping * (x.target_velocity - x.velocity) + x.target_torque  # (1)
        x.torque = min(max(torque, -torque_limit), torque_limit)
    elif mode == MitMode.VELOCITY:
        x.torque = torque_for(r, x.target_velocity, torque_limit)
    else:
        x.way_position, x.way_velocity = x.target_position, 0.0
        limit = min(x.most_torque, torque_limit)
        x.torque = torque_for(r, wanted_velocity(r, x.most_velocity), limit)
    return int64(0)


@loop_function
def speak(r: Robot) -> int:
    """Send nothing: a motor only answers."""
    return int64(0)
