"""Slopes of the map of a cycle at a point: how much every value of the next cycle follows each.

    s_ij = (f_i(x + h e_j) - f_i(x - h e_j))/(2 h)                                           (1)

h is a millionth of 1 or of x_j. Where ten times that step gives another slope, or a larger one a
slope where there was none, values are looked at a thousand times closer: those that stand still
there, but not over h, are rounded, as by an encoder inside a plant. Between two of its steps, at
s_1 and s_2 along the axis j on which they lie closest, such a value grows by q:

    s_ij = q/(s_2 - s_1),      s_ik = -s_ij ds_1/dx_k       of the other axes                (2)
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pcpc.tools.study.arrays import Array, Flags, Places, Vector

Map = Callable[[dict[int, float]], Vector]
"""f at a point that differs from x by what is given by axis."""

_STEP = 1e-6  # of a difference, times 1 or the value
_KINK = 0.02  # of a slope: how much its two sides may differ
_AGREE = 0.01  # of a slope: how much two widths may differ
_FAR = (1e-4, 1e-2, 0.1)  # where a rounding coarser than a step shows
_CLOSE = 1e-3  # of a width: how near two values are that rounding makes one
_WIDTHS = 1e-8 * 3.0 ** np.arange(1.0, 17.0)  # in which steps are looked for
_GRID = np.linspace(-1.0, 1.0, 33)
_SHIFTS = 10.0 ** -np.arange(4.0, 13.0)  # of another axis, to see how much it moves a step


@dataclass(frozen=True)
class Slopes:
    """(1) in `slopes` (n, m); `bent` where its two sides differ; `rounded` where (2) is needed."""

    slopes: Array
    bent: Flags
    rounded: Flags


@dataclass(frozen=True)
class Steps:
    """Where along an axis a rounded value grows by `size`, and how far it is to the next time."""

    axis: int
    at: float
    apart: float
    level: float
    size: float


def slopes(f: Map, x: Vector, first: int, also: Places) -> Slopes:
    """Return the slopes of a map at x (m,), and which values are rounded.

    Only along the axes that are reached from `first`, f_i being the next x_i, and along `also`.
    """
    middle = f({})
    n, m = len(middle), len(x)
    found = Slopes(np.zeros((n, m)), np.zeros((n, m), bool), np.zeros((n, m), bool))
    done, wanted = set[int](), [first, *also.tolist()]
    reached = {first}
    while wanted:
        j = wanted.pop()
        if j in done:
            continue
        done.add(j)
        _column(f, found, middle, j, unit(x[j]), max(1.0, abs(x[j])))
        if j in reached:
            linked = np.flatnonzero((found.slopes[:, j] != 0.0) | found.rounded[:, j])
            new = {i for i in linked.tolist() if i < m and i != first} - reached
            reached |= new
            wanted += new
            done -= new
    return found


def unit(x: float) -> float:
    """Return how far a value may be moved: a whole number may be an index into memory."""
    return 1.0 if x == round(x) else max(1.0, abs(x))


def _column(f: Map, found: Slopes, middle: Vector, j: int, far: float, size: float) -> None:
    noise = 1e-13 * (1.0 + np.abs(middle))
    h = _STEP * size
    up, down = f({j: h}) - middle, middle - f({j: -h})
    slope = found.slopes[:, j] = (up + down) / (2.0 * h)
    found.bent[:, j] = np.abs(up - down) > _KINK * np.abs(up + down) + noise
    h = 10.0 * _STEP * far
    wider = (f({j: h}) - f({j: -h})) / (2.0 * h)
    most = _AGREE * 0.5 * (np.abs(wider) + np.abs(slope)) + noise / _STEP
    doubtful = np.abs(wider - slope) > most
    rounded = np.zeros(len(middle), bool)
    if doubtful.any():
        rounded |= doubtful & _is_rounded(f, middle, j, _STEP * far)
        found.bent[:, j] |= doubtful
    for h in np.multiply(_FAR, far):
        new = (slope == 0.0) & (np.abs(f({j: h}) - f({j: -h})) > noise) & ~rounded
        if new.any():
            rounded |= new & _is_rounded(f, middle, j, h)
    found.rounded[:, j] = rounded
    found.bent[rounded, j] = False


def _is_rounded(f: Map, middle: Vector, j: int, h: float) -> Flags:
    """Return which values stand still near most points within +-h, though not from end to end."""
    points = (-1.0, -0.61, -0.27, 0.33, 0.93)
    still = [f({j: s * h}) == f({j: (s + _CLOSE) * h}) for s in points]
    moved = np.abs(f({j: h}) - f({j: -h}))
    seen = _CLOSE * moved > 1e-14 * np.abs(middle)  # beyond the last digits of a number
    return np.asarray((np.sum(still, axis=0) >= 4) & seen & (moved > 0.0))


def steps(f: Map, x: Vector, i: int, axes: Places) -> Steps | None:
    """Return where f_i steps along that of some axes on which it does so soonest; None: nowhere.

    One that takes less than four values is no rounded slope: a switch, or a limit on both sides.
    `x`: (n,); `axes`: (k,).
    """
    for width in _WIDTHS.tolist():
        for j in axes.tolist():
            h = width * unit(x[j])
            values = np.array([f({j: s * h})[i] for s in _GRID.tolist()])
            if len(np.unique(values)) >= 4:
                return _edges(f, i, j, _GRID * h, values)
    return None


def _edges(f: Map, i: int, j: int, s: Vector, values: Vector) -> Steps | None:
    changes = np.flatnonzero(np.diff(values))[:3]
    places, middles = [], []
    for k in changes.tolist():
        middles.append(0.5 * (values[k] + values[k + 1]))
        places.append(_edge(f, i, {}, j, (s[k], s[k + 1]), middles[-1]))
    apart, between = places[1] - places[0], places[2] - places[1]
    inside = [f({j: places[1] + share * apart})[i] for share in (0.1, 0.5, 0.9)]
    if not abs(apart - between) < _AGREE * apart or np.ptp(inside) > 0.0:
        return None  # uneven, or no steps at all
    return Steps(j, places[1], apart, middles[1], middles[2] - middles[1])


def _edge(
    f: Map, i: int, also: dict[int, float], j: int, ends: tuple[float, float], level: float
) -> float:
    """Return where along j, within `ends`, f_i crosses a level."""
    low, high = ends
    rises = f(also | {j: high})[i] > level
    while True:
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return middle
        if (f(also | {j: middle})[i] > level) == rises:
            high = middle
        else:
            low = middle


def row(f: Map, x: Vector, i: int, one: Steps, columns: Places) -> Vector:
    """Return the slopes (2) of f_i along some axes, (m,) with 0 elsewhere."""
    found = np.zeros(len(x))
    found[one.axis] = one.size / one.apart
    ends = one.at - 0.4 * one.apart, one.at + 0.4 * one.apart
    for k in columns.tolist():
        if k == one.axis:
            continue
        for h in np.multiply(_SHIFTS, unit(x[k])).tolist():
            if all(_is_same_step(f, i, {k: side}, one, ends) for side in (h, -h)):
                up, down = (_edge(f, i, {k: side}, one.axis, ends, one.level) for side in (h, -h))
                if abs(up - down) > 1e-11 * max(1.0, abs(one.at)):
                    found[k] = -found[one.axis] * (up - down) / (2.0 * h)
                break
    return found


def _is_same_step(
    f: Map, i: int, also: dict[int, float], one: Steps, ends: tuple[float, float]
) -> bool:
    """Return whether the same step, and no other, is still within `ends`."""
    low, high = (f(also | {one.axis: end})[i] for end in ends)
    most = 1e-6 * abs(one.size)
    before, behind = one.level - 0.5 * one.size, one.level + 0.5 * one.size
    return bool(abs(low - before) < most and abs(high - behind) < most)
