"""The SDO server: expedited, segmented and in blocks, up and down; one transfer at a time.

    from the client, 0x600 + node      the answer, 0x580 + node
    0x40 index sub                     0x43 (1-4 bytes)  or  0x41 length, then segments
    0x60 | t<<4                        t<<4 | empty<<1 | last, 7 bytes
    0x2x index sub data                0x60 index sub
    0x20, 0x21 index sub length        0x60 index sub, then segments
    t<<4 | empty<<1 | last, 7 bytes    0x20 | t<<4
    0x80                               none: the client has given up
    0xA0 | crc<<2 index sub size pst   0xC2 | crc<<2 index sub length, or as 0x40 up to `pst` bytes
    0xA3                               last<<7 | n, 7 bytes, for n = 1 up to `size`
    0xA2 n size                        the same from behind n on, or 0xC1 | empty<<2 CRC
    0xA1                               none
    0xC0 | crc<<2 | 2 index sub length 0xA0 | crc<<2 index sub 1
    last<<7 | n, 7 bytes               0xA2 n 1; n 0: send it again
    0xC1 | empty<<2 CRC                0xA1

Texts are read in segments; all that can be written has at most four bytes, also in segments, so a
block down is one. A transfer without a segment for a second is given up. The CRC of a block is
x^16 + x^12 + x^5 + 1 from 0. Source: CiA 301, 7.2.4.
"""

from typing import Any

import numpy as np

from pcpc.drivers.can.codec import four_bytes
from pcpc.drivers.canopen import dictionary as why
from pcpc.drivers.canopen.dictionary import (
    from_bits,
    is_possible,
    low_word,
    row_of_object,
    to_bits,
    why_none,
)
from pcpc.drivers.canopen.frames import SDO_ANSWER, put
from pcpc.drivers.canopen.layout import READ as MAY_READ
from pcpc.drivers.canopen.layout import WRITE as MAY_WRITE
from pcpc.drivers.canopen.layout import Mistake, Row
from pcpc.drivers.canopen.mapping import PDO_ROWS, arrange, pdo_of, why_not
from pcpc.drivers.compiled.jit import loop_function

DOWN_SEGMENT, DOWN, UP, UP_SEGMENT, ABORT, BLOCK_UP, BLOCK_DOWN = range(7)
# what `segment_loads` says is under way: segments up, down; then blocks, and which frame is awaited
LOADS_UP, LOADS_DOWN, BEGIN, ACKNOWLEDGEMENT, END_UP, BLOCK_SEGMENT, END_DOWN = range(7)
MOST_SEGMENTS = 127  # of a block
SEGMENT = 7  # bytes
PATIENCE_S = 1.0
NO_COMMAND, TOGGLE, TIMED_OUT, WRONG_LENGTH = (
    why.NO_COMMAND, why.TOGGLE, why.TIMED_OUT, why.WRONG_LENGTH
)  # fmt: skip
BLOCK_SIZE, SEQUENCE, WRONG_CRC = why.BLOCK_SIZE, why.SEQUENCE, why.WRONG_CRC
READ_ONLY, WRITE_ONLY, TOO_HIGH, TOO_LOW, WRONG_VALUE = (
    why.READ_ONLY, why.WRITE_ONLY, why.TOO_HIGH, why.TOO_LOW, why.WRONG_VALUE
)  # fmt: skip


@loop_function
def write(d: Any, row: Any, raw: Any) -> Any:
    """Write an object, with what follows from it; return the abort code, 0 for none."""
    one = d.objects[row]
    if one.access & MAY_WRITE == 0:
        return READ_ONLY
    if raw > one.high:
        return TOO_HIGH
    if raw < one.low:
        return TOO_LOW
    if not is_possible(d, row, raw):
        return WRONG_VALUE
    if row < PDO_ROWS:
        code = why_not(d, row, raw)
        if code != 0:
            return code
    d.value[row] = raw
    if row < PDO_ROWS:
        arrange(d, pdo_of(row))
    elif row == Row.ERROR_COUNT:
        for i in range(Row.ERROR_1, Row.ERROR_4 + 1):
            d.value[i] = 0
    return 0


