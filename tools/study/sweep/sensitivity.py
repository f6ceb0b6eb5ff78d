"""Which variations decide: Sobol' indices of the draws that are there, without further runs.

    S_i  = Var(E[y | x_i]) / Var(y)           first order: what fixing x_i alone would remove    (1)
    ST_i = E[Var(y | all others)] / Var(y)    total: what would stay if all others were fixed    (2)

(1) from any draws with independent variations: x_i is cut into classes of equal count, a `choice`
and a grid into its values, and the variance between the classes is freed of what noise alone puts
there (Kelley's epsilon squared, one-way analysis of variance):

    S_i = (SSB - (m - 1) MSW) / SST,   MSW = SSW/(n - m),   m classes, n runs                    (3)

About sqrt(n) classes: what varies within a class is missing from S_i, of the order 1/m^2.

(2) only from a full grid, where runs exist that differ in x_i alone. Of random, Latin hypercube and
Sobol' draws it is not told: Saltelli's estimator needs n (d + 2) runs in a design of its own, and
nearest neighbours are too far apart for more than a few variations. There 1 - sum of S_i says how
much interactions and noise have together.

Source: Saltelli et al., Global Sensitivity Analysis, 2008, ch. 1 and 4; Plischke, Borgonovo, Smith,
EJOR 226, 2013 (given data); Kelley, PNAS 21, 1935.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcpc.tools.study.arrays import Rows, Vector

MOST_CLASSES, FEWEST_IN_ONE = 64, 5
RESAMPLED, ROWS = 200, 4000  # of more runs a part is resampled, and its spread scaled


@dataclass(frozen=True)
class Share:
    """A variation's share of a metric's variance; `low`, `high`: 95 % of `first`, by bootstrap.

    NaN: not estimable (`total` outside a full grid; all where nothing varies or runs are too few).
    `first` may lie a little below 0, as any unbiased estimate of 0 does.
    """

    name: str
    first: float
    low: float
    high: float
    total: float = math.nan


def shares(names: Sequence[str], x: Vector, y: Vector, seed: int = 0) -> list[Share]:
    """Return the shares of the columns of x (n, d) in the variance of y (n,), largest first.

    Runs whose y is not finite are left out. `seed` is the bootstrap's.
    """
    told = np.isfinite(y)
    x, y = x[told], y[told]
    totals = _totals(x, y)
    rng = np.random.default_rng(seed)
    size = min(len(y), ROWS)
    resampled = [rng.integers(len(y), size=size) for _ in range(RESAMPLED if size else 0)]
    found = []
    for name, column, total in zip(names, x.T, totals, strict=True):
        classes = _classes(column)
        first = _first(classes, y)
        spread = [_first(classes[rows], y[rows]) for rows in resampled if math.isfinite(first)]
        half = 1.96 * float(np.std(spread)) * math.sqrt(size / len(y)) if spread else math.nan
        found.append(Share(name, first, first - half, first + half, total))
    return sorted(found, key=lambda s: -s.first if math.isfinite(s.first) else math.inf)


def _classes(x: Vector) -> Rows:
    """Return the class of each value: itself where there are few values, else one of equal count.

    The number of classes is a whole one of 0, 1, ...; equal values are in one class.
    """
    most = min(MOST_CLASSES, max(math.isqrt(len(x)), 2))
    values, which = np.unique(x, return_inverse=True)
    if len(values) <= max(most, len(x) // FEWEST_IN_ONE):
        return which
    return np.searchsorted(np.quantile(x, np.arange(1, most) / most), x, side="right")


def _first(classes: Rows, y: Vector) -> float:
    """Return (3)."""
    count = np.bincount(classes)
    m, n = int(np.count_nonzero(count)), len(y)
    centred = y - y.mean() if n else y
    whole = float(centred @ centred)
    if m < 2 or n <= m or whole == 0.0:
        return math.nan
    sums = np.bincount(classes, centred)[count > 0]
    between = float((sums**2 / count[count > 0]).sum())
    return (between - (m - 1) * (whole - between) / (n - m)) / whole


def _totals(x: Vector, y: Vector) -> list[float]:
    """Return (2) of every column of a full grid, NaN of other draws."""
    values = [np.unique(column, return_inverse=True) for column in x.T]
    sizes = [len(own) for own, _ in values]
    if not len(y) or len(y) != math.prod(sizes) or min(sizes) < 2 or np.var(y) == 0.0:
        return [math.nan] * len(sizes)
    place = np.ravel_multi_index(tuple(which for _, which in values), tuple(sizes))
    if len(np.unique(place)) < len(y):
        return [math.nan] * len(sizes)
    whole = y[np.argsort(place)].reshape(sizes)
    return [float(whole.var(axis=axis).mean() / whole.var()) for axis in range(len(sizes))]
