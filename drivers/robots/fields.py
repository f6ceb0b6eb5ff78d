"""Numbers in a frame's data, and settings that a frame reads and writes.

x   = low + code (high - low)/(2^bits - 1)                                      decoded  (1)
code = whole part of (x - low) (2^bits - 1)/(high - low), of x from low to high  coded   (2)
"""

import numpy as np

from pcpc.drivers.can.codec import eight_bytes, four_bytes, swapped_word
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.structures import data_of
from pcpc.drivers.drive.outbox import put
from pcpc.drivers.robots.layout import Mistake, Robot

FINITE = 1e300
_LARGEST = 3.4028234e38  # a float32


@loop_inline
def number_at(data: Cells[Byte], at: int) -> float:
    """Return the float32 in 4 bytes of `data`."""
    word = four_bytes(data, at)
    if word >= 1 << 31:
        word -= 1 << 32
    return np.float64(np.int32(word).view(np.float32))


@loop_inline
def short_at(data: Cells[Byte], at: int) -> float:
    """Return the signed number in 2 bytes."""
    word = int64(data[at]) | int64(data[at + 1]) << int64(8)
    return np.float64(word - 65536 if word >= 32768 else word)


@loop_inline
def word_of(x: float) -> int:
    """Return a number as the 4 bytes of a float32."""
    x = min(max(x, -_LARGEST), _LARGEST)
    return int64(np.float32(x).view(np.int32)) & int64(0xFFFFFFFF)


@loop_inline
def big_word(r: Robot) -> int:
    """Return the 8 bytes of `rx`, the first one highest."""
    return int64(swapped_word(eight_bytes(data_of(r.rx), 0)))


@loop_inline
def put_big(r: Robot, can_id: int, word: int) -> None:
    """Send 8 bytes, the highest first."""
    little = int64(swapped_word(word))
    put(r, can_id, 8, little, little >> int64(32))


@loop_inline
def decoded(word: int, at: int, bits: int, low: float, high: float) -> float:
    """Return (1) of so many bits of a word, from bit `at` on."""
    most = (int64(1) << int64(bits)) - 1
    return (word >> int64(at) & most) * (high - low) / most + low


@loop_inline
def coded(x: float, at: int, bits: int, low: float, high: float) -> int:
    """Return (2), from bit `at` of a word on."""
    x = min(max(x, low), high)
    return int64((x - low) * ((int64(1) << int64(bits)) - 1) / (high - low)) << int64(at)


@loop_function
def is_number(r: Robot, value: float) -> bool:
    """Return whether a value is a finite number; count it if not."""
    if abs(value) < FINITE:
        return True
    r.mistakes[Mistake.NOT_FINITE] += 1
    return False


@loop_function
def row_of(r: Robot, number: int) -> int:
    """Return the row of the setting with this number, -1 for none."""
    row = -1
    for i in range(r.n):
        if r.settings[i].number == number:
            row = i
    return row


@loop_function
def value_in(r: Robot, row: int, data: Cells[Byte], at: int) -> float:
    """Return the value that 4 bytes of a frame have for a setting."""
    return np.float64(four_bytes(data, at)) if r.settings[row].whole != 0 else number_at(data, at)


@loop_function
def value_word(r: Robot, row: int) -> int:
    """Return a setting as 4 bytes."""
    value = r.value[row]
    return int64(value) if r.settings[row].whole != 0 else word_of(value)


@loop_function
def is_taken(r: Robot, row: int, value: float) -> bool:
    """Return whether a setting takes a value; count it if not."""
    one = r.settings[row]
    if one.low <= value <= one.high and one.writable != 0:
        return True
    r.mistakes[Mistake.VALUE_REFUSED] += 1
    return False


@loop_function
def write(r: Robot, row: int, value: float) -> bool:
    """Give a setting a value, if it takes it; return whether it does."""
    if is_number(r, value) and is_taken(r, row, value):
        r.value[row] = value
        return True
    return False
