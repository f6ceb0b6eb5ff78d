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
from pcpc.drivers.compiled.rows import lines_of, row_of

ENDS = lines_of(("head",), ("dropped",))  # rows put and dropped


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
EVENT_ROW = row_of(" ".join(OfEvent.words()))


def data_bytes(description: Mapping[str, Any]) -> int:
    """Return how many data bytes a node's records of frames have: 8, with CAN FD 64."""
    return int(description.get("data_bytes", 8))


def frame_words(description: Mapping[str, Any]) -> int:
    """Return the columns of a row of a node's ring of frames."""
    return OfFrame.PAYLOAD + data_bytes(description) // 8