@loop_function
def serve(d: Any, data: Any) -> None:
    """Answer a client's frame of 8 bytes."""
    command = np.int64(data[0]) >> 5
    about = np.int64(data[1]) | np.int64(data[2]) << 8 | np.int64(data[3]) << 16
    row = row_of_object(d, about & 0xFFFF, about >> 16)
    in_block = d.state.segment_row != 0 and d.state.segment_loads == BLOCK_SEGMENT
    if in_block and data[0] != ABORT << 5:
        next_block_down(d, data)
    elif command == UP:
        begin_up(d, row, about)
    elif command == DOWN:
        begin_down(d, row, about, data)
    elif command == UP_SEGMENT:
        next_up(d, data)
    elif command == DOWN_SEGMENT:
        next_down(d, data)
    elif command == ABORT:
        d.state.segment_row = 0
    elif command == BLOCK_UP:
        block_up(d, row, about, data)
    elif command == BLOCK_DOWN and data[0] & 1 == 0:
        begin_block_down(d, row, about, data)
    elif command == BLOCK_DOWN:
        end_block_down(d, data)
    else:
        abort(d, about, NO_COMMAND)


@loop_function
def abort(d: Any, about: Any, code: Any) -> None:
    """Refuse, and forget the transfer."""
    d.state.segment_row = 0
    d.mistakes[Mistake.SDO_ABORTED] += 1
    put(d, SDO_ANSWER + d.node, 8, 0x80 | about << 8, code)


@loop_function
def about_of(d: Any) -> Any:
    """Return index and subindex of the object that is being transferred."""
    if d.state.segment_row == 0:
        return np.int64(0)
    one = d.objects[d.state.segment_row - 1]
    return one.index | one.subindex << 16


@loop_function
def begin_up(d: Any, row: Any, about: Any) -> None:
    """Send a value at once, or the length of a text that follows in segments."""
    if row < 0:
        abort(d, about, why_none(row))
        return
    one, x = d.objects[row], d.state
    x.segment_row = 0
    if one.access & MAY_READ == 0:
        abort(d, about, WRITE_ONLY)
        return
    if one.bits != 0:
        size = one.bits // 8
        put(d, SDO_ANSWER + d.node, 8, 0x43 | (4 - size) << 2 | about << 8, to_bits(d, row))
        return
    x.segment_row, x.segment_loads = row + 1, LOADS_UP
    x.segment_toggle, x.segment_at, x.segment_size, x.segment_since = 0, 0, one.sign, d.k
    put(d, SDO_ANSWER + d.node, 8, 0x41 | about << 8, one.sign)


@loop_function
def next_up(d: Any, data: Any) -> None:
    """Send the next segment of a text."""
    x = d.state
    if x.segment_row == 0 or x.segment_loads != LOADS_UP:
        abort(d, about_of(d), NO_COMMAND)
        return
    if (np.int64(data[0]) >> 4) & 1 != x.segment_toggle:
        abort(d, about_of(d), TOGGLE)
        return
    left = x.segment_size - x.segment_at
    n = min(left, SEGMENT)
    words = np.int64(0)
    place = d.objects[x.segment_row - 1].text + x.segment_at
    for i in range(n):
        words |= np.int64(d.text[place + i]) << (8 * i)
    last = 1 if left <= SEGMENT else 0
    head = x.segment_toggle << 4 | (SEGMENT - n) << 1 | last
    put(d, SDO_ANSWER + d.node, 8, head | (words & 0xFFFFFF) << 8, words >> 24)
    x.segment_at += n
    x.segment_toggle, x.segment_since = 1 - x.segment_toggle, d.k
    if last != 0:
        x.segment_row = 0


@loop_function
def begin_down(d: Any, row: Any, about: Any, data: Any) -> None:
    """Write what the frame has, or wait for segments."""
    if row < 0:
        abort(d, about, why_none(row))
        return
    head, x, size = np.int64(data[0]), d.state, d.objects[row].bits // 8
    sized, told = head & 1, low_word(four_bytes(data, 4))
    if d.objects[row].access & MAY_WRITE == 0:
        abort(d, about, READ_ONLY)
    elif head & 2 == 0:
        if sized != 0 and told != size:
            abort(d, about, WRONG_LENGTH)
            return
        x.segment_row, x.segment_loads = row + 1, LOADS_DOWN
        x.segment_toggle, x.segment_at, x.segment_data, x.segment_since = 0, 0, 0, d.k
        put(d, SDO_ANSWER + d.node, 8, 0x60 | about << 8, 0)
    elif sized != 0 and 4 - (head >> 2 & 3) != size:
        abort(d, about, WRONG_LENGTH)
    else:
        x.segment_row = 0
        code = write(d, row, from_bits(d, row, told))
        if code != 0:
            abort(d, about, code)
        else:
            put(d, SDO_ANSWER + d.node, 8, 0x60 | about << 8, 0)


