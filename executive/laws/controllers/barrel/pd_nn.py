"""PD of `pd.py` with the neural network of `tracking_network.py`.

    e = q_d - (encoder + hull_pitch),  e' = q_d' - hub_rate,  r = e' + Lam e             (1)
    tau   = sat(Kv r + y_NN + Kz (|Z| + Z_B) r, tau_max)    tracking_network.py (1)-(6)  (2)
    u     = sat(tau - Km (w_m/N - w), tau_max),  w = hub_rate - hull_rate                (3)
    motor = u/N                                                                          (4)

M r' = -V_m r + f(x) + d - tau with f = M (q_d'' + Lam e') + ... + friction + gravity: the network
learns f along the reference. rad, rad/s, N m; positive torque raises q.
Source: filtered-error neural control after Lewis, Campos, Selmic (SIAM 2002), chapter 3.
"""

from typing import Any

from pcpc.drivers.views import tail
from pcpc.executive.laws.block import Block, Port, stage
from pcpc.executive.laws.controllers.barrel import pd, tracking_network
from pcpc.executive.laws.controllers.barrel.tracking_network import learned_torque
from pcpc.executive.laws.emath import clip

_NETWORK = len(pd.GAINS)
_INPUTS = len(pd.INPUTS)


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    kv, lam, km, gear, tau_max = p[0], p[1], p[2], p[3], p[4]
    q_d, q_d_rate = u[0], u[1]
    encoder, hull_pitch, hub_rate, hull_rate, motor_speed = u[2], u[3], u[4], u[5], u[6]
    q_d_acc = u[7]

    e = q_d - (encoder + hull_pitch)  # (1)
    e_rate = q_d_rate - hub_rate
    r = e_rate + lam * e
    w = hub_rate - hull_rate
    learned = learned_torque(
        dt, e, r, (e_rate, q_d, q_d_rate, q_d_acc, w, hull_rate), tail(p, _NETWORK), x, tail(y, 4)
    )
    tau = clip(kv * r + learned, -tau_max, tau_max)  # (2)
    y[0] = clip(tau - km * (motor_speed / gear - w), -tau_max, tau_max) / gear  # (3) (4)
    y[1] = tau
    y[2] = e
    y[3] = r


BLOCK = Block(
    step,
    inputs=(*pd.INPUTS, Port("q_d_acc_rad_s2", "rad/s2", "desired acceleration")),
    outputs=(*pd.OUTPUTS, *tracking_network.OUTPUTS),
    settings=(*pd.GAINS, *tracking_network.SETTINGS),
    parameters=(*pd.GAINS, *tracking_network.PARAMETERS),
    states=tracking_network.STATES,
    prepare=tracking_network.prepare,
)
