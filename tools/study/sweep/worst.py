"""The worst case in the box of the variations: CMA-ES on the margin, restarted while runs last.

The box is LOW..HIGH in each u, the 0.1 % and 99.9 % quantiles; its edge is within reach. A `choice`
or grid is searched as if it were continuous and asked at the middle of its level. Each restart
begins at a random point, with twice the population at most (IPOP), so that a margin with several
valleys is searched in several of them. All margins of a population are asked for at once.

Source: Hansen, The CMA Evolution Strategy: A Tutorial, 2016; Auger and Hansen, CEC 2005 (IPOP);
the package `cma`.
"""

import math
import warnings
from collections.abc import Callable, Sequence

import numpy as np

from pcpc.tools.study.arrays import Vector
from pcpc.tools.study.sweep.vary import Variation, snap_to_levels

Margins = Callable[[Vector], Vector]
LOW, HIGH = 0.001, 0.999
FIRST_STEP = 0.3  # about a third of the box, as the tutorial advises
APART = 0.05  # cases that differ less in every u are one


def worst(
    margins: Margins,
    variations: Sequence[Variation],
    runs: int,
    seed: int = 0,
    most: int = 10,
    batch: int = 16,
) -> tuple[Vector, Vector]:
    """Return the `most` worst distinct points, (k, d) in u, and their margins (k,), lowest first.

    `margins` takes points (m, d) and returns (m,), -inf or NaN for a run that failed without one,
    inf for one that could not be done; it is asked for `runs` points in all, the first population
    of `batch`. No two of the points that are returned lie within APART of each other. The same seed
    asks for the same points. ValueError: too few runs, or margins of a wrong shape.
    """
    if runs < 1 or not variations:
        raise ValueError(f"{runs} runs, {len(variations)} variations: nothing to search")
    rng = np.random.default_rng(seed)
    points, found = np.empty((0, len(variations))), np.empty(0)
    size = batch
    while len(found) < runs:
        more, margin = _descent(margins, variations, runs - len(found), rng, size, len(found) == 0)
        points, found = np.concatenate((points, more)), np.concatenate((found, margin))
        size = min(2 * size, 8 * batch)
    kept = list[int]()
    for i in np.argsort(found, kind="stable"):
        if len(kept) < most and all(np.abs(points[i] - points[k]).max() > APART for k in kept):
            kept.append(int(i))
    return points[kept], found[kept]


def _descent(
    margins: Margins,
    variations: Sequence[Variation],
    runs: int,
    rng: np.random.Generator,
    size: int,
    first: bool,
) -> tuple[Vector, Vector]:
    """Return all points of one search, from the middle or from a random point, and their margins.

    Its last population is cut to what is left of `runs`. NaN becomes -inf.
    """
    with warnings.catch_warnings():  # matplotlib, which it would draw with, may be missing
        warnings.simplefilter("ignore")
        import cma

    d = len(variations)
    width = max(d, 2)  # of one variable the method has no covariance: a second one does nothing
    start = np.full(width, 0.5) if first else rng.uniform(LOW, HIGH, width)
    options = {
        "bounds": [LOW, HIGH],
        "popsize": size,
        "verbose": -9,
        "seed": math.nan,
        "randn": lambda *shape: rng.standard_normal(shape),
    }
    search = cma.CMAEvolutionStrategy(start, FIRST_STEP, options)
    points, found = np.empty((0, d)), np.empty(0)
    while not search.stop() and len(found) < runs:
        asked = search.ask()
        batch = snap_to_levels(variations, np.array(asked)[: runs - len(found), :d])
        margin = np.asarray(margins(batch), dtype=np.float64)
        if margin.shape != (len(batch),):
            raise ValueError(f"expected {len(batch)} margins, got shape {margin.shape}")
        margin = np.where(np.isnan(margin), -np.inf, margin)
        points, found = np.concatenate((points, batch)), np.concatenate((found, margin))
        if len(margin) == len(asked):
            finite = margin[np.isfinite(margin)]
            low, high = (finite.min(), finite.max()) if len(finite) else (0.0, 0.0)
            spread = high - low + 1.0  # -inf is told below all of its population, inf above
            search.tell(asked, np.clip(margin, low - spread, high + spread).tolist())
    return points, found
