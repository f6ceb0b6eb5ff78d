"""PD of `pd.py` with the boundary-layer loop of `boundary_layer.py` against the first mode.

    e = q_d - (encoder + hull_pitch),  e' = q_d' - hub_rate,  r = e' + Lam e             (1)
    tau   = sat(Kv r + u_F, tau_max)          u_F: boundary_layer.py (1) to (7)          (2)
    u     = sat(tau - Km (w_m/N - w), tau_max),  w = hub_rate - hull_rate                (3)
    motor = u/N                                                                          (4)

rad, rad/s, N m; positive torque raises q.
"""

from typing import Any

from pcpc.drivers.views import tail
from pcpc.executive.laws.block import Block, Port, stage
from pcpc.executive.laws.controllers.barrel import boundary_layer, pd
from pcpc.executive.laws.controllers.barrel.boundary_layer import fast
from pcpc.executive.laws.emath import clip

_FAST = len(pd.GAINS)


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    kv, lam, km, gear, tau_max = p[0], p[1], p[2], p[3], p[4]
    q_d, q_d_rate = u[0], u[1]
    encoder, hull_pitch, hub_rate, hull_rate, motor_speed = u[2], u[3], u[4], u[5], u[6]
    q_d_acc, strain = u[7], u[8]

    e = q_d - (encoder + hull_pitch)  # (1)
    r = (q_d_rate - hub_rate) + lam * e
    w = hub_rate - hull_rate
    u_f = fast(dt, q_d, q_d_acc, strain, w, tail(p, _FAST), x)
    tau = clip(kv * r + u_f, -tau_max, tau_max)  # (2)
    y[0] = clip(tau - km * (motor_speed / gear - w), -tau_max, tau_max) / gear  # (3) (4)
    y[1] = tau
    y[2] = e
    y[3] = r
    y[4] = u_f


BLOCK = Block(
    step,
    inputs=(*pd.INPUTS, *boundary_layer.INPUTS),
    outputs=(*pd.OUTPUTS, Port("fast_Nm", "N m", "torque of the boundary-layer loop, u_F")),
    settings=(*pd.GAINS, *boundary_layer.PARAMETERS),
    states=boundary_layer.STATES,
)
