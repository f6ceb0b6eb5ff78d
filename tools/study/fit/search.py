"""The search of the minimum of (2) of estimate.py: over parts of the record that grow.

    explained     rows before the first block of samples that is left with more than noise    (1)
    next part     GROWTH times those rows; less where its minimum does not explain it         (2)
    little more   where that fails: minima near the best of DRAWS points about the last one   (3)
    again         where that fails: (2) from a point about what fewer rows explained          (4)
    onward        where that fails: the whole record in larger parts, as well as it goes      (5)

An integrator that starts far off is a wrong turn at the end of a long record, and not yet one at
the end of a short one. Parts weigh the start as one measurement with an error of 100 %. Points are
drawn about an estimate as far as its covariance allows. Where all of (4) end with the same error,
the model is wrong rather than the search lost.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcpc.tools.study.arrays import Array, Flags
from pcpc.tools.study.fit.noise import Noise

Predict = Callable[[Array, int], Array]  # points (m, p), rows -> signals (m, rows, sensors)
Say = Callable[[str], None]

LEAST = 50  # rows of the first part
GROWTH, AHEAD = 1.5, 4  # of the explained rows: the next part, and how far it is looked ahead
FIRST, COARSE = 0.125, 1.6  # parts of (5): the least, as a share of the record, and to the next
CHAINS, BACKS, BUDGET = 12, 3, 250  # of searches; halvings; runs over the whole record
DRAWS, ROUNDS = 64, 4  # points of (3), and how often they are drawn about the best so far
ALIKE = 1.1  # times the least mean square: an end that is the same one
SPREADS = (0.3, 1.0, 3.0, 10.0)  # of the points of (3), in standard errors of what was explained
TRIAL, NEAR, FAR = 1e-3, 1e-8, 3e-2  # steps of differences, as shares of the scale
SHIFT = 0.03  # rms change of the signals that a step of a difference is to make, in units of s_j
TURNS = 15  # of a search over a part
RIDGE = 1e-13  # a matrix of correlations without rank keeps an inverse, which is large
WILD = 1e4  # largest residual, in units of s_j: a model that has diverged is not worse than that


@dataclass
class Problem:
    """(1) of estimate.py in units of the scale: z = theta/scale."""

    predict: Predict
    measured: Array
    scale: Array
    low: Array
    high: Array
    evaluations: int = 0
    work: int = 0  # rows of all runs

    def signals(self, z: Array, rows: int) -> Array:
        """Return the signals (m, rows, sensors) at points (m, p)."""
        self.evaluations += len(z)
        self.work += len(z) * rows
        return self.predict(np.clip(z, self.low, self.high) * self.scale, rows)

    def linearised(
        self, z: Array, rows: int, noise: Array, steps: Array, *, central: bool
    ) -> tuple[Array, Array]:
        """Return r (rows, sensors) and dr/dz (rows, sensors, p), 0 where nothing was measured.

        By central differences, or by forward ones, which cost half and do for a search.
        """
        p = len(z)
        ahead, behind = np.minimum(z + steps, self.high), np.maximum(z - steps, self.low)
        if not central:
            ahead, behind = np.where(ahead > z, ahead, behind), z
        points = np.vstack((z, _one_by_one(z, ahead), _one_by_one(z, behind)))
        y = self.signals(points if central else points[: 1 + p], rows)
        lower = y[1 + p :] if central else y[:1]
        slope = (y[1 : 1 + p] - lower) / (ahead - behind)[:, None, None] / noise
        slope[:, np.isnan(self.measured[:rows])] = 0.0
        r = bounded_residuals((y[0] - self.measured[:rows]) / noise)
        return r, np.moveaxis(np.nan_to_num(slope, nan=0.0, posinf=0.0, neginf=0.0), 0, -1)

    def excess(self, z: Array, rows: int, own: Noise) -> tuple[Array, int]:
        """Return what one point leaves over the noise (sensors,), and the rows it explains."""
        return own.excess(self.signals(z[None], rows)[0], self.measured[:rows])


@dataclass(frozen=True)
class End:
    """Where a search ended: point, steps of differences there, rows that it explains.

    `alike`: searches from several starts ended at the same place, and explained no more.
    """

    z: Array
    steps: Array
    rows: int
    alike: bool = False


def _one_by_one(z: Array, other: Array) -> Array:
    """Return (p, p): z with one of its numbers taken from `other` in each row."""
    return np.where(np.eye(len(z), dtype=bool), other, z)


def bounded_residuals(r: Array) -> Array:
    """Return residuals within WILD, 0 where there is none."""
    return np.clip(np.nan_to_num(r, nan=0.0, posinf=WILD, neginf=-WILD), -WILD, WILD)


def costs(of: Problem, points: Array, rows: int, noise: Array) -> Array:
    """Return the mean square of r (m,) of points (m, p) over the first rows."""
    r = bounded_residuals((of.signals(points, rows) - of.measured[:rows]) / noise)
    return np.asarray(np.mean(r * r, axis=(1, 2)))


def scaled_inverse(slope: Array) -> tuple[Array, Array]:
    """Return (J'J)^-1 (p, p) of columns of length 1, and their lengths (p,).

    `slope`: dr/dz (rows, sensors, p).
    """
    flat = slope.reshape(-1, slope.shape[-1])
    size = np.sqrt(np.maximum(np.sum(flat * flat, axis=0), 1e-300))  # keeps J'J well scaled
    information = (flat / size).T @ (flat / size) + RIDGE * np.eye(len(size))
    return np.linalg.inv(information), size


def _steps(slope: Array) -> Array:
    """Return steps of differences (p,) that change the signals by about SHIFT."""
    change = np.sqrt(np.mean(slope * slope, axis=(0, 1)))
    return np.clip(SHIFT / np.maximum(change, 1e-12), NEAR, FAR)


def minimum(
    of: Problem,
    z: Array,
    rows: int,
    noise: Array,
    steps: Array,
    tolerance: float,
    *,
    prior: Array | None = None,
    free: Flags | None = None,
) -> tuple[Array, Array]:
    """Return where the sum over a part is smallest, from `z` on, and steps of differences."""
    from scipy.optimize import least_squares

    free = np.ones(len(z), bool) if free is None else free
    if not free.any():
        return z, steps
    last: dict[bytes, tuple[Array, Array]] = {}

    def at(part: Array) -> tuple[Array, Array]:
        nonlocal steps
        if part.tobytes() not in last:
            full = z.copy()
            full[free] = part
            r, slope = of.linearised(full, rows, noise, steps, central=False)
            steps = _steps(slope)
            r, slope = r.ravel(), slope[..., free].reshape(-1, free.sum())
            if prior is not None:
                r = np.concatenate((r, part - prior[free]))
                slope = np.vstack((slope, np.eye(free.sum())))
            last.clear()
            last[part.tobytes()] = r, slope
        return last[part.tobytes()]

    margin = 1e-9 * np.maximum(1.0, np.abs(z))
    begin = np.clip(z, of.low + margin, of.high - margin)[free]
    found = least_squares(
        lambda part: at(part)[0],
        begin,
        lambda part: at(part)[1],
        (of.low[free], of.high[free]),
        method="trf",
        ftol=tolerance,
        xtol=1e-12,
        gtol=1e-10,
        max_nfev=TURNS,
    )
    full = z.copy()
    full[free] = found.x
    return full, steps


def find(of: Problem, start: Array, own: Noise, say: Say) -> End:
    """Return how far the record is explained from a start (p,) on: (1) to (4)."""
    whole, trail = len(of.measured), [End(start, np.full(len(start), TRIAL), 0)]
    best = _grow(of, trail, start, own, say)
    ends = [best]
    while best.rows < whole and len(ends) < CHAINS and of.work < BUDGET * whole:
        back = best.rows / 2.0 ** (1 + (len(ends) - 1) % BACKS)
        begun = [one for one in trail if one.rows <= back]
        points = _points_around(of, begun[-1], own.noise, len(ends))
        rows = min(whole, max(LEAST, 2 * begun[-1].rows))
        nearest = points[np.argmin(costs(of, points, rows, own.noise))]
        ends.append(_grow(of, begun, nearest, own, say))
        if ends[-1].rows > best.rows:
            best, trail = ends[-1], begun
    return replace(best, alike=best.rows < whole and _ends_agree(of, ends, best.rows, own))


def _ends_agree(of: Problem, ends: Sequence[End], rows: int, own: Noise) -> bool:
    """Return whether searches from several starts ended as one would that has the minimum."""
    part = min(len(of.measured), _little_more(rows))
    if any(_little_more(one.rows) < rows for one in ends):
        return False
    cost = costs(of, np.stack([one.z for one in ends]), part, own.noise)
    return len(ends) > 2 and bool(cost.max() <= ALIKE * cost.min())


def _little_more(rows: int) -> int:
    return rows + max(LEAST, rows // 50)


def _grow(of: Problem, trail: list[End], z: Array, own: Noise, say: Say) -> End:
    """Return where parts that grow end, and add what is explained on the way to the trail."""
    whole, start = len(of.measured), trail[0].z
    now, growth = replace(trail[-1], z=z), GROWTH
    while True:
        explained = of.excess(now.z, min(whole, AHEAD * max(now.rows, LEAST)), own)[1]
        now = replace(now, rows=max(now.rows, explained))
        share = 100.0 * now.rows / whole
        say(f"{share:.0f} % of the record explained, {of.evaluations} runs so far")
        if now.rows == whole:
            return now
        part = min(whole, max(now.rows + LEAST, math.ceil(growth * now.rows)))
        end = _fit_part(of, now, part, own, start)
        if end.rows == part:
            growth = min(GROWTH, 1.0 + 2.0 * (growth - 1.0))
        else:
            growth = 1.0 + (growth - 1.0) / 3.0
            part = min(whole, _little_more(now.rows))
            end = _fit_from_around(of, now, part, own, start)
            if end.rows < part:
                return replace(end, rows=now.rows)
        now = end
        trail.append(now)


def _fit_part(of: Problem, begun: End, rows: int, own: Noise, start: Array) -> End:
    """Return the minimum of a part, and how many rows it explains."""
    tolerance = 1.0 / (rows * len(own.noise))  # of the sum of squares, about 1: a trap costs more
    z, steps = minimum(of, begun.z, rows, own.noise, begun.steps, tolerance, prior=start)
    return End(z, steps, of.excess(z, rows, own)[1])


def _fit_from_around(of: Problem, begun: End, rows: int, own: Noise, start: Array) -> End:
    """Return (3): what explains a part, or else agrees best with it."""
    best, least = begun, math.inf
    for turn in range(ROUNDS):
        points = _points_around(of, replace(best, rows=begun.rows), own.noise, turn)
        points = np.vstack((points, best.z))
        nearest = replace(best, z=points[np.argmin(costs(of, points, rows, own.noise))])
        end = _fit_part(of, nearest, rows, own, start)
        if end.rows == rows:
            return end
        cost = float(costs(of, end.z[None], rows, own.noise)[0])
        if cost < least:
            best, least = end, cost
    return best


def _points_around(of: Problem, begun: End, noise: Array, seed: int) -> Array:
    """Return points about another (DRAWS, p), as far as what it explains and the start allow."""
    z, rows = begun.z, max(begun.rows, 1)
    draw, size = np.random.default_rng((rows, seed)), np.maximum(np.abs(z), 0.1)
    _, slope = of.linearised(z, rows, noise, begun.steps, central=False)
    flat = slope.reshape(-1, len(z)) * size
    information = flat.T @ flat + np.eye(len(z))
    spread = np.linalg.cholesky(np.linalg.inv(information))
    away = draw.standard_normal((DRAWS, len(z))) @ spread.T
    away *= np.resize(SPREADS, DRAWS)[:, None]
    factors = np.where(z > 0.0, z * np.exp(away), z + size * away)
    return np.clip(factors, of.low, of.high)


def onward(of: Problem, begun: End, start: Array, noise: Array, say: Say) -> tuple[Array, Array]:
    """Return where (5) ends, or the start where that agrees better, and steps there."""
    whole, z, steps = len(of.measured), begun.z, begun.steps
    part = max(begun.rows, round(FIRST * whole))
    while part < whole:
        say(f"{100.0 * part / whole:.0f} % of the record fitted, {of.evaluations} runs so far")
        z, steps = minimum(of, z, part, noise, steps, 1e-2, prior=start)
        part = math.ceil(part * COARSE)
    both = np.stack((z, start))
    return np.asarray(both[np.argmin(costs(of, both, whole, noise))]), steps
