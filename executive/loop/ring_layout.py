"""The rows of the three rings, and the words of their ends (no numba here).

    record    a cycle: head, state..., CDR header, timing...
    frame     a frame sent or received; `about` has its id, length, direction and receiver state
    event     an Event with its argument and the bits of its value, a float64

The classes have the columns of rows as clients take them, int64 (n, columns).
"""

from pcpc.drivers.compiled.numbered import Numbered
from pcpc.drivers.compiled.rows import lines_of, row_of

ENDS = lines_of(("head",), ("dropped",))  # rows put and dropped


class OfRecord(Numbered):
    """The columns before the states."""

    CYCLE, STAMP_NS, HEADER = range(3)


class OfFrame(Numbered):
    """The columns of a frame; the header is that of CDR."""

    HEADER, STAMP_NS, CYCLE, ABOUT, PAYLOAD = range(5)


class OfEvent(Numbered):
    """The columns of an event."""

    STAMP_NS, CYCLE, CODE, ARGUMENT, BITS = range(5)


RECORD_HEAD, FRAME_WORDS, EVENT_WORDS = len(OfRecord), len(OfFrame), len(OfEvent)
FRAME_ROW, EVENT_ROW = (row_of(" ".join(one.words())) for one in (OfFrame, OfEvent))
