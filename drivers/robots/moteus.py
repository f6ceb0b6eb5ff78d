"""The register protocol of moteus on CAN FD: turns, N m, A, s, as int8, int16, int32 or float32.

    id           source << 8 | node, + 0x8000: answer, with source and node exchanged
    00 04 08 0C  write: number of registers in 2 bits, or behind them; first register; values
    10 14 18 1C  read, 20 24 28 2C the answer
    30 31        a write, a read that failed: register, error (1 none, 2 read-only, 3 value)
    50           nothing; fills the frame up

Numbers and counts have 7 bits in a byte. The smallest whole number is NaN. A mode that is written
takes with it the commands 0x01C to 0x048 of its frame; those that are not in it have their default.

An answer has the switch of bit rate of its question, and at most 64 bytes. Streams for diagnosis
(40 to 44) are refused. What moves it stands in `moteus_motion`. Source: the controller's reference,
its firmware and its Python package.
"""

import math

import numpy as np

from pcpc.drivers.can.codec import four_bytes, put_four_bytes
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import FLAGS, FRAME_BYTES, LENGTH, Flag
from pcpc.drivers.compiled.structures import data_of
from pcpc.drivers.drive.layout import OUTBOX_FRAMES, Whose
from pcpc.drivers.robots.fields import FINITE, number_at, short_at, word_of
from pcpc.drivers.robots.layout import Mistake, Robot
from pcpc.drivers.robots.loops import place_at
from pcpc.drivers.robots.moteus_motion import boot, damping, obey, stiffness, work
from pcpc.drivers.robots.moteus_registers import (
    COMMANDS,
    KIND,
    READ_ONLY,
    REGISTERS,
    ROW,
    SCALES,
    Coding,
    Key,
    MoteusMode,
    Register,
)

__all__ = ["NODES", "boot", "hear", "speak", "work"]
NODES = 127  # 0x7F is all of them
LONGEST = 64
ANSWER, EXTENDED, REMOTE = 0x8000, int64(1 << 31), int64(1 << 30)
INT8, INT16, INT32, FLOAT = 0, 1, 2, 3
WRITE_FAILED, READ_FAILED, NOTHING = 0x30, 0x31, 0x50
NO_REGISTER, NOT_WRITABLE, WRONG_VALUE = 1, 2, 3


@loop_function
def hear(r: Robot) -> int:
    """Take the frame in `rx`; return whose it is."""
    if r.state.boots == 0:
        boot(r)
    word, flags = four_bytes(r.rx, 0), int64(r.rx[FLAGS])
    can_id = word & ~EXTENDED
    if can_id > 0xFFFF or word & REMOTE != 0 or flags & Flag.FD == 0:
        return int64(Whose.OTHER)
    source, whom = can_id >> 8 & 0x7F, can_id & 0xFF
    if whom != r.node and whom != NODES:
        twin = source == r.node and can_id & ANSWER == 0
        return int64(Whose.TWIN if twin else Whose.OTHER)
    r.mistakes[Mistake.NOT_SWITCHED] += r.switches if flags & Flag.BRS == 0 else 0
    c = r.cursor
    c.at, c.end, c.ok, c.out = 0, min(int64(r.rx[LENGTH]), LONGEST), 1, 0
    c.answers = 1 if can_id & ANSWER != 0 and r.n_out < OUTBOX_FRAMES else 0
    c.mode = -1
    while c.ok != 0 and c.at < c.end:
        take_subframe(r, data_of(r.rx))
    if c.mode >= 0:
        obey(r, c.mode)
    if c.answers != 0:
        answer(r, r.node << int64(8) | source, flags & Flag.BRS | Flag.FD)
    return int64(Whose.OURS)


@loop_function
def answer(r: Robot, can_id: int, flags: int) -> None:
    """Let the outbox have the answer that was written into it."""
    c, frame, n = r.cursor, r.outbox[r.n_out], r.cursor.out
    if n > 8:
        step = 4 if n <= 24 else (8 if n <= 32 else 16)
        n = (n + step - 1) // step * step
    put_four_bytes(frame, 0, can_id | EXTENDED if can_id > 0x7FF else can_id)
    put_four_bytes(frame, 4, n | flags << int64(8))
    for i in range(8 + c.out, FRAME_BYTES):
        frame[i] = NOTHING if i < 8 + n else 0
    r.n_out += 1


@loop_function
def say(r: Robot, byte: int) -> None:
    """Write a byte of the answer, if there is one and it has room."""
    c = r.cursor
    if c.answers != 0 and c.out < LONGEST:
        data_of(r.outbox[r.n_out])[c.out] = byte & 255
        c.out += 1


