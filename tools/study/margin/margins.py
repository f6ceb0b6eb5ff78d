"""What a frequency response of the open loop comes to: margins and where they lie.

    gain margin     1/|L| where L < 0 is real: the smallest factor above 1, the largest below  (1)
    phase margin    arg L + 180 deg where |L| = 1, the one nearest to 0                        (2)
    delay margin    the smallest (arg L + 180 deg mod 360 deg)/(360 deg f) where |L| = 1       (3)
    S = 1/(1 + L),  T = L/(1 + L),  sensitivity peak max |S|                                   (4)
    disk margin     alpha = 2/max |S - T|: the loop stays stable for every complex factor
                    (1 + delta/2)/(1 - delta/2), |delta| < alpha                               (5)
                    gain alone (2 - alpha)/(2 + alpha) to its inverse, phase alone
                    2 atan(alpha/2); alpha > 2: any gain of that side                          (6)

For a loop that is stable as it is. Source: Seiler, Packard, Gahinet, An introduction to disk
margins, IEEE Control Systems Magazine 40 (2020), with skew 0.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcpc.tools.study.arrays import Complex, Places, Vector
from pcpc.tools.study.result import plain

_NONE = math.inf
_LEVEL = 1e-2  # in turns, and the slope of log |L|: a constant
_SAME = 1e-9  # of a frequency: nearer ones have no slope between them
_NOTHING = 1e-12  # of the largest |L|: a zero, whose logarithm bends the cubics


@dataclass(frozen=True)
class MarginNumbers:
    """Numbers of (1) to (5)."""

    gain_margin: float
    "factor; null: any"
    gain_margin_hz: float
    gain_reduction: float
    "factor"
    gain_reduction_hz: float
    phase_margin_deg: float
    "null: any"
    crossover_hz: float
    delay_margin_s: float
    "null: any"
    delay_margin_samples: float
    "null: any"
    sensitivity_peak: float
    "max |1/(1 + L)|"
    sensitivity_peak_hz: float
    disk_margin: float
    "alpha"
    disk_margin_hz: float


@dataclass(frozen=True)
class MarginFacts(MarginNumbers):
    """With those of (6); null: no crossing, or not measured."""

    gain_margin_db: float
    "null: any"
    disk_gain_low: float
    "factor"
    disk_gain_high: float
    "factor; null: any"
    disk_phase_deg: float


@dataclass(frozen=True)
class Margins(MarginNumbers):
    """Numbers of (1) to (6); inf or nan where there is no crossing."""

    @property
    def gain_margin_db(self) -> float:
        """The gain margin in dB."""
        return 20.0 * math.log10(self.gain_margin)

    @property
    def disk_gain(self) -> tuple[float, float]:
        """The range of gains of (6)."""
        alpha = self.disk_margin
        high = (2.0 + alpha) / (2.0 - alpha) if alpha < 2.0 else _NONE
        return max((2.0 - alpha) / (2.0 + alpha), 0.0), high

    @property
    def disk_phase_deg(self) -> float:
        """The phase of (6), deg."""
        return 2.0 * math.degrees(math.atan(0.5 * self.disk_margin))

    def json(self) -> dict[str, Any]:
        """Return all numbers; None where not finite."""
        return plain(facts_of(self))


def facts_of(own: Margins) -> MarginFacts:
    """Return all numbers."""
    low, high = own.disk_gain
    return MarginFacts(
        **vars(own),
        gain_margin_db=own.gain_margin_db,
        disk_gain_low=low,
        disk_gain_high=high,
        disk_phase_deg=own.disk_phase_deg,
    )


def margins(f_hz: Vector, response: Complex, rate_hz: float) -> Margins:
    """Return what L at rising frequencies (n,) comes to.

    Between two of them log |L| and arg L are cubics of log f, so that few do for what is smooth.
    """
    f, size, angle = _denser(f_hz, response)
    at, gains = _gains(f, size, angle)
    above, below = gains > 1.0, gains < 1.0
    crossing, phases = _phases(f, size, angle)
    delays = np.deg2rad(np.mod(phases, 360.0)) / (2.0 * np.pi * crossing)
    delay = float(delays.min(initial=_NONE))
    loop = size * np.exp(1j * angle)
    sensitivity, disk = np.abs(1.0 / (1.0 + loop)), np.abs((1.0 - loop) / (1.0 + loop))
    widest, widest_hz = _least(-disk, disk, f)
    return Margins(
        *_least(gains[above], gains[above], at[above], _NONE),
        *_least(-gains[below], gains[below], at[below], 0.0),
        *_least(np.abs(phases), phases, crossing, _NONE),
        delay,
        delay * rate_hz,
        *_least(-sensitivity, sensitivity, f),
        2.0 / widest,
        widest_hz,
    )


def _least(
    badness: Vector, values: Vector, at: Vector, none: float = math.nan
) -> tuple[float, float]:
    """Return the value of the least badness, all (n,), and where; `none` and nan for no value."""
    if not len(values):
        return none, math.nan
    i = int(np.argmin(badness))
    return float(values[i]), float(at[i])


def _denser(f_hz: Vector, response: Complex) -> tuple[Vector, Vector, Vector]:
    """Return frequencies with 20 steps between any two, |L| and the unwrapped phase in rad."""
    keep = np.abs(response) > _NOTHING * np.abs(response).max(initial=0.0)
    keep &= np.diff(f_hz, prepend=0.0) > _SAME * f_hz
    f_hz, response = f_hz[keep], response[keep]
    if len(f_hz) < 3:
        return np.array([1.0, 2.0]), np.full(2, 1e-300), np.zeros(2)
    x, logs = np.log(f_hz), np.log(np.abs(response))
    angle = np.unwrap(np.angle(response))
    s = np.append(np.tile(np.linspace(0.0, 1.0, 20, endpoint=False), len(x) - 1), 1.0)
    i = np.append(np.repeat(np.arange(len(x) - 1), 20), len(x) - 2)
    return np.exp(x[i] + s * np.diff(x)[i]), np.exp(_cubic(x, logs, i, s)), _cubic(x, angle, i, s)


def _cubic(x: Vector, y: Vector, i: Places, s: Vector) -> Vector:
    """Return y the share s of the way from x_i to x_i+1: Hermite's cubic, slopes by parabolas."""
    slope, h = np.gradient(y, x), np.diff(x)[i]
    t, r = s * s, 1.0 - s
    own = y[i] * (1.0 + 2.0 * s) * r * r + y[i + 1] * t * (3.0 - 2.0 * s)
    return np.asarray(own + h * (slope[i] * s * r * r - slope[i + 1] * t * r))


