"""A node's log in slices of cycles, each with all that the node took in them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log import reader as logs
from pcpc.executive.log.frontier import ALL
from pcpc.executive.nodes.rings import MOST_CYCLES

K, PASSES, STAMP, HEAD = range(4)  # first columns of Slice.rows, and how many


@dataclass(frozen=True)
class Slice:
    """Consecutive cycles of a node as recorded, with their frames and tunings.

    `rows` (cycles, HEAD + variables) int64: cycle, passes, stamp ns, then the variables' bits;
    `tunings`: cycle, name, value.
    """

    rows: NDArray[np.int64]
    frames: NDArray[Any]
    tunings: Sequence[tuple[int, str, float]]


class Assembler:
    """Orders the pieces of a node's log into slices whose frames and tunings are complete."""

    def __init__(self, names: Sequence[str]) -> None:
        """`names`: the recorded variables, state and timing."""
        self.most = MOST_CYCLES  # in a slice
        self.names, self.behind = names, -1  # later cycles are taken
        self.every = 0  # passes: a slice ends where their number is a multiple of it; 0: anywhere
        self.alone = ALL  # from this cycle on a slice has one
        self._rows = np.empty((0, HEAD + len(names)), np.int64)
        self._frames = np.empty(0, logs.FRAME)
        self._tunings: list[tuple[int, str, float]] = []

    def add(self, node: logs.NodeLog) -> None:
        """Append a further piece of the log; LogError if it lacks what each cycle has."""
        new = node.frames[node.frames["cycle"] > self.behind]
        self._frames = np.concatenate((self._frames, new)) if len(self._frames) else new
        tunings = map(tuning_of, node.tunings)
        self._tunings += [one for one in tunings if one[0] > self.behind]
        if not len(node.cycle):
            return
        both = {**node.columns, **node.timing}
        absent = [name for name in self.names if name not in both]
        if absent:
            raise logs.LogError(f"{len(absent)} variables, as {absent[0]}, have no record")
        rows = np.empty((len(node.cycle), HEAD + len(self.names)), np.int64)
        rows[:, K], rows[:, STAMP] = node.cycle, node.stamp_ns
        passes = both.get("health.passes", node.cycle)
        rows[:, PASSES] = np.where(np.abs(passes) < 2.0**62, passes, -1)  # no count: a gap
        for i, name in enumerate(self.names):
            rows[:, HEAD + i] = both[name].view(np.int64)
        self._rows = np.concatenate((self._rows, rows[rows[:, K] > self.behind]))

    @property
    def left(self) -> NDArray[np.int64]:
        """Return the cycles that were not taken. Shape (n,)."""
        return self._rows[:, K]

    def take(self, until: int, end: bool) -> Iterator[Slice]:
        """Yield the slices up to cycle `until`; before the `end` only full ones."""
        while True:
            here = self._rows[: self.most]
            count = int(np.argmax(here[:, K] > until)) if (here[:, K] > until).any() else len(here)
            if not count or ((full := self._full(here[:count])) == 0 and not end):
                return
            count = full or count
            rows, self._rows = self._rows[:count], self._rows[count:]
            last = rows[-1, K]
            n = int(np.searchsorted(self._frames["cycle"], last, side="right"))
            frames, self._frames = self._frames[:n], self._frames[n:]
            tunings = [t for t in self._tunings if t[0] <= last]
            self._tunings = [t for t in self._tunings if t[0] > last]
            yield Slice(rows, frames, tunings)

    def _full(self, rows: NDArray[np.int64]) -> int:
        """Return how many of the next rows are a full slice; 0 if it is to be waited for more."""
        first = int(np.searchsorted(rows[:, K], self.alone))
        ends = [max(first, 1)] if first < len(rows) else []
        if self.every:
            ends += [
                int(i) + 1 for i in np.flatnonzero((rows[:, PASSES] + 1) % self.every == 0)[:1]
            ]
        return min(ends, default=self.most if len(rows) == self.most else 0)


def tuning_of(entry: Mapping[str, Any]) -> tuple[int, str, float]:
    """Return cycle, name and value of a recorded tuning; LogError for what is none."""
    try:
        return int(entry["cycle"]), str(entry["name"]), float(entry["value"])
    except (KeyError, TypeError, ValueError, OverflowError):
        raise logs.LogError(f"a recorded tuning is invalid: {str(entry)[:80]}") from None
