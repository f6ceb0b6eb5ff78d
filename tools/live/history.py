"""The newest cycles of a node in a fixed amount of memory, and what a plot of them needs.

A bin is `width` successive cycles: bin b holds the cycles b width .. (b + 1) width - 1.
Its envelope is the least and the greatest value in it, so that a peak of a single cycle is seen
however coarse the plot is; NaN where it has no value. Bins are numbered from cycle 0, so that one
that is complete never changes.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Cycles = NDArray[np.int64]
Values = NDArray[np.float64]


class Newest:
    """At most `rows` rows of an array, the newest; `shape` is that of one row."""

    def __init__(self, rows: int, shape: tuple[int, ...], kind: type) -> None:
        self._rows, self._begin, self._end = rows, 0, 0
        self._room: NDArray[Any] = np.zeros((rows + max(rows // 4, 1), *shape), kind)

    def add(self, new: NDArray[Any]) -> None:
        """Append rows; the oldest go."""
        new = new[-self._rows :]
        if self._end + len(new) > len(self._room):
            kept = slice(max(self._begin, self._end - self._rows + len(new)), self._end)
            count = max(kept.stop - kept.start, 0)
            self._room[:count] = self._room[kept]
            self._begin, self._end = 0, count
        begin, self._end = self._end, self._end + len(new)
        self._room[begin : self._end] = new
        self._begin = max(self._begin, self._end - self._rows)

    def clear(self) -> None:
        """Forget all rows."""
        self._begin = self._end

    @property
    def rows(self) -> NDArray[Any]:
        """Those that are there, the oldest first; valid until the next `add`."""
        return self._room[self._begin : self._end]


class History:
    """At most `rows` cycles of `columns` values, and when each woke; the oldest go."""

    def __init__(self, rows: int, columns: int) -> None:
        self._cycle, self._stamp_ns = Newest(rows, (), np.int64), Newest(rows, (), np.int64)
        self._values = Newest(rows, (columns,), np.float64)

    def add(self, cycle: Cycles, stamp_ns: Cycles, values: Values) -> None:
        """Append rows, whose cycles follow those that are there."""
        self._cycle.add(cycle)
        self._stamp_ns.add(stamp_ns)
        self._values.add(values)

    def clear(self) -> None:
        """Forget all rows."""
        for one in (self._cycle, self._stamp_ns, self._values):
            one.clear()

    @property
    def cycle(self) -> Cycles:
        """The cycles that are there, (n,)."""
        return self._cycle.rows

    @property
    def stamp_ns(self) -> Cycles:
        """When they woke, on the clock of the node, (n,)."""
        return self._stamp_ns.rows

    @property
    def values(self) -> Values:
        """Their values, (n, columns)."""
        return self._values.rows

    def part(self, places: Sequence[int], first: int, last: int) -> tuple[Cycles, Values]:
        """Return the cycles `first` to `last` that are there, and the values at `places`."""
        begin, end = np.searchsorted(self.cycle, (first, last + 1))
        return self.cycle[begin:end], self.values[begin:end, list(places)]


def envelope(
    cycle: Cycles, values: Values, first: int, bins: int, width: int
) -> tuple[Values, Values]:
    """Return the least and the greatest value of each bin, each (columns, bins), NaN where none.

    `cycle` (n,) rises; `values` (n, columns); the bins are `first` .. first + bins - 1.
    """
    low = np.full((values.shape[1], bins), np.nan)
    high = low.copy()
    edges = np.searchsorted(cycle, width * (first + np.arange(bins + 1)))
    used = np.flatnonzero(edges[1:] > edges[:-1])
    if len(used):
        rows = values[: edges[-1]]
        low[:, used] = np.fmin.reduceat(rows, edges[used]).T
        high[:, used] = np.fmax.reduceat(rows, edges[used]).T
    return low, high
