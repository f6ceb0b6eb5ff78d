"""The newest cycles of a node in a fixed amount of memory, and what a plot of them needs.

A bin is `width` successive cycles: bin b holds the cycles b width .. (b + 1) width - 1.
Its envelope is the least and the greatest value in it, so that a peak of a single cycle is seen
however coarse the plot is; NaN where it has no value. Bins are numbered from cycle 0, so that one
that is complete never changes.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Cycles = NDArray[np.int64]
Values = NDArray[np.float64]


class History:
    """At most `rows` cycles of `columns` values; the oldest go."""

    def __init__(self, rows: int, columns: int) -> None:
        self._rows, self._begin, self._end = rows, 0, 0
        self._cycle = np.zeros(2 * rows, np.int64)
        self._values = np.zeros((2 * rows, columns))

    def add(self, cycle: Cycles, values: Values) -> None:
        """Append rows, whose cycles follow those that are there."""
        cycle, values = cycle[-self._rows :], values[-self._rows :]
        if self._end + len(cycle) > len(self._cycle):
            kept = slice(max(self._begin, self._end - self._rows), self._end)
            count = kept.stop - kept.start
            self._cycle[:count], self._values[:count] = self._cycle[kept], self._values[kept]
            self._begin, self._end = 0, count
        new = slice(self._end, self._end + len(cycle))
        self._cycle[new], self._values[new] = cycle, values
        self._end = new.stop
        self._begin = max(self._begin, self._end - self._rows)

    def clear(self) -> None:
        """Forget all rows."""
        self._begin = self._end

    @property
    def cycle(self) -> Cycles:
        """The cycles that are there, (n,)."""
        return self._cycle[self._begin : self._end]

    @property
    def values(self) -> Values:
        """Their values, (n, columns)."""
        return self._values[self._begin : self._end]

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
