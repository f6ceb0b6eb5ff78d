"""The rows of the three rings, and the words of their ends (no numba here).

    record    a cycle: head, state..., CDR header, timing...
    frame     a frame sent or received; `about` has its id, length, direction, receiver state and
              `drivers.can.wire_layout.Flag`; 8 bytes of data, where the rig has CAN FD 64
    event     an Event with its argument and the bits of its value, a float64

The classes have the columns of rows as clients take them, int64 (n, columns).
"""

from collections.abc import Mapping
from typing import Any

from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import Cells, Element, Record, cells, line
from pcpc.executive.loop.sizes import MAX_VARIABLES


class Ends(Element):
    """Of a ring: rows put and dropped."""

    head: int = line()
    dropped: int = line()


class OfRecord(NumberedEnum):
    """The columns before the states."""

    CYCLE, STAMP_NS, HEADER = range(3)


class OfFrame(NumberedEnum):
    """The columns of a frame; the header is that of CDR."""

    HEADER, STAMP_NS, CYCLE, ABOUT, PAYLOAD = range(5)  # and further words of the payload


class OfEvent(NumberedEnum):
    """The columns of an event."""

    STAMP_NS, CYCLE, CODE, ARGUMENT, BITS = range(5)


RECORD_HEAD, FRAME_WORDS, EVENT_WORDS = len(OfRecord), len(OfFrame), len(OfEvent)
RECORD_RING_WORDS = 1 << 20  # 8 MiB: ten seconds of a 100-column record at 1 kHz
FRAME_RING_WORDS = FRAME_WORDS << 16  # six seconds of ten classic frames a cycle at 1 kHz
EVENT_RING_ROWS = 1 << 10


class EventRow(Element):
    """An event, as `OfEvent` has it."""

    stamp_ns: int
    cycle: int
    code: int
    argument: int
    bits: int


class Rings(Record):
    """What goes into them."""

    wait_recorder: int  # lockstep: a full ring delays instead of dropping
    record_rows: int
    frame_rows: int
    frame_words: int  # of a row
    n_state: int
    n_timing: int
    state_columns: Cells[int] = cells(MAX_VARIABLES)
    timing_columns: Cells[int] = cells(MAX_VARIABLES)


def data_bytes(description: Mapping[str, Any]) -> int:
    """Return how many data bytes a node's records of frames have: 8, with CAN FD 64."""
    return int(description.get("data_bytes", 8))


def frame_words(description: Mapping[str, Any]) -> int:
    """Return the columns of a row of a node's ring of frames."""
    return OfFrame.PAYLOAD + data_bytes(description) // 8
