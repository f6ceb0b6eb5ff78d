"""Figures of merit of a signal: of all its values at once, or of pieces that are joined.

A run that is short enough to lie in memory is one piece; of a longer one each piece leaves a few
numbers. Values that are not finite do not count, except for LAST.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log.distribution import Distribution

Vector = NDArray[np.float64]


def over_finite(values: Vector, statistic: Callable[[Vector], Any]) -> float:
    """Return the statistic of the finite values; NaN if there are none. `values`: (n,)."""
    told = np.isfinite(values)
    finite = values if told.all() else values[told]
    with np.errstate(over="ignore"):  # of a run that diverged
        return float(statistic(finite)) if finite.size else math.nan


def rms(values: Vector) -> float:
    """Return the root of the mean square. `values`: (n,)."""
    return math.sqrt(over_finite(values, lambda v: np.mean(v * v)))


def peak(values: Vector) -> float:
    """Return the largest magnitude. `values`: (n,)."""
    return over_finite(values, lambda v: np.max(np.abs(v)))


@dataclass(frozen=True)
class Statistic:
    """`whole`: of all values. `part`: what a piece leaves; `join`: the figure from all of those."""

    whole: Callable[[Vector], float]
    part: Callable[[Vector], Any]
    join: Callable[[Sequence[Any]], float]
    only_finite: bool = True

    def of(self, pieces: Sequence[Any]) -> float:
        """Return the figure from what the pieces left; NaN if there was no value."""
        with np.errstate(over="ignore"):
            return float(self.join(pieces)) if pieces else math.nan


def _of_finite(
    statistic: Callable[[Vector], Any], join: Callable[[Sequence[Any]], float]
) -> Statistic:
    return Statistic(lambda v: over_finite(v, statistic), statistic, join)


def _mean(parts: Sequence[tuple[int, float]]) -> float:
    total = sum(n for n, _ in parts)
    return sum(n / total * mean for n, mean in parts)


def _pooled_deviation(parts: Sequence[tuple[int, float, float]]) -> float:
    """Return the standard deviation from counts, means and variances."""
    total, mean = sum(n for n, _, _ in parts), _mean([(n, m) for n, m, _ in parts])
    return math.sqrt(sum(n / total * (v + (m - mean) ** 2) for n, m, v in parts))


def _distribution(values: Vector) -> Distribution:
    found = Distribution()
    found.add(values)
    return found


def _median(parts: Sequence[Distribution]) -> float:
    joined = parts[0]
    for part in parts[1:]:
        joined.join(part)
    return joined.quantile(0.5)


RMS = Statistic(
    rms, lambda v: (len(v), float(np.mean(v * v))), lambda parts: math.sqrt(_mean(parts))
)
PEAK = _of_finite(lambda v: np.max(np.abs(v)), max)
LOW, HIGH, SUM = _of_finite(np.min, min), _of_finite(np.max, max), _of_finite(np.sum, sum)
COUNT = Statistic(lambda v: float(np.isfinite(v).sum()), len, sum)
MEAN = Statistic(lambda v: over_finite(v, np.mean), lambda v: (len(v), float(np.mean(v))), _mean)
STD = Statistic(
    lambda v: over_finite(v, np.std),
    lambda v: (len(v), float(np.mean(v)), float(np.var(v))),
    _pooled_deviation,
)
MEDIAN = Statistic(lambda v: over_finite(v, np.median), _distribution, _median)
LAST = Statistic(
    lambda v: float(v[-1]) if len(v) else math.nan,
    lambda v: v[-1],
    lambda parts: parts[-1],
    only_finite=False,
)


def correlation(pairs: Vector) -> float:
    """Return the coefficient of correlation of two columns, (n, 2); NaN where one is constant."""
    a, b = pairs[:, 0], pairs[:, 1]
    if len(a) < 2 or not (np.std(a) > 0.0 and np.std(b) > 0.0):
        return math.nan
    return float(np.corrcoef(a, b)[0, 1])


def _moments(pairs: Vector) -> tuple[int, Vector, Vector]:
    """Return count, means and covariances."""
    mean = pairs.mean(axis=0)
    return len(pairs), mean, (pairs - mean).T @ (pairs - mean) / len(pairs)


def _joined_correlation(parts: Sequence[tuple[int, Vector, Vector]]) -> float:
    total = sum(n for n, _, _ in parts)
    mean = sum((n / total * m for n, m, _ in parts), np.zeros(2))
    spread = sum(
        (n / total * (c + np.outer(m - mean, m - mean)) for n, m, c in parts), np.zeros((2, 2))
    )
    size = spread[0, 0] * spread[1, 1]
    return float(spread[0, 1] / math.sqrt(size)) if size > 0.0 else math.nan


CORRELATION = Statistic(correlation, _moments, _joined_correlation, only_finite=False)


def _ends(pairs: Vector) -> tuple[float, float]:
    """Return the latest time, and the latest outside; -inf for none. Rows: time or NaN, outside."""
    seen = pairs[np.isfinite(pairs[:, 0])]
    outside = seen[seen[:, 1] > 0.0, 0]
    return np.max(seen[:, 0], initial=-math.inf), np.max(outside, initial=-math.inf)


def _settling(parts: Sequence[tuple[float, float]]) -> float:
    """Return the latest time outside, 0 for none; inf if none is later, NaN if there is none."""
    seen, outside = (max(ends) for ends in zip(*parts, strict=True))
    if seen == -math.inf:
        return math.nan
    return math.inf if outside == seen else max(outside, 0.0)


SETTLING = Statistic(lambda pairs: _settling([_ends(pairs)]), _ends, _settling, only_finite=False)
