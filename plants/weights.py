"""Weights of a law over a run: what one rate tunes, where they go, where the proof has them go."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


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


def _square(values: Vector) -> Vector:
    return np.sum(values.reshape(len(values), -1) ** 2, axis=1)