@loop_function
def next_down(d: Any, data: Any) -> None:
    """Take the next segment; with the last one write the object."""
    x, head = d.state, np.int64(data[0])
    if x.segment_row == 0 or x.segment_loads != LOADS_DOWN:
        abort(d, about_of(d), NO_COMMAND)
        return
    if head >> 4 & 1 != x.segment_toggle:
        abort(d, about_of(d), TOGGLE)
        return
    n, row = SEGMENT - (head >> 1 & 7), x.segment_row - 1
    size = d.objects[row].bits // 8
    if x.segment_at + n > size or (head & 1 != 0 and x.segment_at + n != size):
        abort(d, about_of(d), WRONG_LENGTH)
        return
    for i in range(n):
        x.segment_data |= np.int64(data[1 + i]) << (8 * (x.segment_at + i))
    x.segment_at += n
    x.segment_since = d.k
    if head & 1 != 0:
        code = write(d, row, from_bits(d, row, x.segment_data))
        if code != 0:
            abort(d, about_of(d), code)
            return
        x.segment_row = 0
    put(d, SDO_ANSWER + d.node, 8, 0x20 | x.segment_toggle << 4, 0)
    x.segment_toggle = 1 - x.segment_toggle


@loop_function
def byte_of(d: Any, row: Any, at: Any) -> Any:
    """Return a byte of a text or a value as it is read."""
    one = d.objects[row]
    if one.bits == 0:
        return np.int64(d.text[one.text + at])
    return to_bits(d, row) >> (8 * at) & 255


@loop_function
def crc_over(crc: Any, byte: Any) -> Any:
    """Return the CRC of a block with a further byte."""
    crc ^= byte << 8
    for _ in range(8):
        crc = (crc << 1 ^ (0x1021 if crc & 0x8000 else 0)) & 0xFFFF
    return crc


@loop_function
def block_up(d: Any, row: Any, about: Any, data: Any) -> None:
    """Take a client's frame of a block transfer from the drive."""
    x, what, size = d.state, np.int64(data[0]) & 3, np.int64(data[2])
    if what == 0:
        begin_block_up(d, row, about, data)
    elif x.segment_row == 0:
        abort(d, about_of(d), NO_COMMAND)
    elif what == 3 and x.segment_loads == BEGIN:
        send_block(d)
    elif what == 2 and x.segment_loads == ACKNOWLEDGEMENT:
        if np.int64(data[1]) > segments_left(x):
            abort(d, about_of(d), SEQUENCE)
        elif not 1 <= size <= MOST_SEGMENTS:
            abort(d, about_of(d), BLOCK_SIZE)
        else:
            is_whole = data[1] > 0 and x.segment_at + SEGMENT * np.int64(data[1]) >= x.segment_size
            x.segment_at += SEGMENT * np.int64(data[1])
            x.segment_toggle = size
            if is_whole:
                end_block_up(d)
            else:
                send_block(d)
    elif what == 1 and x.segment_loads == END_UP:
        x.segment_row = 0
    else:
        abort(d, about_of(d), NO_COMMAND)


@loop_function
def begin_block_up(d: Any, row: Any, about: Any, data: Any) -> None:
    """Tell the length; a short object is sent without a block, if the client says so."""
    if row < 0:
        abort(d, about, why_none(row))
        return
    one, x, size = d.objects[row], d.state, np.int64(data[4])
    length = one.bits // 8 if one.bits != 0 else one.sign
    if one.access & MAY_READ == 0:
        abort(d, about, WRITE_ONLY)
    elif not 1 <= size <= MOST_SEGMENTS:
        abort(d, about, BLOCK_SIZE)
    elif length <= data[5]:
        begin_up(d, row, about)
    else:
        x.segment_row, x.segment_loads, x.segment_since = row + 1, BEGIN, d.k
        x.segment_at, x.segment_size, x.segment_toggle = 0, length, size
        x.segment_data = np.int64(data[0]) >> 2 & 1
        put(d, SDO_ANSWER + d.node, 8, 0xC2 | x.segment_data << 2 | about << 8, length)


