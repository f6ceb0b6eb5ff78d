"""Which variations decide: Sobol' indices of the draws that are there, without further runs.

    y    = y0 + sum_i f_i(x_i) + r,   by least squares                                          (1)
    S_i  = Var(f_i)/Var(y)            first order: what fixing x_i alone would remove           (2)
    ST_i = E[Var(y | all others)] / Var(y)    total: what would stay if all others were fixed   (3)

f_i has a value of its own for each value of a `choice` or grid, and else is a polynomial of the
share of values below x_i. Its degree, one for all, has the least generalised cross-validation. All
f_i are found at once, so that no other variation's part stands in one, and Var(f_i) is freed of
what the rest r alone puts there, s^2 tr(G_i P_i)/n, with P the inverse of the whole Gram matrix G.

A full grid is no sample. There f_i are the means at each value, S_i the exact share of variance
between them, and their interval is a point. Where runs of it are missing, f_i is by (1) of those
that are there, its variance that of equally likely values, and the errors are those of a part of
n of N runs: (1 - n/N)^(1/2) of what they would be.

(3) only from a full grid, where runs exist that differ in x_i alone. Of random, Latin hypercube and
Sobol' draws it is not told: Saltelli's estimator needs n (d + 2) runs in a design of its own, and
nearest neighbours are too far apart for more than a few variations. There 1 - sum of S_i says how
much interactions and noise have together.

Source: Saltelli et al., Global Sensitivity Analysis, 2008, ch. 1 and 4; Craven, Wahba, Numerische
Mathematik 31, 1979 (cross-validation); Cochran, Sampling Techniques, 1977, 2.6 (finite population).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pcpc.tools.study.arrays import Vector

DEGREES, PART = (1, 2, 3, 4, 6, 8, 10), 3  # terms are a third of the runs at most
FEWEST_IN_ONE = 5  # runs of a value
MOST = 100_000  # runs that are looked at
_RIDGE = 1e-13  # of the Gram matrix: resampled runs may lack a value
RESAMPLED, ROWS = 60, 2000  # of more runs a part is resampled, and its spread scaled


@dataclass(frozen=True)
class Share:
    """A variation's share of a metric's variance; `low`, `high`: 95 % of `first`.

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
    told, rng = np.isfinite(y), np.random.default_rng(seed)
    x, y = x[told], y[told]
    totals, size = _totals(x, y), _grid_size(x)
    if len(y) > MOST and len(y) != size:
        rows = rng.choice(len(y), MOST, replace=False)
        x, y = x[rows], y[rows]
    if len(y) < 3 or np.ptp(y) == 0.0:
        first = half = np.full(len(names), math.nan)
    elif size:
        first, half = _of_grid(x, y, size)
    else:
        parts = _best_parts(x, y)
        first, half = _of_sample(parts, y), _half_width(parts, y, rng)
    found = [
        Share(name, s, s - h, s + h, total)
        for name, s, h, total in zip(names, first.tolist(), half.tolist(), totals, strict=True)
    ]
    return sorted(found, key=lambda s: -s.first if math.isfinite(s.first) else math.inf)


def _grid_size(x: Vector) -> int:
    """Return how many runs the full grid of the values has, if over half are there, once each.

    0 for other draws: where a value is drawn there are as many as runs, and so at least twice as
    many combinations with any other variation.
    """
    sizes = [len(np.unique(column)) for column in x.T]
    if sum(size > 1 for size in sizes) < 2:
        return 0
    whole = math.prod(sizes)
    return whole if whole < 2 * len(x) and len(np.unique(x, axis=0)) == len(x) else 0


def _indicators(x: Vector) -> Vector:
    """Return columns (n, m), 1 where a run has the m-th value behind the first, where f_i is 0."""
    values, which = np.unique(x, return_inverse=True)
    return (which[:, None] == np.arange(1, len(values))).astype(float)


def _of_grid(x: Vector, y: Vector, size: int) -> tuple[Vector, Vector]:
    """Return (2) of each column, and half its interval: 0 where all `size` runs are there."""
    if len(y) == size:
        means = [_means(column, y) for column in x.T]
        first = np.array([own.var() / y.var() if len(own) > 1 else math.nan for own in means])
        return first, np.where(np.isnan(first), math.nan, 0.0)
    parts = [_indicators(column) for column in x.T]
    factors, inverse, rest, free = _fit(parts, y)
    noise, missing = rest / max(free, 1), 1.0 - len(y) / size
    own, error = np.full((2, len(parts)), math.nan)
    if 2 * free < len(y) - 1 - free:
        return own, error
    for i, at in enumerate(_places(parts)):
        f, p = np.append(0.0, factors[at]), np.pad(inverse[at, at], ((1, 0), (1, 0)))
        f, p = f - f.mean(), p - p.mean(axis=0) - p.mean(axis=1)[:, None] + p.mean()
        if (m := len(f)) > 1:
            own[i] = (f @ f - noise * missing * np.trace(p)) / m
            error[i] = 1.96 * 2.0 / m * math.sqrt(max(noise * missing * (f @ p @ f), 0.0))
    whole = np.nansum(own) + noise * (free + size - len(y)) / size
    return own / whole, error / whole


