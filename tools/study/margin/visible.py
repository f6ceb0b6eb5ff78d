"""Which margins a measured response shows, and which its errors hide.

    |L|        between (|g| - 3 e)/(|1 + g| + 3 e) and (|g| + 3 e)/(|1 + g| - 3 e)            (1)
    arg(-L)    within 3 e/(|g| |1 + g|) rad,       g = -L/(1 + L), e: `measured.py`           (2)

    |S| <= 1/||L| - 1|,  |S - T| <= (|L| + 1)/||L| - 1|                                       (3)

A line is sure of a side of |L| = 1, or of L < 0, if (1) or (2) leave no other. A crossing counts
if what is not sure of a side lies between two that are, on different sides, and is known within a
tenth. Elsewhere such lines may hide one: a margin that it would make worse is not measured, nor is
a peak where S, or S - T, is not known within a tenth of it. Between lines L is that of
`between.py`: a number that differs by more than UNSURE among all that meet the lines is not
measured.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pcpc.tools.study.arrays import Complex, Flags, Places, Vector
from pcpc.tools.study.margin.between import between, lies_between
from pcpc.tools.study.margin.margins import Margins, margins

_SURE = 3.0  # standard errors
STRONG = 0.1  # error of L at a line that counts, relative to it
UNSURE = 0.04  # of a number
_PEAK = 0.1
_NEXT = 1.01  # of the lowest line: nearer than the next
_CLOSE = 1.25  # of |L|: S - T may be anything
_TURN, _LAG = 0.3, 0.02  # rad: of arg L to that of a power of s; lag that grows towards 0
_LEVEL = 0.1  # of a loop that is constant below: sin arg L, the slope of log |L| over log f


@dataclass(frozen=True)
class Unsure:
    """A number of the margins that is not known, about where it would be, and why."""

    name: str
    f_hz: float
    why: str


def visible_margins(
    f_hz: Vector, response: Complex, noise: Vector, rate_hz: float
) -> tuple[Margins, list[Unsure]]:
    """Return the margins of a response at rising lines (n,); nan for what errors hide.

    And those that the lines leave open.
    """
    g = -response / (1.0 + response)
    size, rest, e = np.abs(g), np.abs(1.0 + g), _SURE * noise
    low = np.maximum(size - e, 0.0) / (rest + e)
    high = np.where(rest > e, (size + e) / np.maximum(rest - e, 1e-300), math.inf)
    error = e / np.maximum(size * rest, 1e-300)
    strong = error <= _SURE * STRONG
    every = between(f_hz, response, noise, rate_hz)
    counts = lies_between(every.f_hz, f_hz, strong)

    def seen(loop: Complex) -> Margins:
        """Return the margins of what lies between lines that count, and the peaks of all."""
        whole, own = (
            margins(every.f_hz, loop, rate_hz),
            margins(every.f_hz[counts], loop[counts], rate_hz),
        )
        return replace(own, **{name: getattr(whole, name) for name in _OF_PEAKS})

    own = seen(every.response)
    beyond = np.where(low > 1.0, 1, np.where(high < 1.0, -1, 0))
    if _hidden_lines(beyond, strong).any():
        nothing = dict.fromkeys(_OF_CROSSOVER, math.nan)
        own = replace(own, **nothing)
    angle = np.angle(-response)
    side = np.where(np.abs(angle) > error, np.sign(angle), 0.0).astype(int)
    turned = _hidden_lines(side, strong)
    if (turned & (low < 1.0) & (high > 0.98 / own.gain_margin)).any():
        own = replace(own, gain_margin=math.nan, gain_margin_hz=math.nan)
    if (turned & (high > 1.0) & (low * own.gain_reduction < 1.02)).any():
        own = replace(own, gain_reduction=math.nan, gain_reduction_hz=math.nan)
    own = _peaks(own, g, e)
    others = {CURVES: map(seen, every.more), _NOISE: map(seen, every.moved)}
    unsure = {
        name: why for why, some in others.items() for one in some for name in _unsure(own, one)
    }
    if not every.meets:
        known = (name for name in PLACES if not math.isnan(getattr(own, name)))
        unsure |= dict.fromkeys(known, CURVES)
    return without_unsure(own, unsure)


def without_unsure(own: Margins, why: Mapping[str, str]) -> tuple[Margins, list[Unsure]]:
    """Return margins without some numbers, and those with why they are not known."""
    found = [Unsure(name, getattr(own, PLACES[name]), what) for name, what in why.items()]
    for name in why:
        own = replace(own, **dict.fromkeys(_WITH[name], math.nan))
    return own, found


def without_below(own: Margins, f_hz: Vector, response: Complex) -> tuple[Margins, list[Unsure]]:
    """Return the margins without those that L below the lowest line may change.

    For L of lines (n,) alone; a linear loop knows it. Where it is a constant at the lowest line it
    is one below. Elsewhere "none" says more than lines can know. Where |L| leaves 1, no peak below
    is higher than (3) of the lowest line, or than 1 where L is as an integrator's. Where |L| comes
    to 1, a peak at the lowest line may go on; where no other crossing was seen, any may be below.
    """
    if len(f_hz) < 3:
        return own, []
    first, third = np.maximum(np.abs(response[[0, 2]]), 1e-300).tolist()
    slope = math.log(third / first) / math.log(f_hz[2] / f_hz[0])
    if abs(slope) < _LEVEL and abs(math.sin(np.angle(response[0]))) < _LEVEL:
        return own, []
    rises = slope < 0.0  # towards 0
    crosses = rises == (first < 1.0)
    nowhere = crosses and math.isinf(own.phase_margin_deg)
    any_peak = nowhere or 1.0 / _CLOSE < first < _CLOSE
    angle, lag_below = np.angle(response[0]), np.angle(response[2] / response[0])
    turn = math.remainder(angle - 0.5 * math.pi * slope, 2.0 * math.pi)
    is_power = abs(turn) < _TURN and lag_below < _LAG and slope > -1.0 - _LEVEL  # k s^slope, k > 0
    unknown = {
        "gain_margin": math.isinf(own.gain_margin) and (first < 1.0 or not rises),
        "gain_reduction": own.gain_reduction == 0.0 and (first > 1.0 or rises),
        "phase_margin_deg": nowhere,
        "delay_margin_s": nowhere,
    }
    off = max(abs(first - 1.0), 1e-300)
    highest = {  # below, by (3), of what was seen
        "sensitivity_peak": 1.0 / (off * own.sensitivity_peak),
        "disk_margin": 0.5 * own.disk_margin * (1.0 + first) / off,
    }
    for name, share in highest.items():
        goes_on = getattr(own, PLACES[name]) < _NEXT * f_hz[0]
        higher = share > 1.0 + UNSURE and (goes_on or not is_power)
        unknown[name] = any_peak or (goes_on if crosses else higher)
    names = [name for name, is_so in unknown.items() if is_so]
    names = [name for name in names if not math.isnan(getattr(own, name))]
    return without_unsure(own, dict.fromkeys(names, _BELOW))


_OF_DELAY = ("delay_margin_s", "delay_margin_samples")
_OF_CROSSOVER = ("phase_margin_deg", "crossover_hz", *_OF_DELAY)
_OF_PEAKS = ("sensitivity_peak", "sensitivity_peak_hz", "disk_margin", "disk_margin_hz")
_BELOW = "L still moves at the lowest line"
CURVES, _NOISE = "the loop turns between two lines", "noise or a nonlinearity moves the lines"
PLACES = {
    "gain_margin": "gain_margin_hz", "gain_reduction": "gain_reduction_hz",
    "phase_margin_deg": "crossover_hz", "delay_margin_s": "crossover_hz",
    "sensitivity_peak": "sensitivity_peak_hz", "disk_margin": "disk_margin_hz",
}  # fmt: skip
_WITH = {name: (name, place) for name, place in PLACES.items()} | {"delay_margin_s": _OF_DELAY}


def differences(own: Margins, other: Margins) -> dict[str, float]:
    """Return how far others lie from the numbers that are known, relative; nan: not known there."""
    pairs = {name: (getattr(own, name), getattr(other, name)) for name in PLACES}
    return {name: _difference(a, b) for name, (a, b) in pairs.items() if not math.isnan(a)}


def _difference(a: float, b: float) -> float:
    if a == b or math.isnan(b):
        return 0.0 if a == b else math.nan
    return math.inf if a == 0.0 or math.isinf(a) else abs(b - a) / abs(a)


def _unsure(own: Margins, other: Margins) -> list[str]:
    """Return the numbers that differ, of those that are known."""
    return [name for name, share in differences(own, other).items() if not share <= UNSURE]


def _hidden_lines(side: Places, strong: Flags) -> Flags:
    """Return which lines may hide a crossing between sides 1 and -1; 0: not sure of one."""
    found = np.zeros(len(side), bool)
    sure = np.flatnonzero(side)
    for first, last in pairwise([-1, *sure.tolist(), len(side)]):
        between = slice(first + 1, last)
        inside = first >= 0 and last < len(side)
        crosses = inside and side[first] != side[last]
        found[between] = not (crosses and strong[between].all())
    return found


def _peaks(own: Margins, g: Complex, e: Vector) -> Margins:
    """Return without peaks where errors hide one; where L is large or small, S is known."""
    for one, error in ((np.abs(1.0 + g), e), (np.abs(1.0 + 2.0 * g), 2.0 * e)):
        if (one + error).max() > (1.0 + _PEAK) * one.max():
            return replace(own, **dict.fromkeys(_OF_PEAKS, math.nan))
    return own


def is_empty(one: Margins) -> bool:
    """Return whether nothing of it was measured."""
    return all(map(math.isnan, (one.gain_margin, one.phase_margin_deg, one.disk_margin)))
