"""How long a part of a record may be for its slopes to say how sure an estimate is.

    z_i     = z + REACH L g_i,  L L' = (J'J)^-1,  g_i normal                                  (1)
    smooth  a quarter of r'r(z_i) - r'r(z) at most is above ROUGH REACH^2 p, its mean         (2)

Play makes a long record's sum of squares rough: it has minima beside the right one, each steeper
than all of them together, so that (J'J)^-1 is that of one of them. A shorter part is smooth; what
it leaves open, the search may be off by.
"""

import numpy as np

from pcpc.tools.study.arrays import Array, Flags
from pcpc.tools.study.fit.search import Problem, costs, scaled_inverse

REACH, POINTS = 1.5, 32  # standard errors; points of (1)
ROUGH = 3.0  # times what slopes predict
HALVINGS = 7  # of the record, at most


def smooth_part(
    of: Problem, z: Array, noise: Array, steps: Array, free: Flags
) -> tuple[int, Array]:
    """Return the rows of the longest smooth part, 0 for none, and the free errors it leaves (p,).

    Parts are the record's first half, quarter, ...; errors of white residuals, in units of z.
    """
    found = np.zeros(len(z))
    for halved in range(HALVINGS + 1):
        rows = len(of.measured) >> halved
        _, slope = of.linearised(z, rows, noise, steps, central=False)
        inverse, size = scaled_inverse(slope[..., free])
        inverse /= np.outer(size, size)
        if _holds(of, z, rows, noise, free, inverse):
            found[free] = np.sqrt(np.diag(inverse))
            return rows, found
    return 0, found


def _holds(of: Problem, z: Array, rows: int, noise: Array, free: Flags, covariance: Array) -> bool:
    draw, count = np.random.default_rng(rows), int(free.sum())
    away = draw.standard_normal((POINTS, count)) @ np.linalg.cholesky(covariance).T
    points = np.tile(z, (POINTS + 1, 1))
    points[1:, free] += REACH * away
    cost = costs(of, points, rows, noise) * rows * len(noise)
    return bool(np.quantile(cost[1:] - cost[0], 0.75) <= ROUGH * REACH**2 * count)
