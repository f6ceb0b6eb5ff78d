"""Which margins a measured response shows, and which its errors hide.

    |L|        between (|g| - 3 e)/(|1 + g| + 3 e) and (|g| + 3 e)/(|1 + g| - 3 e)            (1)
    arg(-L)    within 3 e/(|g| |1 + g|) rad,       g = -L/(1 + L), e: `measured.py`           (2)

A line is sure of a side of |L| = 1, or of L < 0, if (1) or (2) leave no other. A crossing counts
if what is not sure of a side lies between two that are, on different sides, and is known within a
tenth. Elsewhere such lines may hide one: a margin that it would make worse is not measured, nor is
a peak where S, or S - T, is not known within a tenth of it.
"""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from pcpc.tools.study.arrays import Complex, Flags, Places, Vector
from pcpc.tools.study.margin.margins import Margins, margins

_SURE = 3.0  # standard errors
STRONG = 0.1  # error of L at a line that counts, relative to it
_PEAK = 0.1


def visible_margins(f_hz: Vector, response: Complex, noise: Vector, rate_hz: float) -> Margins:
    """Return the margins of a response at rising lines (n,); nan for what errors hide."""
    g = -response / (1.0 + response)
    size, rest, e = np.abs(g), np.abs(1.0 + g), _SURE * noise
    low = np.maximum(size - e, 0.0) / (rest + e)
    high = np.where(rest > e, (size + e) / np.maximum(rest - e, 1e-300), math.inf)
    error = e / np.maximum(size * rest, 1e-300)
    strong = error <= _SURE * STRONG
    own = margins(f_hz[strong], response[strong], rate_hz)
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
    return _peaks(own, margins(f_hz, response, rate_hz), g, e)


_OF_CROSSOVER = ("phase_margin_deg", "crossover_hz", "delay_margin_s", "delay_margin_samples")


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


def _peaks(own: Margins, every: Margins, g: Complex, e: Vector) -> Margins:
    """Return with the peaks of all lines: where L is large or small, S is known though L is not."""
    found = {
        "sensitivity_peak": every.sensitivity_peak, "disk_margin": every.disk_margin,
        "sensitivity_peak_hz": every.sensitivity_peak_hz, "disk_margin_hz": every.disk_margin_hz,
    }  # fmt: skip
    for one, error in ((np.abs(1.0 + g), e), (np.abs(1.0 + 2.0 * g), 2.0 * e)):
        if (one + error).max() > (1.0 + _PEAK) * one.max():
            return replace(own, **dict.fromkeys(found, math.nan))
    return replace(own, **found)


def is_empty(one: Margins) -> bool:
    """Return whether nothing of it was measured."""
    return all(map(math.isnan, (one.gain_margin, one.phase_margin_deg, one.disk_margin)))
