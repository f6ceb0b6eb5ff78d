"""What the recorder notes of a node beside its messages: of the whole run, whatever the log keeps.

frames    how many of each id were sent, and received in each state of the check
away      how many of the node's cycles in a row each received id stayed away at most
table     the columns that the run is judged by, where the log keeps a part: `long_logs.sidecar`
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can.e2e_states import FrameState
from pcpc.executive.log.description import NodeDescription
from pcpc.executive.log.long_logs import ColumnFile, sidecar
from pcpc.executive.loop.ring_layout import RECORD_HEAD, OfFrame, OfRecord

DRIVEN = "drive.command"  # a variable of drives alone
_ID_DIRECTION_E2E = 0xFFFF00FFFFFFFF  # of the word of a frame's row: no length, no flags


class Absences:
    """The longest absence of each received id, in cycles that the node ran: a stall counts none.

    Records are to be told before the frames of their cycles, some of which may be ahead of them.
    """

    def __init__(self, waits: bool = True) -> None:
        """Without `waits`, of a drive, an id is missed only once it has come."""
        self._waits = waits
        self._first, self._ran = 0, np.empty(0, np.int64)  # the cycles whose frames may come
        self._waiting: list[NDArray[np.int64]] = []  # cycle and id of frames ahead of the records
        self._last: dict[int, int] = {}
        self._longest: dict[int, int] = {}

    def add_cycles(self, cycles: NDArray[np.int64]) -> None:
        """Take the cycles of records. Shape (n,)."""
        self._ran = np.concatenate((self._ran, cycles))

    def add_frames(self, rows: NDArray[np.int64]) -> None:
        """Take rows of frames. Shape (n, columns of the ring)."""
        word = rows[:, OfFrame.ABOUT]
        used = (word >> 40 & 0xFF != 0) & (word >> 48 & 0xFF <= FrameState.OK_SOME_LOST)
        own = np.column_stack((rows[used, OfFrame.CYCLE], word[used] & 0xFFFFFFFF))
        self._waiting += [own] * bool(len(own))
        self._count()
        over = int(np.searchsorted(self._ran, rows[-1, OfFrame.CYCLE]))
        self._first, self._ran = self._first + over, self._ran[over:]

    def _count(self) -> None:
        last_ran = self._ran[-1] if len(self._ran) else -1
        if not self._waiting or self._waiting[0][0, 0] > last_ran:
            return  # as long as a node stands still, whose frames grow in number
        waiting = np.concatenate(self._waiting)
        past = int(np.searchsorted(waiting[:, 0], last_ran, side="right"))
        rows, self._waiting = waiting[:past], [waiting[past:]] * (past < len(waiting))
        # by id, the frames of each in their order
        rows = rows[np.argsort(rows[:, 1], kind="stable")]
        ids, passes = rows[:, 1], self._first + np.searchsorted(self._ran, rows[:, 0])
        begin = np.flatnonzero(np.concatenate(([True], ids[1:] != ids[:-1])))
        gaps, numbers = passes.copy(), ids[begin].tolist()
        gaps[1:] -= passes[:-1]
        first = np.zeros_like(begin) if self._waits else passes[begin]
        before = [self._last.get(n, i) for n, i in zip(numbers, first.tolist(), strict=True)]
        gaps[begin] = passes[begin] - before
        longest, last = np.maximum.reduceat(gaps, begin), passes[[*(begin[1:] - 1), -1]]
        for number, most, place in zip(numbers, longest.tolist(), last.tolist(), strict=True):
            self._longest[number] = max(self._longest.get(number, 0), most)
            self._last[number] = place

    def longest(self) -> dict[int, int]:
        """Return the longest absence up to now by id."""
        self._count()
        cycles, last = self._first + len(self._ran), self._last.items()
        return {number: max(self._longest[number], cycles - at) for number, at in last}


class RunCounts:
    """Counts and table of one node, of which `about` is the description of its block."""

    def __init__(self, description: NodeDescription) -> None:
        self._about = description
        self._frames: Counter[int] = Counter()
        self._absences = Absences(not any(name == DRIVEN for name, *_ in description["variables"]))
        self._table: ColumnFile | None = None
        self._cells: list[int] = []

    def open_table(self, log: Path, columns: Sequence[str]) -> None:
        """Write `columns` of the whole run to a table beside the log."""
        description = self._about
        cells = {name: RECORD_HEAD + i for i, name in enumerate(description["state_columns"])}
        first = RECORD_HEAD + len(description["state_columns"]) + 1
        cells |= {name: first + i for i, name in enumerate(description["timing_columns"])}
        file = sidecar(log, description["node"]).open("wb")
        self._table = ColumnFile(file, [name for name in columns if name in cells])
        self._cells = [
            OfRecord.CYCLE,
            OfRecord.STAMP_NS,
            *(cells[name] for name in self._table.names),
        ]

    def add(self, ring: str, rows: NDArray[np.int64]) -> None:
        """Take rows of a ring. Shape (n, columns of the ring)."""
        if ring == "frame":
            keys, counts = np.unique(rows[:, OfFrame.ABOUT] & _ID_DIRECTION_E2E, return_counts=True)
            self._frames.update(dict(zip(keys.tolist(), counts.tolist(), strict=True)))
            self._absences.add_frames(rows)
        elif ring == "record":
            self._absences.add_cycles(rows[:, OfRecord.CYCLE])
            if self._table is not None:
                self._table.append(rows[:, self._cells])

    def frame_counts(self) -> dict[str, int]:
        """Return the frames by `node.sent.ID` and `node.received.ID.STATE`, the id in hex."""
        counts = {}
        for key, count in sorted(self._frames.items()):
            number, received, state = key & 0xFFFFFFFF, key >> 40 & 0xFF, key >> 48 & 0xFF
            what = f"received.{number:X}.{state}" if received else f"sent.{number:X}"
            counts[f"{self._about['node']}.{what}"] = count
        return counts

    def absences(self) -> dict[str, int]:
        """Return the longest absences in cycles by `node.ID`, the id in hex."""
        longest = sorted(self._absences.longest().items())
        return {f"{self._about['node']}.{number:X}": cycles for number, cycles in longest}

    def close(self) -> None:
        """End the table."""
        if self._table is not None:
            self._table.close()
