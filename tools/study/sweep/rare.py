"""Rare failures: subset simulation, a product of likely steps in place of one unlikely event.

    P(F) = P(F_1) P(F_2 | F_1) ... P(F_m | F_(m-1)),   F_1 > F_2 > ... > F_m = F                 (1)

F_i = {margin < b_i}, with b_i chosen so that a share p0 of the generation is below it, and b_m = 0.
The first generation is drawn plainly. Each later one starts p0 n Markov chains at the points below
the last bound, which are distributed as they should be, and lets each make 1/p0 - 1 steps of the
modified Metropolis algorithm: every coordinate moves on its own, accepted by the ratio of its
normal densities, and the new point counts if its margin is below the bound, else the old one stays.

The coefficient of variation that is told is an upper bound: the points of one chain are alike
(gamma), and generations that descend from each other are taken to err all in the same direction.

    cov = sum_i ((1 - P_i)/(P_i n) (1 + gamma_i))^(1/2)                                         (2)

The truth lies between (2) and the root of the sum of squares, which is what is often told.
Intervals of that cover in 75 to 90 % of the cases where 95 % are meant (linear margins, 1e-3 to
3e-7), those of (2) in 95 % and more. p has a bias of the order cov^2, as b_i come from the same
points.

Space: independent standard normal coordinates, one a variation; `vary.points_of_normal` makes u of
them. With the noise's seed held the same for all points the margin is a function of the point, as
this needs.

Source: Au and Beck, Prob. Eng. Mech. 16, 2001, 263-277, sections 4 to 6.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pcpc.tools.study.arrays import Flags, Vector
from pcpc.tools.study.binomial import clopper_pearson

Margins = Callable[[Vector], Vector]
MOST_GENERATIONS = 12  # p0 = 0.1: down to 1e-12
HALF_WIDTH = 1.0  # of a step's uniform distribution, in standard deviations


@dataclass(frozen=True)
class Rare:
    """A probability of failure, `p` = 0 where none was found: then below `resolved`.

    `cov`: of p, (2); `levels`: the bounds b_i, the last is 0 unless no failure
    was found; `runs`: how many margins were asked for; `failing`: points (k, d) with margin < 0.
    """

    p: float
    cov: float
    levels: tuple[float, ...]
    runs: int
    failing: Vector
    resolved: float

    def interval(self) -> tuple[float, float]:
        """Return the interval of p at 95 %; (0, resolved) without failure.

        One generation is drawn plainly: its failures are counted. Of more, ln p is normal.
        """
        if self.p == 0.0:
            return 0.0, self.resolved
        if len(self.levels) == 1:
            return clopper_pearson(round(self.p * self.runs), self.runs, 0.95)
        factor = math.exp(1.96 * math.sqrt(math.log1p(self.cov**2)))
        return self.p / factor, min(self.p * factor, 1.0)


def subset(margins: Margins, d: int, n: int = 1000, seed: int = 0, p0: float = 0.1) -> Rare:
    """Return the probability that the margin of a standard normal point of `d` is below 0.

    `margins` takes points (k, d) and returns (k,), below 0 for a failure, -inf for a run without a
    margin that failed; k is n first and p0 n in every later call. The same seed asks for the same
    points, so that a campaign with stored results is continued. n and 1/p0: whole, n p0 >= 2.
    ValueError for NaN.
    """
    chains, length = round(n * p0), round(1.0 / p0)
    if chains < 2 or chains * length != n:
        raise ValueError(f"{n} points with p0 = {p0:g}: expected n p0 >= 2 and n = n p0 * 1/p0")
    rng = np.random.default_rng(seed)
    z = rng.standard_normal((n, d))
    g, runs = _margins_of(margins, z), n
    p, cov, levels = 1.0, 0.0, list[float]()
    alike = np.arange(n).reshape(1, n)  # row j: the j-th points of all chains
    while True:
        level = max(_bound(g, chains), 0.0)
        below = g < level
        share = float(below.mean())
        if share == 0.0 or (level > 0.0 and len(levels) == MOST_GENERATIONS - 1):
            return Rare(0.0, math.nan, (*levels, level), runs, z[g < 0.0], p * max(share, 3.0 / n))
        p *= share
        cov += math.sqrt((1.0 - share) / (share * n) * (1.0 + _gamma(below[alike], share)))
        levels.append(level)
        if level == 0.0:
            return Rare(p, cov, tuple(levels), runs, z[below], p)
        start = np.resize(rng.permutation(np.flatnonzero(below)), chains)
        z, g = _generation(margins, z[start], g[start], level, length, rng)
        runs += (length - 1) * chains
        alike = np.arange(n).reshape(length, chains)


def _bound(g: Vector, chains: int) -> float:
    """Return a bound with the lowest `chains` margins below it, and those that equal the last.

    Where these are more than half, as of margins in steps, the bound excludes them all.
    """
    last = np.partition(g, chains - 1)[chains - 1]
    above = g[g > last]
    return float((last + above.min()) / 2.0 if 2 * len(above) >= len(g) else last)


def _generation(
    margins: Margins,
    z: Vector,
    g: Vector,
    level: float,
    length: int,
    rng: np.random.Generator,
) -> tuple[Vector, Vector]:
    """Return the points of all chains, one step of all after the other, and their margins."""
    points, found = [z], [g]
    for _ in range(length - 1):
        step = z + rng.uniform(-HALF_WIDTH, HALF_WIDTH, z.shape)
        moved = rng.random(z.shape) < np.exp((z**2 - step**2) / 2.0)
        candidate = np.where(moved, step, z)
        asked = _margins_of(margins, candidate)
        taken = asked < level
        z, g = np.where(taken[:, None], candidate, z), np.where(taken, asked, g)
        points.append(z)
        found.append(g)
    return np.concatenate(points), np.concatenate(found)


def _margins_of(margins: Margins, z: Vector) -> Vector:
    found = np.asarray(margins(z), dtype=np.float64)
    if found.shape != (len(z),) or np.isnan(found).any():
        raise ValueError(f"expected {len(z)} margins without NaN, got shape {found.shape}")
    return found


def _gamma(below: Flags, share: float) -> float:
    """Return by how much the chains' likeness adds to the variance; `below` (length, chains)."""
    length = len(below)
    if length == 1 or share == 1.0:
        return 0.0
    x = below.astype(np.float64)
    whole = share * (1.0 - share)
    alike = [float((x[k:] * x[:-k]).mean()) - share**2 for k in range(1, length)]
    return 2.0 * sum((1.0 - k / length) * r / whole for k, r in enumerate(alike, 1))
