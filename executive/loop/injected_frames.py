"""Faults of communication, at a receiver, between the wire and the acceptance.

    loss         the frame does not come; with share 1, a blocked channel
    corruption   `value` bits of its data are inverted, each drawn anew
    repetition   the frame before it comes once more, after it
    sequence     frames come in pairs, the later one first
    delay        it comes with the frame that is `value` later; those that wait at the end are lost
    insertion    a frame of the same id, its data drawn, comes after it
    masquerade   its data are drawn, counter and CRC are right
    forgery      such a frame comes before the true one
    addressing   it carries the data of another frame, as that one came last
    length       its length is `value`
    counter      its counter is `value`, that of the first one (freeze), drawn (random) or shifted
                 by `value` (offset); the CRC is right; if it `goes_on`, it counts on from there
                 when the fault is over, as after a restart of the sender
    checksum     the same with its CRC
    payload      its data are those of the first one (freeze), counter and CRC are right

A fault takes frames from the wire (LOST_ON_PURPOSE in the log, as they came) and puts others in
their place (INJECTED and what the acceptance made of them). Of several faults of a frame each
changes what the one before it left. A frame that is taken away is not waited for.
"""

import numpy as np

from pcpc.drivers.can import codec, e2e
from pcpc.drivers.can.dbc import Protection
from pcpc.drivers.can.e2e_states import INJECTED, FrameState
from pcpc.drivers.can.wire import CAN_BE
from pcpc.drivers.can.wire_layout import Flag
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import FLAGS, LENGTH
from pcpc.drivers.compiled.structures import copy, data_of
from pcpc.executive.loop.doubts import note_sender
from pcpc.executive.loop.fault_kinds import FrameChange
from pcpc.executive.loop.fault_kinds import WrongFrame as Wrong
from pcpc.executive.loop.injection import acts, is_on, size, uniform
from pcpc.executive.loop.injection_layout import FAULT_DEPTH
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.rings import push_frame
from pcpc.executive.loop.strangers import note_repeat, word_of

GONE, CHANGED, AND_ANOTHER = 1, 2, 4  # what faults did to a frame
EXCUSED_CYCLES = 20  # after a fault a frame that does not fit the counter is its consequence


@loop_function
def inject(n: Loop, row: int) -> int:
    """Do to the frame in `wire.rx` what faults do; return 0 if none did, else GONE, CHANGED, ..."""
    faults, done = n.faults, 0
    copy(faults.raw, n.wire.rx)
    for f in range(faults.n_values, faults.n):
        if faults.kind[f] == Wrong.ADDRESSING and faults.other[f] == row:
            copy(faults.waiting[f, 0], faults.raw)
        if faults.target[f] != row:
            continue
        if not is_on(n, f):
            if faults.goes_on[f] != 0 and faults.count[f] != 0:
                rewrite(n, row, f)
                done |= CHANGED
            else:
                faults.count[f] = 0
        elif acts(n, f):
            done |= disturb(n, row, f)
        if faults.kind[f] == Wrong.REPETITION:
            copy(faults.waiting[f, 0], faults.raw)
    if done != 0:
        faults.acted[row] = n.passes + 1
        n.control.lost_on_purpose += 1
        push_frame(n, faults.raw, 1, FrameState.LOST_ON_PURPOSE)
    return done


@loop_function
def disturb(n: Loop, row: int, f: int) -> int:
    """Do to the frame in `wire.rx` what fault `f` does, and note a further one to come."""
    faults, frame = n.faults, n.wire.rx
    kind, data = faults.kind[f], data_of(n.wire.rx)
    if kind == Wrong.LOSS:
        return GONE
    if kind == Wrong.REPETITION:
        copy(faults.another, faults.waiting[f, 0])
        return CHANGED | (AND_ANOTHER if faults.another[4] != 0 else 0)
    if kind == Wrong.INSERTION:
        copy(faults.another, frame)
        draw(n, f, frame, data_of(faults.another))
        return CHANGED | AND_ANOTHER
    if kind == Wrong.FORGERY:
        copy(faults.another, frame)
        rewrite(n, row, f)
        return CHANGED | AND_ANOTHER
    if kind in (Wrong.SEQUENCE, Wrong.DELAY):
        return hold(n, f)
    if kind == Wrong.CORRUPTION:
        for _ in range(int64(size(n, f))):
            bit = int64(uniform(n, f) * 8 * max(int64(frame[LENGTH]), 1))
            data[bit >> 3] = data[bit >> 3] ^ (1 << (bit & 7))
    elif kind == Wrong.LENGTH:
        long = frame[FLAGS] & Flag.FD != 0
        length = int64(min(max(size(n, f), 0.0), 64.0 if long else 8.0))
        while long and CAN_BE[length] == 0:
            length += 1
        frame[LENGTH] = np.uint8(length)
    elif kind == Wrong.ADDRESSING:
        for i in range(data_length(frame)):
            data[i] = faults.waiting[f, 0, 8 + i]
    else:
        rewrite(n, row, f)
    return CHANGED


