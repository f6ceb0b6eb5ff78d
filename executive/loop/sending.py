"""What a node sends: its frames in the order of the rows, its heartbeats, the first SYNC."""

from pcpc.drivers.can import can_id, codec, e2e
from pcpc.drivers.can.wire import blank, put_frame
from pcpc.drivers.can.wire_layout import Flag
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.compiled.rows import FLAGS, LENGTH
from pcpc.drivers.compiled.structures import data_of
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import now
from pcpc.executive.loop.floods import flood
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.meeting import greet
from pcpc.executive.loop.rings import push_frame
from pcpc.executive.loop.states import HEARTBEATS
from pcpc.executive.loop.variables import CLAMPED, ERROR_CODE, NMT, STATE


class LastWord(NumberedEnum):
    """What is sent at the end."""

    HEARTBEAT, ALL_FRAMES = range(2)


@loop_inline
def copy_inputs(n: Loop, block: int) -> None:
    """Carry the wired variables into the inputs of `block` (MAX_BLOCKS: into what is sent)."""
    first = n.blocks.copies_end[block - 1] if block > 0 else 0
    for i in range(first, n.blocks.copies_end[block]):
        n.v[n.blocks.copies[i].target] = n.v[n.blocks.copies[i].source]


@loop_inline
def encode(n: Loop, row: int, counter: int) -> int:
    """Encode and protect the frame of one row of the transmit table; return the values clamped."""
    frame = n.wire.tx
    word = n.tx.frames[row].can_id | n.tx.frames[row].extended << can_id.EXTENDED_BIT
    codec.put_four_bytes(frame, 0, word)
    frame[LENGTH], frame[FLAGS] = n.tx.frames[row].dlc, n.tx.frames[row].fd_flags
    data = data_of(frame)
    if frame[FLAGS] != Flag.NONE:
        blank(frame)
    clamped = codec.pack(data, row, n.tx.frames, n.tx.signals, n.v)
    e2e.protect(data, row, n.tx.frames, counter)
    return clamped


@loop_inline
def send_tx(n: Loop) -> None:
    """Send `wire.tx`; count and record it."""
    if put_frame(n.wire):
        n.control.sent += 1
    else:
        n.control.send_errors += 1
        n.control.bus_errno = n.wire.errno
    push_frame(n, n.wire.tx, 0, 0)


@loop_function
def send_frame(n: Loop, row: int, counter: int) -> None:
    """Encode and send the frame of one row of the transmit table."""
    clamped = encode(n, row, counter)
    if clamped > 0:
        n.v[CLAMPED] = 1.0
        n.control.saturated += clamped
    send_tx(n)


@loop_function
def transmit(n: Loop) -> None:
    """Send what is due: slow frames, frames of every cycle, SYNC last (the rows' order)."""
    tx = n.tx
    if n.faults.n_floods > 0:
        flood(n)
    for row in range(tx.n):
        period = tx.frames[row].every_n
        if tx.kind[row].is_emergency != 0:
            code = int64(n.v[ERROR_CODE])
            if code != tx.kind[row].told and n.guard.off == 0:
                tx.kind[row].told = code
                send_frame(n, row, 0)
        elif n.passes % period == 0:
            send_frame(n, row, n.passes // period + tx.kind[row].is_sync)
    n.timing.sent = now(n.clock)


@loop_function
def announce(n: Loop) -> None:
    """Send the heartbeat: to a node that was heard, and at the end."""
    _send_heartbeat(n, True)


@loop_function
def announce_again(n: Loop) -> None:
    """Send the heartbeat while waiting for the other node; without a clock off the record."""
    _send_heartbeat(n, n.meeting.ordered == 0)


@loop_function
def _send_heartbeat(n: Loop, recorded: bool) -> None:
    greet(n)
    n.v[NMT] = HEARTBEATS[int64(n.v[STATE])]
    copy_inputs(n, sh.MAX_BLOCKS)
    for row in range(n.tx.n):
        if n.tx.kind[row].is_heartbeat != 0:
            if recorded:
                send_frame(n, row, 0)
            else:
                encode(n, row, 0)
                put_frame(n.wire)


@loop_function
def request_first_sample(n: Loop) -> None:
    """Send SYNC(0): the plant answers with its sample of t = 0."""
    for row in range(n.tx.n):
        if n.tx.kind[row].is_sync != 0:
            send_frame(n, row, 0)
