"""The memory of an emulated line, as a structure that the compiled loop uses (no numba here)."""

from pcpc.drivers.compiled.records import Byte, Cells, Record, cells
from pcpc.drivers.compiled.rows import FrameBytes
from pcpc.drivers.line.fd_stuffing import Place
from pcpc.drivers.line.stuffing import RAW_BITS, WIRE_BITS

SENDERS, MOST_ROOM = 18, 256


class Line(Record):
    """An emulated line and what waits for it."""

    senders: int
    room: int
    in_order: int
    per_s: int  # ticks
    bit: int  # ticks of a bit, and of one in the data phase
    fast: int
    p: float
    burst: float
    draw: int  # the generator's state
    hit_before: int
    free_at: int  # the end of the last intermission
    recessive_since: int
    sending: int  # the sender on the line, -1 for none
    entry: int  # its frame's place in its queue
    begin: int
    length: int  # bits, SOF to EOF
    places: Cells[int] = cells(len(Place))  # of its bits; what is no FD frame has none
    hit: int  # the bit that is flipped, -1 for none
    due: int  # when what is on the line has happened; with nothing there no meaning
    who: int  # of what `advance` returned: the sender
    at: int  # its time
    waited: int  # SENT: since the frame was queued
    frame: FrameBytes  # what is, or was last, on the line
    first: int  # where the first frame began
    busy: int  # ticks, intermission included
    transmit_errors: Cells[int] = cells(SENDERS)  # TEC and REC
    receive_errors: Cells[int] = cells(SENDERS)
    worst: Cells[int] = cells(SENDERS)  # the highest TEC so far
    off: Cells[int] = cells(SENDERS)
    own_bit: Cells[int] = cells(SENDERS)  # ticks of a bit as each sender has it
    told: Cells[int] = cells(SENDERS)  # what was told last, see `drivers.line.error_frames`
    news: Cells[Byte] = cells(16)
    runs_left: Cells[int] = cells(SENDERS)  # to recover
    not_before: Cells[int] = cells(SENDERS)  # of a passive sender
    waiting: Cells[int] = cells(SENDERS)  # counts, from here on
    most_waiting: Cells[int] = cells(SENDERS)
    sent: Cells[int] = cells(SENDERS)
    refused: Cells[int] = cells(SENDERS)
    lost_off: Cells[int] = cells(SENDERS)
    errors: Cells[int] = cells(SENDERS)
    times_off: Cells[int] = cells(SENDERS)
    longest: Cells[int] = cells(SENDERS)  # from the queue to the end of the frame
    frames: Cells[FrameBytes] = cells(SENDERS * MOST_ROOM)
    urgency: Cells[int] = cells(SENDERS, MOST_ROOM)
    since: Cells[int] = cells(SENDERS, MOST_ROOM)
    raw: Cells[Byte] = cells(RAW_BITS)
    wire: Cells[Byte] = cells(WIRE_BITS)
