"""What the samples' own noise is, and up to where a model leaves no more than that.

    s_j    median over blocks of the rms of second differences, over sqrt(6), or of rounding    (1)
    e      rms of the residuals of BLOCK samples of a sensor, over s_j                           (2)

A right model leaves no block with more than HOLDS: of 100 samples of white noise one block in 10^11
does. A sensor that only rounds errs at rest by half a step, 1.73 times what it errs in motion, and
may by ROUNDS.
"""

import math
from dataclasses import dataclass

import numpy as np

from pcpc.tools.study.arrays import Array

BLOCK = 100  # samples of a sensor whose rms is judged
HOLDS = 1.5  # times the noise: a block above it is not explained
SLOW, ROUNDS = 5.0, 1.8  # steps within which a block stays; times the rms of rounding: the same


def resolution(measured: Array, quantum: Array) -> Array:
    """Return the step of each sensor's samples (sensors,): of the bus, or the sensor's own."""
    found = np.array(quantum, float)
    for j, column in enumerate(measured.T):
        levels = np.unique(column[np.isfinite(column)])
        if len(levels) > 1:
            found[j] = max(found[j], float(np.min(np.diff(levels))))
    return found


def difference_noise(measured: Array, quantum: Array) -> Array:
    """Return s_j of (1) (sensors,); the median, because jerks are rare."""
    found = np.empty(measured.shape[1])
    for j, column in enumerate(measured.T):
        present = column[np.isfinite(column)]
        jumps = np.diff(present, 2) if len(present) > 2 else np.zeros(1)
        blocks = np.array_split(jumps, max(len(jumps) // BLOCK, 1))
        found[j] = np.median([math.sqrt(np.mean(b * b)) for b in blocks]) / math.sqrt(6.0)
        least = np.ptp(present) if len(present) else 0.0
        found[j] = max(found[j], quantum[j] / math.sqrt(12.0), 1e-9 * least, 1e-300)
    return found


@dataclass(frozen=True)
class Noise:
    """The samples' own noise s_j (sensors,), and the steps by which they come (sensors,)."""

    noise: Array
    quantum: Array

    def excess(self, predicted: Array, measured: Array) -> tuple[Array, int]:
        """Return (2) of the worst block of each sensor (sensors,), and the row of the first bad.

        Both (rows, sensors), `measured` NaN where there is no sample; the row is `rows` for none.
        """
        worst, first = np.zeros(measured.shape[1]), len(measured)
        for j, column in enumerate(measured.T):
            there = np.flatnonzero(np.isfinite(column))
            for block in np.array_split(there, max(len(there) // BLOCK, 1)):
                if len(block):
                    error = np.nan_to_num(predicted[block, j] - column[block], nan=np.inf)
                    rms = math.sqrt(np.mean(np.minimum(np.abs(error), 1e150) ** 2))
                    worst[j] = max(worst[j], rms / self.noise[j])
                    if rms > self._allowed_deviation(j, column[block]):
                        first = min(first, int(block[0]))
        return worst, first

    def _allowed_deviation(self, j: int, samples: Array) -> float:
        slow = np.ptp(samples) <= SLOW * self.quantum[j]
        rounding = ROUNDS * self.quantum[j] / math.sqrt(12.0) if slow else 0.0
        return max(HOLDS * float(self.noise[j]), rounding)
