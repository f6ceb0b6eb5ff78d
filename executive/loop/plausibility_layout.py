"""What the loop keeps of limits of received values: a part of LOOP."""

from pcpc.drivers.compiled.records import Cells, Element, Record, carried, cells
from pcpc.executive.loop.sizes import MAX_LIMITS


class Bounds(Element):
    """Of a received value."""

    low: float
    high: float
    rate: float  # a cycle


class Plausible(Record):
    """See `executive.loop.plausibility`; a cycle of -1 is none yet."""

    n: int
    row: Cells[int] = cells(MAX_LIMITS)  # of the received frames
    place: Cells[int] = cells(MAX_LIMITS)
    count_place: Cells[int] = cells(MAX_LIMITS)
    still_cycles: Cells[int] = cells(MAX_LIMITS)
    fault_after: Cells[int] = cells(MAX_LIMITS)
    bounds: Cells[Bounds] = cells(MAX_LIMITS)
    taken: Cells[float] = carried(shape=MAX_LIMITS)
    taken_at: Cells[int] = carried(shape=MAX_LIMITS)
    came: Cells[float] = carried(shape=MAX_LIMITS)
    came_at: Cells[int] = carried(shape=MAX_LIMITS)
    in_a_row: Cells[int] = carried(shape=MAX_LIMITS)
    told_until: Cells[int] = carried(shape=MAX_LIMITS)
