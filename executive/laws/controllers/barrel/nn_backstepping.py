"""Neural backstepping: the composite law asks for a torque, an inner loop delivers it.

    tau_d = sat(Kv r + y_NN + Kz (|Z| + Z_B) r + u_F, tau_max)     as pd_nn_fast.py (1) (2)   (1)
    tt    = tau_d - tau,  ttc = clip(tt, +-2 N m)      torque error; tau: shaft torque        (2)
    tdd   = 60 (tau_d - tdf),  tdf += T tdd            wanted torque, smoothed, and its rate  (3)
    x_2   = [1, r/0.3, tt/20, tdf/20, tdd/1000, (q_d' - hull rate)/0.5]  2.. within +-3       (4)
    phi_2 = [1, s_1..s_10, j+-(q_d' - hull rate; 0.004), j+-(tdf; 3 N m)]                     (5)
    y_2   = clip(W_2'phi_2, +-8 N m),  tuned by two_layer.py with ttc, no dead band           (6)
    u     = sat(tau_d + y_2 + I - Km (w_m/N - w), tau_max)                                    (7)
    I    += T Kb ttc     frozen while |tau_d + y_2 + I| >= tau_max; (7) has I from before     (8)
    motor = u/N                                                                               (9)

Position form of the book's u_d = tau_d' + Kb tt - y_NN: no derivative of tau_d is needed, and W_2
is tuned with + because y_2 is added. With T_a tau' = u - tau - d(x_2),
    L_2 = T_a tt^2/2 + (I - d_0)^2/(2 Kb) + tr(W~'F^-1 W~)/2 + tr(V~'G^-1 V~)/2
falls outside a ball; it assumes gear contact: inside the gap the torque cannot be controlled. The
clip of (2) is essential: without it a wide gap limit-cycles. If either network is latched off (see
tracking_network.py), y_2 and I fade away in 0.1 s; PD and the boundary-layer loop are left.
rad, rad/s, N m; positive torque raises q. Source: backstepping with neural networks after Lewis,
Campos, Selmic (SIAM 2002), chapter 5 (structure; numbers chosen).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.approximators.two_layer import (
    hidden,
    jump_pair,
    output,
    scaled,
    square_sum,
    tune,
)
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.controllers.barrel import boundary_layer, pd, pd_nn_fast, tracking_network
from pcpc.executive.laws.controllers.barrel.boundary_layer import fast
from pcpc.executive.laws.controllers.barrel.tracking_network import (
    FADE_S,
    NORM_SHOWN,
    first_layer,
    learned_torque,
)
from pcpc.executive.laws.emath import clip, sqrt, where

INPUTS, NODES, JUMPS = 6, 10, 4
PHI = 1 + NODES + JUMPS
JUMP_SPEED_RAD_S, JUMP_TORQUE_NM = 0.004, 3.0
ERROR_MAX_NM, Y_MAX_NM, SMOOTHING_PER_S = 2.0, 8.0, 60.0

_INNER = (
    Port("kb_per_s", "1/s", "Kb, integral gain of the torque loop", None, 0.0, 1e3),
    Port("f2_rate", "", "F2, tuning rate of the inner network", None, 0.0, 1e5),
    Port("fj2_rate", "", "FJ2, tuning rate of its jump nodes", None, 0.0, 1e5),
    Port("g2_rate", "", "G2, tuning rate of its first layer", None, 0.0, 1e5),
    Port("kappa2", "", "its e-modification", None, 0.0, 10.0),
)
_STATES = (
    Port("integral_Nm", "N m", "integral of the torque error (8)"),
    Port("tau_smooth_Nm", "N m", "smoothed wanted torque tdf (3)"),
    Port("inner_fault", "", "1 once the inner network was latched off"),
    Port("inner_faded_Nm", "N m", "y_2 last sent, fading after a fault"),
    Port("w2", "N m", "output weights of the inner network", size=PHI, recorded=False),
    Port("v2", "", "its first layer, row by row", size=INPUTS * NODES, recorded=False),
    Port("scratch2", "", "x, a, phi of this period", size=INPUTS + NODES + PHI, recorded=False),
)
_NETWORK = len(pd.GAINS)
_FAST = _NETWORK + len(tracking_network.PARAMETERS)
_KB = _FAST + len(boundary_layer.PARAMETERS)
_Z_MAX = _NETWORK + tracking_network.Z_MAX
_X_FAST = tracking_network.SIZE
_X_INNER = _X_FAST + boundary_layer.SIZE
INTEGRAL, TDF, FAULT, FADED, W2 = 0, 1, 2, 3, 4
V2 = W2 + PHI
XI = V2 + INPUTS * NODES
A2 = XI + INPUTS
PHI2 = A2 + NODES


@inline
def inner_loop(
    dt: float, r: float, tau_d: float, tau: float, v_j: float, latched: float, tau_max: float,
    z_max: float, p: Any, x: Any, y: Any,
) -> float:  # fmt: skip
    """Return y_2 + I of (7); `p` = (Kb, F2, FJ2, G2, kappa2); `y` gets y_2 and the norm."""
    w, v = tail(x, W2), tail(x, V2)
    xi, a, phi = tail(x, XI), tail(x, A2), tail(x, PHI2)
    tt = tau_d - tau  # (2)
    ttc = clip(tt, -ERROR_MAX_NM, ERROR_MAX_NM)
    tdd = SMOOTHING_PER_S * (tau_d - x[TDF])  # (3)
    x[TDF] = x[TDF] + dt * tdd
    xi[0] = 1.0
    xi[1] = scaled(r, 0.3)
    xi[2] = scaled(tt, 20.0)
    xi[3] = scaled(x[TDF], 20.0)
    xi[4] = scaled(tdd, 1000.0)
    xi[5] = scaled(v_j, 0.5)
    hidden(xi, INPUTS, NODES, v, a, phi)
    jump_pair(v_j, JUMP_SPEED_RAD_S, phi, 1 + NODES)
    jump_pair(x[TDF], JUMP_TORQUE_NM, phi, 3 + NODES)
    y_2 = clip(output(phi, w, PHI), -Y_MAX_NM, Y_MAX_NM)  # (6)
    norm = sqrt(square_sum(w, PHI) + square_sum(v, INPUTS * NODES))
    healthy = (latched < 0.5) & (abs(y_2) <= Y_MAX_NM) & (norm <= z_max)  # false for NaN
    x[FAULT] = where(healthy, x[FAULT], 1.0)
    trusted = x[FAULT] < 0.5
    x[FADED] = where(trusted, y_2, x[FADED] * (1.0 - dt / FADE_S))
    y[0] = x[FADED]
    y[1] = where(norm <= NORM_SHOWN, norm, NORM_SHOWN)
    added = x[FADED] + x[INTEGRAL]

    rate = where(trusted, dt, 0.0)
    tune(ttc, p[4], p[1], p[2], p[3], rate, xi, INPUTS, NODES, JUMPS, a, phi, w, v)
    free = abs(tau_d + added) < tau_max
    grown = x[INTEGRAL] + where(free, dt * p[0] * ttc, 0.0)  # (8)
    x[INTEGRAL] = where(trusted, grown, x[INTEGRAL] * (1.0 - dt / FADE_S))
    return added


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    kv, lam, km, gear, tau_max = p[0], p[1], p[2], p[3], p[4]
    q_d, q_d_rate = u[0], u[1]
    encoder, hull_pitch, hub_rate, hull_rate, motor_speed = u[2], u[3], u[4], u[5], u[6]
    q_d_acc, strain, tau = u[7], u[8], u[9]

    e = q_d - (encoder + hull_pitch)
    e_rate = q_d_rate - hub_rate
    r = e_rate + lam * e
    w = hub_rate - hull_rate
    learned = learned_torque(
        dt, e, r, (e_rate, q_d, q_d_rate, q_d_acc, w, hull_rate), tail(p, _NETWORK), x, tail(y, 4)
    )
    u_f = fast(dt, q_d, q_d_acc, strain, w, tail(p, _FAST), tail(x, _X_FAST))
    tau_d = clip(kv * r + learned + u_f, -tau_max, tau_max)  # (1)
    added = inner_loop(
        dt, r, tau_d, tau, q_d_rate - hull_rate, y[6], tau_max, p[_Z_MAX],
        tail(p, _KB), tail(x, _X_INNER), tail(y, 8),
    )  # fmt: skip
    y[6] = x[_X_INNER + FAULT]
    shaft = km * (motor_speed / gear - w)
    y[0] = clip(tau_d + added - shaft, -tau_max, tau_max) / gear  # (7) (9)
    y[1] = tau_d
    y[2] = e
    y[3] = r
    y[7] = u_f


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and both first layers, drawn one after the other."""
    draw = np.random.default_rng(int(settings["network_seed"])).uniform
    draw(-1.0, 1.0, (tracking_network.INPUTS, tracking_network.NODES))
    second = draw(-1.0, 1.0, (INPUTS, NODES)).ravel()
    return Prepared(settings, first_layer(settings) | {"v2": second})


BLOCK = Block(
    step,
    inputs=(*pd_nn_fast.BLOCK.inputs, Port("shaft_torque_Nm", "N m", "measured shaft torque, tau")),
    outputs=(
        *pd_nn_fast.BLOCK.outputs,
        Port("inner_Nm", "N m", "output of the inner network, y_2"),
        Port("norm_z2", "", "Frobenius norm of its weights; 1e6 if larger or not finite"),
    ),
    settings=(*pd_nn_fast.BLOCK.settings, *_INNER),
    parameters=(*pd_nn_fast.BLOCK.parameters, *_INNER),
    states=(*pd_nn_fast.BLOCK.states, *_STATES),
    prepare=prepare,
)
