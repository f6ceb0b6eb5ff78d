"""What the loop keeps of faults on purpose: a part of the LOOP record."""

from pcpc.drivers.compiled.records import Cells, Record, carried, cells
from pcpc.drivers.compiled.rows import FrameBytes, Receiver
from pcpc.executive.loop.sizes import MAX_FRAMES

MAX_FAULTS = 32
FAULT_DEPTH = 64  # values or frames that a fault may hold back


class Faults(Record):
    """Of values, of frames, of floods."""

    n: int
    n_values: int
    n_floods: int  # behind the first n
    n_places: int
    every_place: Cells[int] = cells(MAX_FAULTS)  # of `left`, of faults and stalls
    n_own_stalls: int
    own_stall: Cells[int] = cells(MAX_FAULTS)  # places of `left`
    n_peer_stalls: int
    peer_stall: Cells[int] = cells(MAX_FAULTS)
    peer_stood: int  # 1 in a replay: it stood still when this cycle's input was taken
    stalled: int = carried()  # periods of a stall since the last cycle
    kind: Cells[int] = cells(MAX_FAULTS)
    how: Cells[int] = cells(MAX_FAULTS)
    place: Cells[int] = cells(MAX_FAULTS)  # of `fault.NAME.left`
    seam: Cells[int] = cells(MAX_FAULTS)
    goes_on: Cells[int] = cells(MAX_FAULTS)  # a counter, after its fault
    target: Cells[int] = cells(MAX_FAULTS)  # a variable, a row of the received frames, an id
    other: Cells[int] = cells(MAX_FAULTS)  # a further row
    seed: Cells[int] = carried(shape=MAX_FAULTS)
    acting: Cells[int] = carried(shape=MAX_FAULTS)
    since: Cells[int] = carried(shape=MAX_FAULTS)  # the cycle in which it began, -1 while it is off
    true: Cells[float] = carried(shape=MAX_FAULTS)
    kept: Cells[float] = carried(shape=MAX_FAULTS)
    earlier: Cells[float] = carried(shape=(MAX_FAULTS, FAULT_DEPTH), large=True)
    count: Cells[int] = carried(shape=MAX_FAULTS)  # frames held back
    first: Cells[int] = carried(shape=MAX_FAULTS)
    waiting: Cells[FrameBytes] = carried(shape=(MAX_FAULTS, FAULT_DEPTH), large=True)
    raw: FrameBytes
    another: FrameBytes
    shown: int = carried()  # 1: what is wrong with the frame at hand was done on purpose
    spoiled: Cells[int] = cells(MAX_FRAMES)  # 1: losses or faults may act on them
    on_wire: Cells[Receiver] = carried(shape=MAX_FRAMES)  # receivers of these as they came
    missed: int = carried()  # cycles in a row without input that nothing took on purpose
    acted: Cells[int] = carried(shape=MAX_FRAMES)  # pass + 1 in which a fault last did, by row