@loop_function
def hold(n: Loop, f: int) -> int:
    """Let the frame wait for later ones; return what came instead of it."""
    faults, frame = n.faults, n.wire.rx
    if faults.kind[f] == Wrong.SEQUENCE:
        if faults.count[f] == 0:
            copy(faults.waiting[f, 0], frame)
            faults.count[f] = 1
            return GONE
        copy(faults.another, faults.waiting[f, 0])
        faults.count[f] = 0
        return CHANGED | AND_ANOTHER
    late = int64(min(max(size(n, f), 0.0), FAULT_DEPTH - 1.0))
    position = faults.count[f]
    faults.count[f] = position + 1
    copy(faults.waiting[f, position % FAULT_DEPTH], frame)
    if position < late:
        return GONE
    copy(frame, faults.waiting[f, (position - late) % FAULT_DEPTH])
    return CHANGED


@loop_inline
def data_length(frame: Cells[Byte]) -> int:
    """Return how many bytes of a frame's data count, 8 or more."""
    return max(int64(frame[LENGTH]), int64(8))


@loop_function
def draw(n: Loop, f: int, frame: Cells[Byte], data: Cells[Byte]) -> None:
    """Fill data at random, as many bytes as `frame` has, at least 8."""
    for i in range(data_length(frame)):
        data[i] = np.uint8(256.0 * uniform(n, f))


@loop_function
def rewrite(n: Loop, row: int, f: int) -> None:
    """Change data, counter or CRC of the frame in `wire.rx`, and make the rest right."""
    faults, frames, data = n.faults, n.rx.frames, data_of(n.wire.rx)
    kind, how, crc = faults.kind[f], faults.how[f], e2e.crc_of(data, row, frames)
    byte, shift = frames[row].counter_byte, frames[row].counter_shift
    counter = int64(data[byte]) >> shift & frames[row].counter_mask
    if faults.count[f] == 0:
        faults.count[f] = 1
        copy(faults.waiting[f, 0], n.wire.rx)
        faults.first[f] = crc if kind == Wrong.CHECKSUM else counter
    if kind == Wrong.CHECKSUM:
        span = 65536.0 if frames[row].protected == Protection.CRC_16 else 256.0
        e2e.put_crc(data, row, frames, substitute(n, f, how, crc, span))
        return
    if kind == Wrong.COUNTER and is_on(n, f):
        faults.kept[f] = substitute(n, f, how, counter, 256.0) - counter
    if kind == Wrong.COUNTER:
        counter += int64(faults.kept[f])
    elif kind == Wrong.PAYLOAD and how == FrameChange.FREEZE:
        for i in range(data_length(n.wire.rx)):
            data[i] = faults.waiting[f, 0, 8 + i]
    else:
        draw(n, f, n.wire.rx, data)
    e2e.protect(data, row, frames, counter)


@loop_function
def substitute(n: Loop, f: int, how: int, true: int, span: float) -> int:
    """Return a counter or checksum in the place of the true one; a drawn one is below `span`."""
    if how == FrameChange.FREEZE:
        return n.faults.first[f]
    if how == FrameChange.RANDOM:
        return int64(span * uniform(n, f))
    wanted = int64(size(n, f))
    return true + wanted if how == FrameChange.OFFSET else wanted


@loop_function
def judge(n: Loop, row: int) -> int:
    """Check an injected frame in `wire.rx` and record it; return its state."""
    frame = n.wire.rx
    state, lost = e2e.check(
        data_of(frame), codec.length_of(frame, row, n.rx.frames), row, n.rx.frames, n.rx.state
    )
    push_frame(n, frame, 1, INJECTED + state)
    n.control.lost += lost
    if state != FrameState.OK and state != FrameState.OK_SOME_LOST:
        note_sender(n, row, state, lost)
    if state == FrameState.REPEATED and n.rx.role[row].starts + n.rx.role[row].awaited > 0:
        note_repeat(n, word_of(frame))
    return state


@loop_function
def excused(n: Loop, row: int) -> bool:
    """Return whether what is wrong with a frame of `row` may follow from a fault on purpose."""
    acted = n.faults.acted[row]  # 0 without faults
    return acted > 0 and n.passes + 1 - acted <= EXCUSED_CYCLES