@loop_function
def say_number(r: Robot, number: int) -> None:
    """Write a number in 7 bits a byte."""
    while number > 127:
        say(r, number & 127 | 128)
        number >>= 7
    say(r, number)


@loop_function
def say_failed(r: Robot, code: int, register: int, error: int) -> None:
    """Write that a register could not be read or written, and count it."""
    r.mistakes[Mistake.VALUE_REFUSED] += 1
    if r.cursor.out > LONGEST - 7:
        r.cursor.ok = 0
        return
    say(r, int64(code))
    say_number(r, register)
    say(r, int64(error))


@loop_function
def number_of(r: Robot, data: Cells[Byte]) -> int:
    """Take a number in 7 bits a byte; `ok` 0: there is none."""
    c, number = r.cursor, int64(0)
    for i in range(5):
        if c.at < c.end:
            byte = int64(data[c.at])
            c.at += 1
            number |= (byte & 127) << int64(7 * i)
            if byte < 128:
                return number
    return is_cut(r)


@loop_function
def is_cut(r: Robot) -> int:
    """Count a frame that ends too early; return 0."""
    r.cursor.ok = 0
    r.mistakes[Mistake.FRAME_SHORT] += 1
    return int64(0)


@loop_function
def take_subframe(r: Robot, data: Cells[Byte]) -> None:
    """Take what follows in the frame."""
    c = r.cursor
    operation = int64(data[c.at])
    c.at += 1
    if operation == NOTHING:
        return
    if operation >= 0x20:
        c.ok = 0
        r.mistakes[Mistake.COMMAND_REFUSED] += 1
        return
    kind, count = operation >> 2 & 3, operation & 3
    if count == 0:
        count = number_of(r, data)
    if c.ok != 0 and count > 0:
        first = number_of(r, data)
        if c.ok != 0 and operation < 0x10:
            take_values(r, data, kind, first, count)
        elif c.ok != 0 and c.answers != 0:
            tell(r, kind, first, count)


@loop_inline
def size_of(kind: int) -> int:
    """Return the bytes of a value."""
    return 1 if kind == INT8 else (2 if kind == INT16 else 4)


@loop_function
def value_at(data: Cells[Byte], offset: int, kind: int) -> float:
    """Return the value there, as it is sent."""
    if kind == FLOAT:
        return number_at(data, offset)
    if kind == INT8:
        byte = int64(data[offset])
        return np.float64(byte - 256 if byte >= 128 else byte)
    if kind == INT16:
        return short_at(data, offset)
    word = four_bytes(data, offset)
    return np.float64(word - 4294967296 if word >= 1 << 31 else word)


@loop_function
def take_values(r: Robot, data: Cells[Byte], kind: int, first: int, count: int) -> None:
    """Take the values of a write."""
    c, size, i = r.cursor, size_of(kind), 0
    while i < count and c.ok != 0:
        if c.at + size > c.end:
            is_cut(r)
            return
        raw = value_at(data, c.at, kind)
        c.at += size
        error = write(r, first + i, kind, raw)
        if error != 0:
            say_failed(r, WRITE_FAILED, first + i, error)
        i += 1


@loop_function
def scaled_value(coding: int, kind: int, raw: float) -> float:
    """Return what a value means; the smallest whole number is NaN."""
    if kind == FLOAT or coding == Coding.WHOLE:
        return raw
    if raw == (-128.0 if kind == INT8 else (-32768.0 if kind == INT16 else -2147483648.0)):
        return math.nan
    return raw * SCALES[3 * coding + kind]


@loop_function
def write(r: Robot, register: int, kind: int, raw: float) -> int:
    """Write a register; return the error."""
    if register >= REGISTERS:
        return NO_REGISTER
    if register == Register.MODE:
        return take_mode(r, raw)
    if register == Register.NEAREST or register == Register.EXACT:
        place = scaled_value(Coding.POSITION, kind, raw)
        place_at(r, place)
        return 0 if abs(place) < FINITE else WRONG_VALUE
    if register == Register.RECAPTURE:
        r.state.way_position, r.state.way_velocity = r.state.position, r.state.velocity
        return 0
    if READ_ONLY[register] != 0:
        return NOT_WRITABLE
    row = ROW[register]
    if row < 0:
        return NO_REGISTER
    value = scaled_value(KIND[register], kind, raw)
    if abs(value) >= FINITE:
        r.mistakes[Mistake.NOT_FINITE] += 1
        return WRONG_VALUE
    r.value[row] = value
    return 0