def _means(x: Vector, y: Vector) -> Vector:
    """Return the mean of y at each value of x."""
    which = np.unique(x, return_inverse=True)[1]
    return np.asarray(np.bincount(which, y) / np.bincount(which))


def _best_parts(x: Vector, y: Vector) -> list[Vector]:
    """Return what each f_i is a sum of, columns (n, m), by the best of the degrees."""
    n, d = x.shape
    few = max(max(math.isqrt(n), n // FEWEST_IN_ONE) // d, 3)
    found = list[tuple[float, list[Vector]]]()
    for degree in DEGREES:
        parts = [
            _indicators(column) if len(np.unique(column)) <= few else _powers(column, degree)
            for column in x.T
        ]
        if found and sum(part.shape[1] for part in parts) > n // PART:
            break
        *_, rest, free = _fit(parts, y)
        found.append((rest / max(free, 1e-9) ** 2, parts))
    return min(found, key=lambda one: one[0])[1]


def _powers(x: Vector, degree: int) -> Vector:
    """Return Legendre's polynomials 1 to `degree` of the share of values below, (n, degree)."""
    ordered = np.sort(x)
    rank = np.searchsorted(ordered, x, "left") + np.searchsorted(ordered, x, "right")
    return np.asarray(np.polynomial.legendre.legvander(rank / len(x) - 1.0, degree)[:, 1:])


def _fit(parts: Sequence[Vector], y: Vector) -> tuple[Vector, Vector, float, int]:
    """Return the factors of all terms, P, the rest's sum of squares and its degrees of freedom."""
    terms = np.hstack(parts)
    terms, centred = terms - terms.mean(axis=0), y - y.mean()
    gram, answer = _products(terms, terms), _products(terms, centred[:, None])[:, 0]
    size = max(float(np.trace(gram)), 1e-300) / max(len(gram), 1)
    inverse: Vector = np.linalg.inv(gram + _RIDGE * size * np.eye(len(gram))).astype(np.float64)
    factors = inverse @ answer
    left = centred - np.einsum("ij,j->i", terms, factors)
    rank = round(float((inverse * gram).sum()))
    return factors, inverse, float((left * left).sum()), len(y) - 1 - rank


def _products(a: Vector, b: Vector) -> Vector:
    """Return a' b, without the threads that a library has for it: these wait on a busy machine."""
    return np.einsum("ij,ik->jk", a, b)


def _places(parts: Sequence[Vector]) -> list[slice]:
    """Return where the terms of each part are among those of all."""
    ends = np.cumsum([0, *(part.shape[1] for part in parts)]).tolist()
    return [slice(*pair) for pair in pairwise(ends)]


def _of_sample(parts: Sequence[Vector], y: Vector) -> Vector:
    """Return (2) of each part in any draws; NaN without terms, or with too few runs."""
    factors, inverse, rest, free = _fit(parts, y)
    whole = float(((y - y.mean()) ** 2).sum())
    found = np.full(len(parts), math.nan)
    for i, (part, at) in enumerate(zip(parts, _places(parts), strict=True)):
        if part.shape[1] and free > 0 and whole > 0.0:
            centred = part - part.mean(axis=0)
            gram = _products(centred, centred)
            own = factors[at] @ gram @ factors[at]
            found[i] = (own - rest / free * (gram * inverse[at, at]).sum()) / whole
    return found


def _half_width(parts: Sequence[Vector], y: Vector, rng: np.random.Generator) -> Vector:
    """Return half the interval of each share, by bootstrap."""
    size = min(len(y), ROWS)
    rows = [rng.integers(len(y), size=size) for _ in range(RESAMPLED)]
    found = np.array([_of_sample([part[some] for part in parts], y[some]) for some in rows])
    found = found[np.isfinite(found).any(axis=1)]
    if not len(found):
        return np.full(len(parts), math.nan)
    return np.asarray(1.96 * found.std(axis=0) * math.sqrt(size / len(y)))


def _totals(x: Vector, y: Vector) -> list[float]:
    """Return (3) of every column of a full grid, NaN of other draws."""
    values = [np.unique(column, return_inverse=True) for column in x.T]
    sizes = [len(own) for own, _ in values]
    if not len(y) or len(y) != math.prod(sizes) or min(sizes) < 2 or np.var(y) == 0.0:
        return [math.nan] * len(sizes)
    place = np.ravel_multi_index(tuple(which for _, which in values), tuple(sizes))
    if len(np.unique(place)) < len(y):
        return [math.nan] * len(sizes)
    whole = y[np.argsort(place)].reshape(sizes)
    return [float(whole.var(axis=axis).mean() / whole.var()) for axis in range(len(sizes))]
