"""Neural backstepping: the composite law asks for a torque, an inner loop delivers it.

    tau_d = sat(Kv r + y_NN + Kz (|Z| + Z_B) r + u_F, tau_max)     (4') of pd_nn_fast.py      (1)
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

from pcpc.executive.laws.approximators.two_layer import (
    hidden,
    jump_pair,
    norm,
    output,
    scaled,
    tune,
)
from pcpc.executive.laws.block import Block, Ports, Prepared, group, inline, port, stage
from pcpc.executive.laws.emath import clip, where
from pcpc.plants.atb1000.laws import boundary_layer, pd, pd_nn_fast, tracking_network
from pcpc.plants.atb1000.laws.tracking_network import FADE_S, NORM_SHOWN, first_layer

INPUTS, NODES, JUMPS = 6, 10, 4
PHI = 1 + NODES + JUMPS
JUMP_SPEED_RAD_S, JUMP_TORQUE_NM = 0.004, 3.0
ERROR_MAX_NM, Y_MAX_NM, SMOOTHING_PER_S = 2.0, 8.0, 60.0


class Gains(Ports):
    """Of the inner loop."""

    kb_per_s = port("1/s", "Kb, integral gain of the torque loop", None, 0.0, 1e3)
    f2_rate = port("", "F2, tuning rate of the inner network", None, 0.0, 1e5)
    fj2_rate = port("", "FJ2, tuning rate of its jump nodes", None, 0.0, 1e5)
    g2_rate = port("", "G2, tuning rate of its first layer", None, 0.0, 1e5)
    kappa2 = port("", "its e-modification", None, 0.0, 10.0)


class Parameters(pd_nn_fast.Parameters):
    """Of the composite law and of the inner loop."""

    inner = group(Gains)


class Settings(pd_nn_fast.Settings):
    """What a rig gives for them."""

    inner = group(Gains)


class InnerStates(Ports):
    """Integral, smoothed torque, health and weights of the inner loop."""

    integral_Nm = port("N m", "integral of the torque error (8)", adapts=True)
    tau_smooth_Nm = port("N m", "smoothed wanted torque tdf (3)")
    inner_fault = port("", "1 once the inner network was latched off")
    inner_faded_Nm = port("N m", "y_2 last sent, fading after a fault")
    w2 = port("N m", "output weights of the inner network", shape=PHI, recorded=False, adapts=True)
    v2 = port("", "its first layer, row by row", shape=(INPUTS, NODES), recorded=False, adapts=True)
    x2 = port("", "its inputs", shape=INPUTS, recorded=False)
    a2 = port("", "inputs of its nodes", shape=NODES, recorded=False)
    phi2 = port("", "its hidden vector", shape=PHI, recorded=False)


class States(pd_nn_fast.States):
    """Of the composite law and of the inner loop."""

    inner = group(InnerStates)


class Inputs(pd_nn_fast.Inputs):
    """Those of the composite law, and the torque."""

    shaft_torque_Nm = port("N m", "measured shaft torque, tau")


class Outputs(pd_nn_fast.Outputs):
    """Those of the composite law, and of the inner loop."""

    inner_Nm = port("N m", "output of the inner network, y_2")
    norm_z2 = port("", "Frobenius norm of its weights; 1e6 if larger or not finite")


@inline
def inner_loop(dt: float, tau_d: float, p: Any, x: Any, u: Any, y: Any) -> float:
    """Return y_2 + I of (7); `p` and `x` of the whole law."""
    gains, s = p.inner, x.inner
    v_j = u.q_d_rate_rad_s - u.hull_rate_rad_s
    tt = tau_d - u.shaft_torque_Nm  # (2)
    ttc = clip(tt, -ERROR_MAX_NM, ERROR_MAX_NM)
    tdd = SMOOTHING_PER_S * (tau_d - s.tau_smooth_Nm)  # (3)
    s.tau_smooth_Nm += dt * tdd
    s.x2[0] = 1.0  # (4)
    s.x2[1] = scaled(y.r_rad_s, 0.3)
    s.x2[2] = scaled(tt, 20.0)
    s.x2[3] = scaled(s.tau_smooth_Nm, 20.0)
    s.x2[4] = scaled(tdd, 1000.0)
    s.x2[5] = scaled(v_j, 0.5)
    hidden(s.x2, s.v2, s.a2, s.phi2)  # (5)
    jump_pair(v_j, JUMP_SPEED_RAD_S, s.phi2, 1 + NODES)
    jump_pair(s.tau_smooth_Nm, JUMP_TORQUE_NM, s.phi2, 3 + NODES)
    y_2 = clip(output(s.phi2, s.w2), -Y_MAX_NM, Y_MAX_NM)  # (6)
    norm_z = norm(s.w2, s.v2)
    sound = (abs(y_2) <= Y_MAX_NM) & (norm_z <= p.network.z_max)  # false for NaN
    s.inner_fault = where((x.network.network_fault < 0.5) & sound, s.inner_fault, 1.0)
    trusted = s.inner_fault < 0.5
    s.inner_faded_Nm = where(trusted, y_2, s.inner_faded_Nm * (1.0 - dt / FADE_S))
    y.inner_Nm = s.inner_faded_Nm
    y.norm_z2 = where(norm_z <= NORM_SHOWN, norm_z, NORM_SHOWN)
    added = s.inner_faded_Nm + s.integral_Nm

    rate = where(trusted, dt, 0.0)
    tune(
        ttc, gains.kappa2, gains.f2_rate, gains.fj2_rate, gains.g2_rate, rate,
        s.x2, s.a2, s.phi2, s.w2, s.v2,
    )  # fmt: skip
    free = abs(tau_d + added) < p.pd.tau_max_Nm
    grown = s.integral_Nm + where(free, dt * gains.kb_per_s * ttc, 0.0)  # (8)
    s.integral_Nm = where(trusted, grown, s.integral_Nm * (1.0 - dt / FADE_S))
    return added


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One control period; see the module header."""
    pd.errors(p.pd, u, y)
    learned = tracking_network.learned_torque(dt, y.e_rad, y.r_rad_s, p.network, x.network, u, y)
    y.fast_Nm = boundary_layer.fast(dt, p.fast, x.fast, u)
    y.tau_Nm = pd.limited(p.pd.kv_Nms_rad * y.r_rad_s + learned + y.fast_Nm, p.pd)  # (1)
    added = inner_loop(dt, y.tau_Nm, p, x, u, y)
    y.fallback = x.inner.inner_fault
    y.motor_torque_Nm = pd.motor_torque(y.tau_Nm + added, p.pd, u)  # (7) (9)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and both first layers, drawn one after the other."""
    draw = np.random.default_rng(int(settings["network_seed"])).uniform
    draw(-1.0, 1.0, (tracking_network.INPUTS, tracking_network.NODES))
    second = draw(-1.0, 1.0, (INPUTS, NODES)).ravel()
    return Prepared(settings, first_layer(settings) | {"v2": second})


BLOCK = Block(step, settings=Settings, prepare=prepare)