@loop_function
def take_mode(r: Robot, raw: float) -> int:
    """Note the mode that is asked for, with the defaults of all commands; return the error."""
    known = raw == MoteusMode.STOPPED or raw == MoteusMode.CURRENT or raw == MoteusMode.POSITION
    known = (
        known
        or raw == MoteusMode.ZERO_VELOCITY
        or raw == MoteusMode.STAY_WITHIN
        or raw == MoteusMode.BRAKE
    )
    if not known:
        return WRONG_VALUE
    r.cursor.mode = int64(raw)
    for i in range(COMMANDS):
        r.value[i] = r.settings[i].start
    return 0


@loop_inline
def can_be_read(register: int, kind: int) -> bool:
    """Return whether a register has a value of this size."""
    if register >= REGISTERS or KIND[register] < 0:
        return False
    return kind == INT32 or KIND[register] != Coding.WORD


@loop_function
def tell(r: Robot, kind: int, first: int, count: int) -> None:
    """Write the values of registers into the answer, as many as it has room for."""
    c, size, i = r.cursor, size_of(kind), 0
    while i < count and c.ok != 0:
        register, run = first + i, 0
        room = (LONGEST - c.out - (3 if register < 128 else 4)) // size
        while run < room and i + run < count and can_be_read(register + run, kind):
            run += 1
        if run > 0:
            say(r, int64(0x20 | kind << 2 | (run if run <= 3 else 0)))
            if run > 3:
                say(r, int64(run))
            say_number(r, register)
            for k in range(run):
                say_value(r, register + k, kind)
            i += run
        elif room <= 0:
            c.ok = 0
        else:
            say_failed(r, READ_FAILED, register, NO_REGISTER)
            i += 1


@loop_function
def say_value(r: Robot, register: int, kind: int) -> None:
    """Write a register's value: cut to the whole, and to what fits."""
    value, coding = register_value(r, register), KIND[register]
    if kind == FLOAT:
        word = word_of(value) if value == value else int64(0x7FC00000)
    else:
        largest = 127.0 if kind == INT8 else (32767.0 if kind == INT16 else 2147483647.0)
        whole = -largest - 1.0
        if value == value:
            whole = min(max(value / SCALES[3 * coding + kind], -largest), largest)
        word = int64(whole)
    for i in range(size_of(kind)):
        say(r, word >> int64(8 * i))


@loop_function
def register_value(r: Robot, register: int) -> float:
    """Return the value of a register."""
    x, row = r.state, ROW[register]
    if row >= 0:
        return r.value[row]
    if register == Register.MODE:
        return np.float64(x.power)
    if register == Register.FAULT:
        return np.float64(x.errors)
    if register == Register.COMPLETE:
        return np.float64(x.arrived)
    if register == Register.HOME or register == Register.VALID:
        return np.float64(1.0 if register == Register.HOME else 3.0)
    if register == Register.MILLISECONDS:
        return np.float64(int64(r.k * 1000.0 / r.rate_hz) & 0x7FFFFFFF)
    if register == Register.MULTIPLEX_ID:
        return np.float64(r.node)
    if register == Register.Q_CURRENT:
        return x.torque / r.value[Key.TORQUE_CONSTANT]
    if register == Register.POWER:
        return x.torque * x.velocity * 2.0 * math.pi
    return of_motion(r, register)


@loop_function
def of_motion(r: Robot, register: int) -> float:
    """Return the value of a register of (1), or where the motor is."""
    x = r.state
    if register == Register.VELOCITY or register == Register.ENCODER_VELOCITY:
        return x.velocity
    if register in (Register.TORQUE, Register.DEMANDED, Register.CONTROL_TORQUE):
        return x.torque
    if register == Register.INTEGRAL:
        return x.integral
    if register == Register.FED_FORWARD:
        return x.target_torque
    if register == Register.CONTROL_POSITION:
        return x.way_position
    if register == Register.CONTROL_VELOCITY:
        return x.way_velocity
    if register == Register.POSITION_ERROR:
        return x.way_position - x.position
    if register == Register.VELOCITY_ERROR:
        return x.way_velocity - x.velocity
    if register == Register.PROPORTIONAL:
        return stiffness(r) * (x.way_position - x.position)
    if register == Register.DERIVATIVE:
        return damping(r) * (x.way_velocity - x.velocity)
    if register <= Register.ABSOLUTE or register == Register.ENCODER_POSITION:
        return x.position if register != Register.D_CURRENT else 0.0
    return 0.0


@loop_function
def speak(r: Robot) -> int:
    """Send nothing: it only answers."""
    return int64(0)
