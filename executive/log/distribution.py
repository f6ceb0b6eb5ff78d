"""How values are distributed, in bounded memory: quantiles of any number of them.

    key     the upper 32 of a float64's 64 bits, so that 20 bits of the mantissa count: values that
            share a key differ by less than one part in a million

Only the keys that occur are kept, with their counts, at most a million of them: of more, neighbours
are joined, and a bit of all is lost. Extremes are exact.
"""

import math

import numpy as np
from numpy.typing import NDArray

_BATCH = 1 << 20  # values sorted at once
_MOST_KEYS = 1 << 20


class Distribution:
    """Counts values as they come; NaN does not count."""

    def __init__(self) -> None:
        self.count = 0
        self.low, self.high = math.inf, -math.inf
        self._shift = np.int64(32)
        self._keys: NDArray[np.int64] = np.empty(0, np.int64)
        self._counts: NDArray[np.int64] = np.empty(0, np.int64)

    def add(self, values: NDArray[np.float64]) -> None:
        """Take values (n,)."""
        for begin in range(0, len(values), _BATCH):
            part = np.ascontiguousarray(values[begin : begin + _BATCH], np.float64)
            part = part[~np.isnan(part)] + 0.0  # no -0
            if not len(part):
                continue
            self.count += len(part)
            self.low, self.high = min(self.low, part.min()), max(self.high, part.max())
            bits = part.view(np.int64)
            keys = np.where(bits < 0, np.int64(-(2**63)) - bits, bits) >> self._shift
            self._merge(*np.unique(keys, return_counts=True))

    def _merge(self, keys: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
        keys, counts = np.concatenate((self._keys, keys)), np.concatenate((self._counts, counts))
        while True:
            self._keys, places = np.unique(keys, return_inverse=True)
            self._counts = np.zeros(len(self._keys), np.int64)
            np.add.at(self._counts, places, counts)
            if len(self._keys) <= _MOST_KEYS:
                return
            self._shift += 1
            keys, counts = self._keys >> 1, self._counts

    def quantile(self, share: float) -> float:
        """Return the value that `share` of the values do not exceed; NaN of none."""
        if not self.count:
            return math.nan
        wanted = max(math.ceil(share * self.count), 1)
        place = int(np.searchsorted(np.cumsum(self._counts), wanted))
        key = (self._keys[place : place + 1] << self._shift) + (1 << (self._shift - 1))
        value = np.where(key < 0, np.int64(-(2**63)) - key, key).view(np.float64)[0]
        return float(min(max(value, self.low), self.high))

    def join(self, other: "Distribution") -> None:
        """Take what another one has counted."""
        self.count += other.count
        self.low, self.high = min(self.low, other.low), max(self.high, other.high)
        shift = max(self._shift, other._shift)
        self._keys = self._keys >> (shift - self._shift)
        self._shift = shift
        self._merge(other._keys >> (shift - other._shift), other._counts)
