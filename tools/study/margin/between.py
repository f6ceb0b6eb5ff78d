"""A measured loop between its lines: rational functions of z through what was measured.

    g(z) = sum_j a_j/(z - z_j) / sum_j w_j/(z - z_j),  g = -L/(1 + L),  z = exp(2 pi i f/rate)   (1)

A loop of masses, drives, samplers and delays is such a function, however sharp its resonances are;
cubics of log |L| overshoot beside one. z_j: the lines where the function before erred most, one
more each time, until all are met within their errors; w_j: the least singular vector of Loewner's
matrix (AAA); a_j: least squares over all lines, which evens out their noise.

Behind the last line lies half the rate, where every loop is real: there it may cross, too.

What lies between lines is not measured, it follows. How far it can be trusted is shown by others
that meet the lines as well: with more terms, and through lines moved by their errors. Where a
number differs among them by more than a share, it is not known.

Source: Nakatsukasa, Sete, Trefethen, The AAA algorithm for rational approximation, SIAM Journal on
Scientific Computing 40 (2018).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pcpc.tools.study.arrays import Complex, Flags, Vector

_STEPS = 30  # between two lines
_MORE, _MOVED = 2, 6  # others: with up to so many more terms, through so many moved lines
_FINEST = 1e-3  # of L: errors below it are taken as this
_MOST = 40  # terms


@dataclass(frozen=True)
class Rational:
    """(1): `at` z_j, `values` a_j/w_j, `weights` w_j, (m,) each; `off`: the worst, in errors."""

    at: Complex
    values: Complex
    weights: Complex
    off: float

    def __call__(self, z: Complex) -> Complex:
        """Return g at z, (n,)."""
        apart = z[:, None] - self.at
        near = np.abs(apart) < 1e-13
        terms = self.weights / np.where(near, 1.0, apart)
        found = np.einsum("ij,j->i", terms, self.values) / terms.sum(axis=1)
        return np.where(near.any(axis=1), self.values[near.argmax(axis=1)], found)


def rationals(z: Complex, g: Complex, error: Vector) -> Iterator[Rational]:
    """Yield functions of 1, 2, ... terms for values g (n,) at z (n,) with their errors."""
    left, chosen = np.abs(g - g.mean()) / error, list[int]()
    for _ in range(min(_MOST, len(z) // 2)):
        chosen.append(int(np.argmax(left)))
        rest = np.setdiff1d(np.arange(len(z)), chosen)
        cauchy = 1.0 / (z[rest, None] - z[chosen])
        loewner = cauchy * (g[rest, None] - g[chosen]) / error[rest, None]
        weights = np.linalg.svd(loewner, full_matrices=False)[2][-1].conj()
        terms = np.zeros((len(z), len(chosen)), complex)
        terms[rest] = cauchy * weights / np.einsum("ij,j->i", cauchy, weights)[:, None]
        terms[chosen, range(len(chosen))] = 1.0
        values = np.linalg.lstsq(terms / error[:, None], g / error, rcond=1e-12)[0]
        off = np.abs(g - np.einsum("ij,j->i", terms, values)) / error
        yield Rational(z[chosen], values.astype(complex), weights, float(off.max()))
        left = off.copy()
        left[chosen] = -1.0


def likeliest(z: Complex, g: Complex, error: Vector) -> list[Rational]:
    """Return the first function that meets all values within their errors, and those behind it.

    Where there are too few values for these, the ones before it: none meets the values for sure.
    """
    found, before = list[Rational](), list[Rational]()
    for one in rationals(z, g, error):
        (found if found or one.off <= 1.0 else before).append(one)
        if len(found) > _MORE:
            return found
    return [*found, *before[::-1]][: 1 + _MORE]


@dataclass(frozen=True)
class Between:
    """L at f_hz (m,) between the lines as well, and others that meet the lines: more, moved.

    `meets`: it meets all lines; there were enough of them.
    """

    f_hz: Vector
    response: Complex
    more: list[Complex]
    moved: list[Complex]
    meets: bool


def between(f_hz: Vector, response: Complex, noise: Vector, rate_hz: float) -> Between:
    """Return L between lines (n,) where it was measured with errors `noise` of S, one deviation."""
    z, g = np.exp(2j * np.pi * f_hz / rate_hz), -response / (1.0 + response)
    error = np.maximum(3.0 * noise, _FINEST * np.abs(g) * np.abs(1.0 + g)) + 1e-12
    x, s = np.log(f_hz), np.linspace(0.0, 1.0, _STEPS, endpoint=False)
    dense = np.exp(np.append((x[:-1, None] + s * np.diff(x)[:, None]).ravel(), x[-1]))
    half = 0.5 * rate_hz
    beside = bool(f_hz[-1] < half <= 2.0 * f_hz[-1] - f_hz[-2])  # no further than the line before
    dense = np.append(dense, [half] * beside)
    at, rng = np.exp(2j * np.pi * dense / rate_hz), np.random.default_rng(0)

    def loop(one: Rational) -> Complex:
        """Return L of g at all of `dense`; it is real at half the rate."""
        found = -one(at) / (1.0 + one(at))
        return np.where(dense == half, found.real, found)

    own, *more = likeliest(z, g, error)
    moved = list[Rational]()
    for _ in range(_MOVED if noise.max() > 0.0 else 0):
        drawn = rng.standard_normal((2, len(g))) * noise / np.sqrt(2.0)
        moved.append(likeliest(z, g + drawn[0] + 1j * drawn[1], error)[0])
    others, through = ([loop(one) for one in some] for some in (more, moved))
    return Between(dense, loop(own), others, through, own.off <= 1.0)


def lies_between(places: Vector, f_hz: Vector, flags: Flags) -> Flags:
    """Return which places lie between two lines, or on one, that all have their flag."""
    first = np.clip(np.searchsorted(f_hz, places * (1.0 + 1e-9), "right") - 1, 0, len(f_hz) - 1)
    on = np.abs(f_hz[first] / places - 1.0) < 1e-9
    last = np.where(on, first, np.minimum(first + 1, len(f_hz) - 1))
    return np.asarray(flags[first] & flags[last])
