"""Random vector functional link: a two-layer network whose first layer is drawn once and fixed.

    phi = [1; sigma(V'[1; x])]         backprop.hidden                                       (1)
    v_j ~ U(-4, 4) for each input      direction and steepness of a ridge                    (2)
    c_j ~ U(low, high)                 a point of the region                                 (3)
    threshold_j = -v_j'c_j             the ridge passes through that point                   (4)
    y = W'phi, W <- W + F phi E'       backprop.output, .tune_output: linear in W            (5)

Thresholds drawn without (4) waste the nodes whose ridge misses the region. Source: Lewis, Campos,
Selmic (SIAM 2002), chapter 1; (2) to (4) are chosen.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

STEEPNESS = 4.0


def first_layer(
    seed: int, low: Sequence[float], high: Sequence[float], nodes: int
) -> NDArray[np.float64]:
    """Return V (n+1, nodes) of (2) to (4); draws first all directions, then all points, (n, nodes).

    `low`, `high` (n,): the region. Raises ValueError unless low < high.
    """
    lower, upper = np.array(low, float), np.array(high, float)
    if lower.shape != upper.shape or not np.all(lower < upper):
        raise ValueError(f"region {low} .. {high}: expected low < high for every input")
    draw = np.random.default_rng(seed).uniform
    directions = draw(-STEEPNESS, STEEPNESS, (len(lower), nodes))
    points = draw(lower[:, None], upper[:, None], (len(lower), nodes))
    return np.vstack((-(directions * points).sum(axis=0), directions))
