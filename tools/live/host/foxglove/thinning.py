"""Which rows of a node go to Foxglove: at most RATE_HZ a second of each topic.

Lichtblick warns above 60 a second. Of the cycles of a slot of 20 ms the first goes; of its frames
one, of the kind (id and direction) that went longest ago, so that all come in turn. Where no clock
runs and cycles pass faster than they last, only the newest slot of each look goes.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.loop.ring_layout import FRAME_WORDS, OfFrame, OfRecord

RATE_HZ = 50
_SLOT_NS = 10**9 // RATE_HZ
_KIND = 0x0000_FF00_FFFF_FFFF  # id and direction

Rows = NDArray[np.int64]


class Thinning:
    """The choice for one node."""

    def __init__(self, period_ns: int, clocked: bool) -> None:
        self._stride = -(-_SLOT_NS // period_ns)  # cycles
        self._clocked = clocked
        self._cycles_slot = -1
        self._open = np.empty((0, FRAME_WORDS), np.int64)  # frames of a slot that is not over
        self._went: dict[int, int] = {}  # kind -> when, as a count of frames that went
        self._count = 0

    def cycles(self, rows: Rows) -> Rows:
        """Return those of the rows of cycles that go."""
        slots = rows[:, OfRecord.CYCLE] // self._stride
        chosen = rows[_first_of_each(slots, self._cycles_slot)]
        if len(slots):
            self._cycles_slot = max(self._cycles_slot, int(slots[-1]))
        return chosen if self._clocked else chosen[-1:]

    def frames(self, rows: Rows) -> Rows:
        """Return those of the frames that go, of the slots that are over."""
        rows = np.concatenate((self._open, rows))
        slots = rows[:, OfFrame.STAMP_NS] // _SLOT_NS
        open_from = int(np.searchsorted(slots, slots[-1])) if len(slots) else 0
        self._open = rows[open_from:]
        begins = np.flatnonzero(np.diff(slots[:open_from], prepend=-1)).tolist()
        chosen = [self._next(rows, *part) for part in pairwise([*begins, open_from])]
        return rows[chosen if self._clocked else chosen[-1:]]

    def _next(self, rows: Rows, begin: int, end: int) -> int:
        """Return the place of the frame whose kind went longest ago; note that it goes."""
        kinds = (rows[begin:end, OfFrame.ABOUT] & _KIND).tolist()
        place = min(range(len(kinds)), key=lambda i: self._went.get(kinds[i], -1))
        self._count += 1
        self._went[kinds[place]] = self._count
        return begin + place


def _first_of_each(slots: Rows, after: int) -> NDArray[np.bool_]:
    """Return which rows begin a slot behind `after`; `slots` rise."""
    highest = np.maximum.accumulate(np.concatenate(([after], slots)))
    return slots > highest[:-1]
