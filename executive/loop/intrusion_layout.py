"""What the loop keeps of the senders of what it receives: a part of LOOP."""

from pcpc.drivers.compiled.records import Cells, Record, carried, cells
from pcpc.drivers.compiled.rows import FrameBytes
from pcpc.executive.loop.sizes import MAX_FRAMES, MAX_SIGNALS


class Intrusion(Record):
    """See `executive.loop.intrusion`; most by received frame."""

    reaction: int  # to what is believed
    care: Cells[int] = cells(MAX_FRAMES)  # 1: it may be taken back, or beats
    counted_frame: Cells[FrameBytes] = carried(shape=MAX_FRAMES)  # the one that moved the counter
    hints: Cells[int] = carried(shape=MAX_FRAMES)
    hint_since: Cells[int] = carried(shape=MAX_FRAMES)  # the pass in which they began
    told_until: Cells[int] = carried(shape=MAX_FRAMES)
    beat_every: Cells[int] = cells(MAX_FRAMES)  # cycles, of a heartbeat
    beat_at: Cells[int] = carried(shape=MAX_FRAMES)
    early_at: Cells[int] = carried(shape=MAX_FRAMES)
    doubted: Cells[int] = carried(shape=MAX_FRAMES)  # pass + 1 in which it is no input
    kept: Cells[int] = carried(shape=MAX_FRAMES)  # pass + 1 in which `before` holds
    fresh: Cells[int] = carried(shape=MAX_FRAMES)  # what it added to the input of that cycle
    before: Cells[float] = carried(shape=MAX_SIGNALS)  # values before this cycle's frame