def _gains(f: Vector, size: Vector, angle: Vector) -> tuple[Vector, Vector]:
    """Return frequencies where L is real and below 0, and 1/|L| there; both ends, too."""
    turns = (angle / np.pi - 1.0) / 2.0  # whole where L < 0
    steps = np.floor(turns)
    i = np.flatnonzero(steps[1:] != steps[:-1])
    level = np.maximum(steps[i], steps[i + 1])
    share = (level - turns[i]) / (turns[i + 1] - turns[i])
    at = f[i] * (f[i + 1] / f[i]) ** share
    gains = 1.0 / (size[i] * (size[i + 1] / size[i]) ** share)
    if abs(turns[-1] - round(turns[-1])) < 1e-6:  # half the rate, where L is real
        at, gains = np.append(at, f[-1]), np.append(gains, 1.0 / size[-1])
    level = abs(np.log(size[1] / size[0])) < _LEVEL * np.log(f[1] / f[0])
    if level and abs(turns[0] - round(turns[0])) < _LEVEL:  # towards 0, where it is, too
        at, gains = np.append(f[0], at), np.append(1.0 / size[0], gains)
    return at, gains


def _phases(f: Vector, size: Vector, angle: Vector) -> tuple[Vector, Vector]:
    """Return frequencies where |L| = 1, and arg L + 180 deg there, within +-180 deg."""
    logs = np.log(size)
    i = np.flatnonzero((logs[1:] > 0.0) != (logs[:-1] > 0.0))
    share = -logs[i] / (logs[i + 1] - logs[i])
    at = f[i] * (f[i + 1] / f[i]) ** share
    phase = np.rad2deg(angle[i] + share * (angle[i + 1] - angle[i])) + 180.0
    return at, np.mod(phase + 180.0, 360.0) - 180.0
