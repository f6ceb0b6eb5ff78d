"""A joint as a pair of equal poles, sampled exactly: the model that predictor and identifier share.

    x' = As x + B u,  As = [[0, 1], [A21, A22]],  A21 = -a^2,  A22 = -2 a,  a = 5 1/s        (1)
    x+ = Ad x + Bd u,  Ad = e^(-a h) [[1 + a h, h], [-a^2 h, 1 - a h]]                       (2)
    Bd = [(1 - e^(-a h) (1 + a h))/a^2; h e^(-a h)],  zero-order hold over h                 (3)

x = (position, rate) of one joint, rad and rad/s; u in rad/s2. Source: Lewis, Campos, Selmic (SIAM
2002), chapter 8; the poles are chosen.
"""

import math
from typing import Any

from pcpc.drivers.jit import inline

POLE_PER_S = 5.0
A21, A22 = -POLE_PER_S * POLE_PER_S, -2.0 * POLE_PER_S
ENTRIES = 6  # Ad by rows, Bd


def sampled(period_s: float) -> list[float]:
    """Return Ad by rows and Bd of (2) (3)."""
    a, h = POLE_PER_S, period_s
    fall = math.exp(-a * h)
    ad = [fall * (1.0 + a * h), fall * h, -fall * a * a * h, fall * (1.0 - a * h)]
    return [*ad, (1.0 - fall * (1.0 + a * h)) / (a * a), h * fall]


@inline
def advance(d: Any, q: float, v: float, u: float) -> tuple[float, float]:
    """Return (2) of one joint; `d` as `sampled` returns it."""
    return d[0] * q + d[1] * v + d[4] * u, d[2] * q + d[3] * v + d[5] * u
