"""The SDO server: expedited and segmented, up and down; one transfer at a time.

    from the client, 0x600 + node      the answer, 0x580 + node
    0x40 index sub                     0x43 (1-4 bytes)  or  0x41 length, then segments
    0x60 | t<<4                        t<<4 | empty<<1 | last, 7 bytes
    0x2x index sub data                0x60 index sub
    0x20, 0x21 index sub length        0x60 index sub, then segments
    t<<4 | empty<<1 | last, 7 bytes    0x20 | t<<4
    0x80                               none: the client has given up
    any other                          0x80 index sub 0x05040001

Texts are read in segments; all that can be written has at most four bytes, also in segments. A
transfer without a segment for a second is given up. A block transfer is refused as a command that
there is not, after which a master takes segments: no object has more than 32 bytes, and masters
use blocks only when told to. Source: CiA 301, 7.2.4.
"""

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
from pcpc.drivers.canopen.frames import SDO_ANSWER
from pcpc.drivers.canopen.layout import READ as MAY_READ
from pcpc.drivers.canopen.layout import WRITE as MAY_WRITE
from pcpc.drivers.canopen.layout import Canopen, Mistake, Od
from pcpc.drivers.canopen.mapping import PDO_ROWS, arrange, pdo_of, why_not
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.drive.outbox import put

DOWN_SEGMENT, DOWN, UP, UP_SEGMENT, ABORT = range(5)
LOADS_UP, LOADS_DOWN = range(2)  # what `segment_loads` says is under way
SEGMENT = 7  # bytes
PATIENCE_S = 1.0
NO_COMMAND, TOGGLE, TIMED_OUT, WRONG_LENGTH = (
    why.NO_COMMAND, why.TOGGLE, why.TIMED_OUT, why.WRONG_LENGTH
)  # fmt: skip
READ_ONLY, WRITE_ONLY, TOO_HIGH, TOO_LOW, WRONG_VALUE = (
    why.READ_ONLY, why.WRITE_ONLY, why.TOO_HIGH, why.TOO_LOW, why.WRONG_VALUE
)  # fmt: skip


@loop_function
def write(d: Canopen, row: int, raw: int) -> int:
    """Write an object, with what follows from it; return the abort code, 0 for none."""
    od_object = d.objects[row]
    if od_object.access & MAY_WRITE == 0:
        return READ_ONLY
    if raw > od_object.high:
        return TOO_HIGH
    if raw < od_object.low:
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
    elif row == Od.ERROR_COUNT:
        for i in range(Od.ERROR_1, Od.ERROR_4 + 1):
            d.value[i] = 0
    return 0


@loop_function
def serve(d: Canopen, data: Cells[Byte]) -> None:
    """Answer a client's frame of 8 bytes."""
    command = int64(data[0]) >> 5
    multiplexor = int64(data[1]) | int64(data[2]) << 8 | int64(data[3]) << 16
    row = row_of_object(d, multiplexor & 0xFFFF, multiplexor >> 16)
    if command == UP:
        begin_up(d, row, multiplexor)
    elif command == DOWN:
        begin_down(d, row, multiplexor, data)
    elif command == UP_SEGMENT:
        next_up(d, data)
    elif command == DOWN_SEGMENT:
        next_down(d, data)
    elif command == ABORT:
        d.state.segment_row = 0
    else:
        abort(d, multiplexor, NO_COMMAND)


@loop_function
def abort(d: Canopen, multiplexor: int, code: int) -> None:
    """Refuse, and forget the transfer."""
    d.state.segment_row = 0
    d.mistakes[Mistake.SDO_ABORTED] += 1
    put(d, SDO_ANSWER + d.node, 8, 0x80 | multiplexor << 8, code)


@loop_function
def about_of(d: Canopen) -> int:
    """Return index and subindex of the object that is being transferred."""
    if d.state.segment_row == 0:
        return int64(0)
    one = d.objects[d.state.segment_row - 1]
    return one.index | one.subindex << 16


