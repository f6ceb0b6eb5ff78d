"""Weights of a law over a run: what one rate tunes, where they go, where the proof has them go.

A proof says of a layer once what W* is and how W is tuned, and the rest follows:

    W~ = W* - W,   W' = rate (gradient - leak W),   V has |W~|^2/(2 |rate|)
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


def size(values: Vector) -> Vector:
    """Return the Euclidean or Frobenius norm of each cycle's entry. (n, ...) to (n,)."""
    return np.sqrt(_square(values))


def inner(a: Vector, b: Vector) -> Vector:
    """Return tr(a'b) of each cycle. (n, p, q) to (n,)."""
    return np.sum((a * b).reshape(len(a), -1), axis=1)


def norm(*parts: Vector) -> Vector:
    """Return the norm of all parts together of each cycle. (n, ...) each to (n,)."""
    return np.sqrt(np.sum([size(one) ** 2 for one in parts], axis=0))


@dataclass(frozen=True)
class Weights:
    """Weights of one tuning rate in n cycles; `rate` is as declared, and positive for a theorem.

    lacks: Z~ (n, ...); moved: what each cycle adds to Z; driven: what `rate` multiplies in the Z'
    of the proof.
    """

    name: str
    rate: float
    lacks: Vector
    moved: Vector
    driven: Vector

    @property
    def metric(self) -> float:
        """What V divides |Z~|^2/2 by: the size of the rate, 1 for a rate of 0."""
        return abs(self.rate) or 1.0

    @property
    def energy(self) -> Vector:
        """Their part of V. Shape (n,)."""
        return 0.5 * _square(self.lacks) / self.metric

    def steps(self, period_s: Vector) -> Vector:
        """Return what they add to (7), (n - 1,)."""
        return 0.5 * _square(self.moved[:-1]) / (self.metric * period_s)

    def apart(self, period_s: Vector) -> float:
        """Return how far they move from where the proof has them move, over how far that is.

        `period_s`: (n - 1,).
        """
        wanted = self._expected_changes(period_s)
        off, far = float(np.linalg.norm(self._changes - wanted)), float(np.linalg.norm(wanted))
        return off / far if far != 0.0 else math.inf if off != 0.0 else 0.0

    def seen(self, period_s: Vector) -> float:
        """Return the rate by which they move; NaN where nothing drives them.

        `period_s`: (n - 1,).
        """
        wanted = self._expected_changes(period_s)
        square = float(np.sum(wanted * wanted))
        return self.rate * float(np.sum(self._changes * wanted)) / square if square else math.nan

    @property
    def _changes(self) -> Vector:
        return self.moved[:-1].reshape(len(self.moved) - 1, -1)

    def _expected_changes(self, period_s: Vector) -> Vector:
        return self.rate * self.driven[:-1].reshape(len(self.moved) - 1, -1) * period_s[:, None]


@dataclass(frozen=True)
class Layer(Weights):
    """Weights with what their tuning follows from: W as each cycle found it (n, ...), and W*."""

    w: Vector
    ideal: Vector

    @property
    def norm(self) -> float:
        """The norm of W*."""
        return float(np.linalg.norm(self.ideal))

    @property
    def leaked(self) -> Vector:
        """What a leak of 1 adds to V', tr(W~'W). Shape (n,)."""
        return inner(self.lacks, self.w)

    def part(self, name: str, rate: float, rows: slice) -> "Layer":
        """Return those rows that a rate of their own tunes."""
        lacks, moved, driven, w = (
            each[:, rows] for each in (self.lacks, self.moved, self.driven, self.w)
        )
        return Layer(name, rate, lacks, moved, driven, w, self.ideal[rows])


@dataclass(frozen=True)
class State:
    """Weights W of a law as each cycle finds them, and what it adds to them, (n, ...) both."""

    w: Vector
    moved: Vector

    def __getitem__(self, kept: tuple[slice | NDArray[np.intp], ...]) -> "State":
        """Return those that are used, of a law with room for more."""
        return State(self.w[kept], self.moved[kept])

    @classmethod
    def of_steps(cls, w: Vector) -> "State":
        """Return those of a map, W (n, ...) as each cycle found it; the last one moves nothing."""
        return cls(w, np.concatenate((np.diff(w, axis=0), np.zeros_like(w[:1]))))

    def layer(
        self, name: str, rate: float, ideal: Vector, gradient: Vector, leak: Vector | float
    ) -> Layer:
        """Return them with W* and W' = rate (gradient - leak W).

        `ideal` as one cycle's W, `gradient` as W; `leak`: a number, or one a cycle, (n,).
        """
        each = np.reshape(leak, (-1, *[1] * (self.w.ndim - 1)))
        driven = gradient - each * self.w
        return Layer(name, rate, ideal - self.w, self.moved, driven, self.w, ideal)


def _square(values: Vector) -> Vector:
    return np.sum(values.reshape(len(values), -1) ** 2, axis=1)
