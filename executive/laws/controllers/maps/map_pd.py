"""PD with an exact model for the second-order map: what one step of the plant is to be given.

    e2 = x2 - x_d(k),  e1 = x1 - x_d(k-1),  r = e2 + lam e1                                  (1)
    tau_d(k) = x_d(k+1) - lam e2 - F(x1, x2) + Kv r        F: second_order_map.py (1)        (2)
    u(k) = tau_d(k)                                                                          (3)

gives r(k+1) = Kv r(k) - (tau_d(k) - tau(k)). The answer to the sample of k is for step k, so that
`ahead` is 0.
Beyond |r| = r_max the law is latched off and sends 0: `diverged`. Without units.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 5.3; lam and Kv are chosen.
"""

from typing import Any

from pcpc.drivers.jit import inline
from pcpc.executive.laws.block import Block, Port, stage
from pcpc.executive.laws.emath import where
from pcpc.executive.laws.models.second_order_map import drift

INPUTS = (
    Port("x_d_previous", "", "x_d(k-1)"),
    Port("x_d", "", "x_d(k)"),
    Port("x_d_next", "", "x_d(k+1)"),
    Port("x1", "", "measured x1"),
    Port("x2", "", "measured x2"),
)
GAINS = (
    Port("lam", "", "lam of the filtered error", 0.2, -1.0, 1.0),
    Port("kv", "", "Kv, what is left of r after a step", 0.998, 0.0, 1.0),
    Port("model_c", "", "coefficient of F in the law", 0.1875, 0.0, 1.0),
    Port("r_max", "", "filtered error at which the law is latched off", 1000.0, 0.0, 1e12),
)
LAM, KV, MODEL_C, R_MAX = range(len(GAINS))
LATCHED = Port("latched", "", "1 once the law was latched off")
OUTPUTS = (
    Port("command", "", "u, 0 once latched off"),
    Port("ahead", "", "1: u is for the step after the sample's"),
    Port("e", "", "e2"),
    Port("r", "", "r"),
    Port("tau_d", "", "tau_d (2)"),
    Port("diverged", "", "1 once the law was latched off"),
)


@inline
def desired(u: Any, p: Any) -> tuple[float, float, float]:
    """Return e2, r (1) and tau_d (2); `u` and `p` begin with INPUTS and GAINS."""
    e2 = u[4] - u[1]
    r = e2 + p[LAM] * (u[3] - u[0])
    return e2, r, u[2] - p[LAM] * e2 - drift(u[3], u[4], p[MODEL_C]) + p[KV] * r


@inline
def sound(r: float, p: Any, x: Any, at: int) -> bool:
    """Return whether the law was never latched off; x[at] is the latch."""
    healthy = abs(r) <= p[R_MAX]  # false for NaN
    x[at] = where(healthy, x[at], 1.0)
    return bool(x[at] < 0.5)


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One step of the map; see the module header."""
    e2, r, tau_d = desired(u, p)
    y[0] = where(sound(r, p, x, 0), tau_d, 0.0)  # (3)
    y[1], y[2], y[3], y[4], y[5] = 0.0, e2, r, tau_d, x[0]


BLOCK = Block(step, inputs=INPUTS, outputs=OUTPUTS, settings=GAINS, states=(LATCHED,))
