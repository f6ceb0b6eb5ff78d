"""What leaves the loop: the snapshot for readers, and three rings for the recorder.

Each ring has one writer (the loop) and one reader; its rows stand in `executive.loop.ring_layout`.
A full ring drops the row and counts it; in lockstep, where no clock runs, the loop waits for the
recorder instead. One that was told to stop waits LAST_WAIT_NS for it, once: the recorder may be
what has gone.
"""

from typing import Any

import numpy as np

from pcpc.drivers.can import codec
from pcpc.drivers.can.wire_layout import Flag
from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import FLAGS, LENGTH
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import machine_ns, stamp, stopping
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.ring_layout import RECORD_HEAD, Ends, OfFrame, OfRecord

LAST_WAIT_NS = 2_000_000_000
NAN_BITS = np.float64("nan").view(np.int64)  # the one NaN that logs hold


@loop_inline
def bits_of(value: float) -> Any:
    """Return the 64 bits of a float64 as int64, every NaN as the same one."""
    bits = np.float64(value).view(np.int64)
    return bits if value == value else NAN_BITS


@loop_inline
def _free_row(n: Loop, ends: Ends, taken: Cells[int], rows: int) -> int:
    """Return the row to fill, or -1 when the ring is full and the row is dropped.

    The row follows from the loop's own words alone: `taken` may hold anything.
    """
    put = ends.head
    if put - libc.load_acquire(taken, 0) >= rows and not _room(n, ends, taken, rows):
        ends.dropped += 1
        return int64(-1)
    return int64(np.uint64(put) % np.uint64(rows))


@loop_function
def _room(n: Loop, ends: Ends, taken: Cells[int], rows: int) -> bool:
    """Wait for room in a full ring, where the rig says so; return whether there is any."""
    until = int64(0)
    while ends.head - libc.load_acquire(taken, 0) >= rows:
        gives_up = n.rings.wait_recorder == 0
        if not gives_up and stopping(n):
            until = machine_ns(n.clock) + LAST_WAIT_NS if until == 0 else until
            gives_up = ends.dropped > 0 or machine_ns(n.clock) >= until
        if gives_up:
            return False
        libc.sched_yield()
    return True


@loop_function
def push_frame(n: Loop, frame: Cells[Byte], received: int, state: int) -> None:
    """Append one frame, sent or received, with its receiver state."""
    row = _free_row(n, n.frame_ends, n.frame_taken, n.rings.frame_rows)
    if row < 0:
        return
    word = codec.four_bytes(frame, 0) | int64(frame[LENGTH]) << 32 | int64(frame[FLAGS]) << 56
    into, offset = n.frame, row * n.rings.frame_words
    into[offset + OfFrame.HEADER] = sh.CDR_HEADER
    into[offset + OfFrame.STAMP_NS] = stamp(n.clock)
    into[offset + OfFrame.CYCLE] = n.k
    into[offset + OfFrame.ABOUT] = word | received << 40 | state << 48
    into[offset + OfFrame.PAYLOAD] = codec.eight_bytes(frame, 8)
    for i in range(1, n.rings.frame_words - OfFrame.PAYLOAD):
        long = frame[FLAGS] & Flag.FD != 0
        into[offset + OfFrame.PAYLOAD + i] = codec.eight_bytes(frame, 8 * (i + 1)) if long else 0
    libc.store_release(n.frame_ends, "head", n.frame_ends.head + 1)


@loop_function
def push_event(n: Loop, code: int, argument: int, value: float) -> None:
    """Append one event."""
    row = _free_row(n, n.event_ends, n.event_taken, sh.EVENT_RING_ROWS)
    if row < 0:
        return
    into = n.event[row]
    into.stamp_ns = stamp(n.clock)
    into.cycle = n.k
    into.code = code
    into.argument = argument
    into.bits = bits_of(value)
    libc.store_release(n.event_ends, "head", n.event_ends.head + 1)


@loop_inline
def push_record(n: Loop) -> None:
    """Append the row of this cycle: the payloads of its state and timing messages."""
    rings, record = n.rings, n.record
    columns = RECORD_HEAD + rings.n_state + 1 + rings.n_timing
    row = _free_row(n, n.record_ends, n.record_taken, rings.record_rows)
    if row < 0:
        return
    offset = row * columns
    record[offset + OfRecord.CYCLE] = n.k
    record[offset + OfRecord.STAMP_NS] = n.clock.wake
    record[offset + OfRecord.HEADER] = sh.CDR_HEADER
    offset += RECORD_HEAD
    for i in range(rings.n_state):
        record[offset + i] = bits_of(n.v[rings.state_columns[i]])
    offset += rings.n_state
    record[offset] = sh.CDR_HEADER
    for i in range(rings.n_timing):
        record[offset + 1 + i] = bits_of(n.v[rings.timing_columns[i]])
    libc.store_release(n.record_ends, "head", n.record_ends.head + 1)


@loop_inline
def publish_table(n: Loop) -> None:
    """Copy the table into the snapshot under the seqlock."""
    s = n.seq[0] | 1
    libc.store_release(n.seq, 0, s)
    libc.fence_release()
    libc.memcpy(libc.address(n.snapshot), libc.address(n.v), 8 * n.n_variables)
    libc.store_release(n.seq, 0, s + 1)