@loop_function
def segments_left(x: Any) -> Any:
    """Return how many segments the block has that begins with `segment_at`."""
    left = (x.segment_size - x.segment_at + SEGMENT - 1) // SEGMENT
    return min(max(left, np.int64(1)), x.segment_toggle)


@loop_function
def send_block(d: Any) -> None:
    """Send the segments of a block; those that were not acknowledged are its first."""
    x = d.state
    for i in range(segments_left(x)):
        at, words = x.segment_at + SEGMENT * i, np.int64(0)
        for k in range(min(x.segment_size - at, SEGMENT)):
            words |= byte_of(d, x.segment_row - 1, at + k) << (8 * k)
        last = 0x80 if at + SEGMENT >= x.segment_size else 0
        put(d, SDO_ANSWER + d.node, 8, last | i + 1 | (words & 0xFFFFFF) << 8, words >> 24)
    x.segment_loads, x.segment_since = ACKNOWLEDGEMENT, d.k


@loop_function
def end_block_up(d: Any) -> None:
    """Tell how much of the last segment is empty, and the CRC if the client has one."""
    x, crc = d.state, np.int64(0)
    for i in range(x.segment_size if x.segment_data != 0 else 0):
        crc = crc_over(crc, byte_of(d, x.segment_row - 1, i))
    x.segment_loads, x.segment_since = END_UP, d.k
    put(d, SDO_ANSWER + d.node, 8, 0xC1 | (x.segment_at - x.segment_size) << 2 | crc << 8, 0)


@loop_function
def begin_block_down(d: Any, row: Any, about: Any, data: Any) -> None:
    """Wait for the one segment that what can be written has."""
    if row < 0:
        abort(d, about, why_none(row))
        return
    x, told = d.state, low_word(four_bytes(data, 4))
    if d.objects[row].access & MAY_WRITE == 0:
        abort(d, about, READ_ONLY)
    elif data[0] & 2 != 0 and told != d.objects[row].bits // 8:
        abort(d, about, WRONG_LENGTH)
    else:
        x.segment_row, x.segment_loads, x.segment_since = row + 1, BLOCK_SEGMENT, d.k
        x.segment_toggle = np.int64(data[0]) >> 2 & 1  # 1: with a CRC
        put(d, SDO_ANSWER + d.node, 8, 0xA0 | x.segment_toggle << 2 | about << 8, 1)


@loop_function
def next_block_down(d: Any, data: Any) -> None:
    """Take the segment; another than the first has to come again."""
    x, n = d.state, np.int64(data[0]) & 127
    if n == 1 and data[0] & 0x80 == 0:
        abort(d, about_of(d), WRONG_LENGTH)
        return
    if n == 1:
        x.segment_data = 0
        for i in range(SEGMENT):
            x.segment_data |= np.int64(data[1 + i]) << (8 * i)
        x.segment_loads = END_DOWN
    x.segment_since = d.k
    put(d, SDO_ANSWER + d.node, 8, 0xA2 | (1 if n == 1 else 0) << 8 | 1 << 16, 0)


@loop_function
def end_block_down(d: Any, data: Any) -> None:
    """Write the object, if length and CRC are right."""
    x, row, crc = d.state, d.state.segment_row - 1, np.int64(0)
    if row < 0 or x.segment_loads != END_DOWN:
        abort(d, about_of(d), NO_COMMAND)
        return
    size = SEGMENT - (np.int64(data[0]) >> 2 & 7)
    for i in range(size):
        crc = crc_over(crc, x.segment_data >> (8 * i) & 255)
    code = np.int64(0)
    if size != d.objects[row].bits // 8:
        code = np.int64(WRONG_LENGTH)
    elif x.segment_toggle != 0 and crc != np.int64(data[1]) | np.int64(data[2]) << 8:
        code = np.int64(WRONG_CRC)
    else:
        code = np.int64(write(d, row, from_bits(d, row, x.segment_data & (1 << 8 * size) - 1)))
    if code != 0:
        abort(d, about_of(d), code)
        return
    x.segment_row = 0
    put(d, SDO_ANSWER + d.node, 8, 0xA1, 0)


@loop_function
def give_up(d: Any) -> None:
    """Forget a transfer whose client is silent."""
    if d.state.segment_row != 0 and d.k - d.state.segment_since > PATIENCE_S * d.rate_hz:
        abort(d, about_of(d), TIMED_OUT)