@loop_function
def begin_up(d: Canopen, row: int, multiplexor: int) -> None:
    """Send a value at once, or the length of a text that follows in segments."""
    if row < 0:
        abort(d, multiplexor, why_none(row))
        return
    od_object, x = d.objects[row], d.state
    x.segment_row = 0
    if od_object.access & MAY_READ == 0:
        abort(d, multiplexor, WRITE_ONLY)
        return
    if od_object.bits != 0:
        size = od_object.bits // 8
        put(d, SDO_ANSWER + d.node, 8, 0x43 | (4 - size) << 2 | multiplexor << 8, to_bits(d, row))
        return
    x.segment_row, x.segment_loads = row + 1, LOADS_UP
    x.segment_toggle, x.segment_at, x.segment_size, x.segment_since = 0, 0, od_object.sign, d.k
    put(d, SDO_ANSWER + d.node, 8, 0x41 | multiplexor << 8, od_object.sign)


@loop_function
def next_up(d: Canopen, data: Cells[Byte]) -> None:
    """Send the next segment of a text."""
    x = d.state
    if x.segment_row == 0 or x.segment_loads != LOADS_UP:
        abort(d, about_of(d), NO_COMMAND)
        return
    if (int64(data[0]) >> 4) & 1 != x.segment_toggle:
        abort(d, about_of(d), TOGGLE)
        return
    remaining = x.segment_size - x.segment_at
    n = min(remaining, SEGMENT)
    words = int64(0)
    place = d.objects[x.segment_row - 1].text + x.segment_at
    for i in range(n):
        words |= int64(d.text[place + i]) << (8 * i)
    last = 1 if remaining <= SEGMENT else 0
    head = x.segment_toggle << 4 | (SEGMENT - n) << 1 | last
    put(d, SDO_ANSWER + d.node, 8, head | (words & 0xFFFFFF) << 8, words >> 24)
    x.segment_at += n
    x.segment_toggle, x.segment_since = 1 - x.segment_toggle, d.k
    if last != 0:
        x.segment_row = 0


@loop_function
def begin_down(d: Canopen, row: int, multiplexor: int, data: Cells[Byte]) -> None:
    """Write what the frame has, or wait for segments."""
    if row < 0:
        abort(d, multiplexor, why_none(row))
        return
    head, x, size = int64(data[0]), d.state, d.objects[row].bits // 8
    sized, word = head & 1, low_word(four_bytes(data, 4))
    if d.objects[row].access & MAY_WRITE == 0:
        abort(d, multiplexor, READ_ONLY)
    elif head & 2 == 0:
        if sized != 0 and word != size:
            abort(d, multiplexor, WRONG_LENGTH)
            return
        x.segment_row, x.segment_loads = row + 1, LOADS_DOWN
        x.segment_toggle, x.segment_at, x.segment_data, x.segment_since = 0, 0, 0, d.k
        put(d, SDO_ANSWER + d.node, 8, 0x60 | multiplexor << 8, 0)
    elif sized != 0 and 4 - (head >> 2 & 3) != size:
        abort(d, multiplexor, WRONG_LENGTH)
    else:
        x.segment_row = 0
        code = write(d, row, from_bits(d, row, word))
        if code != 0:
            abort(d, multiplexor, code)
        else:
            put(d, SDO_ANSWER + d.node, 8, 0x60 | multiplexor << 8, 0)


@loop_function
def next_down(d: Canopen, data: Cells[Byte]) -> None:
    """Take the next segment; with the last one write the object."""
    x, head = d.state, int64(data[0])
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
        x.segment_data |= int64(data[1 + i]) << (8 * (x.segment_at + i))
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
def give_up(d: Canopen) -> None:
    """Forget a transfer whose client is silent."""
    if d.state.segment_row != 0 and d.k - d.state.segment_since > PATIENCE_S * d.rate_hz:
        abort(d, about_of(d), TIMED_OUT)
