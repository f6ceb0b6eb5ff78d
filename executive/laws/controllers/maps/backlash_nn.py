"""Backlash compensation by dynamic inversion: the torque behind the gap is made to follow.

    e1 = q - q_d, e2 = q' - q_d', r = e2 + Lam e1                          tracking error    (1)
    tau_d = -Kv r - f(q, q') + q_d'' - Lam e2,  f = -q'/T_m - G sin q      desired torque    (2)
    D = a (tau_d - z);  z += (1 - exp(-a T)) (tau_d - z)                   its derivative    (3)
    tt = tau_d - tau                                                       torque error      (4)
    phi = Kb tt + D + v2 - y,  u += T phi                                  command           (5)

The nominal inverse of a gap that is driven by u is u' = phi. The network learns what this leaves:

    x = [1, r, q_d, q_d', tt, tau],  s = [1; sigma(V'x)],  y = W's         two_layer.py      (6)
    Zs = sqrt(|W|^2 + |V|^2) + Z_M,  A = (Kz1 Zs + Kz2) |r| + Kz3 Zs^2                       (7)
    v2 = Kz1 Zs tt + A tt/(|tt| + eps),  eps = max(eps_0, A T/rho)         robust term       (8)
    W_0' = -S tt,  W_j' = -S (s_j - s_j' a_j) tt,  V' = -T_V x tt (s' W)'                    (9)
    W /= 1 + T kappa S |tt|,  V /= 1 + T kappa T_V |tt|                    after (9)        (10)

r' = -Kv r - tt and tt' = -Kb tt - v2 + y - B, where tau' = phi + B: so y estimates B and
L = (r^2 + tt^2 + |W~|^2/S + |V~|^2/T_V)/2 gives the signs of (5) and (9). (9) is Euler with the old
W and V, (10) the implicit decay of e-modification: explicit, it could overshoot through zero.

The layer eps of (8) follows A T: the gain of the sampled loop is then at most rho, however large
the weights are. A sign function in its place chatters at any real rate, and the chatter makes W
grow. `robust_on`, `network_on` 0, 0: inversion with PD alone; 1, 0: with (8); 1, 1: the whole law.
V is drawn uniform in +-1 from `network_seed`, W = 0; without the network both stay.

Beyond |u| = u_max the law is latched off and sends 0: `diverged`. u is not limited otherwise.
rad, rad/s, N m, s, for inertia 1 kg m^2. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 5.2;
filter (3), layer (8) and implicit decay (10) are chosen. Defaults: Lam, Kv, Kb, Kz1, Kz2, Kz3, S,
T_V and kappa are the book's; a, Z_M, eps_0, rho and u_max are chosen.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.approximators.two_layer import hidden, output, square_sum, tune
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.emath import exp, sin, sqrt, where

N_IN, NODES = 6, 10
N_PHI = 1 + NODES

PARAMETERS = (
    Port("lam_per_s", "1/s", "Lam", 5.0, 0.0, 1e3),
    Port("kv_Nms_rad", "N m s/rad", "Kv", 10.0, 0.0, 1e4),
    Port("kb_per_s", "1/s", "Kb, of the torque error", 15.0, 0.0, 1e4),
    Port("model_time_constant_s", "s", "T_m of f", None, 1e-3, 1e6),
    Port("model_gravity_Nm", "N m", "G of f", None, -1e4, 1e4),
    Port("filter_rad_s", "rad/s", "a, of the derivative", 100.0, 0.1, 1e4),
    Port("robust_on", "", "1 adds the robust term", None, 0.0, 1.0),
    Port("kz1_per_s", "1/s", "Kz1", 2.0, 0.0, 1e3),
    Port("kz2_Nm_rad", "N m/rad", "Kz2", 2.0, 0.0, 1e3),
    Port("kz3_Nm_s", "N m/s", "Kz3", 2.0, 0.0, 1e3),
    Port("z_bound", "", "Z_M, added to the weight norm", 1.0, 0.0, 1e6),
    Port("layer_Nm", "N m", "eps_0, smallest boundary layer", 0.1, 0.0, 1e3),
    Port("layer_ratio", "", "rho; 1e30 for a layer of eps_0 alone", 0.15, 1e-3, 1e30),
    Port("network_on", "", "1 adds the network and tunes it", None, 0.0, 1.0),
    Port("s_rate", "", "S, tuning rate of W", 30.0, 0.0, 1e6),
    Port("t_rate", "", "T_V, tuning rate of V", 50.0, 0.0, 1e6),
    Port("kappa", "", "kappa, e-modification", 0.01, 0.0, 10.0),
    Port("u_max_Nm", "N m", "command at which the law is latched off", 300.0, 0.0, 1e9),
)
(
    LAM, KV, KB, T_M, G, FILTER, ROBUST_ON, KZ1, KZ2, KZ3, Z_BOUND, LAYER, RATIO,
    NETWORK_ON, S_RATE, T_RATE, KAPPA, U_MAX,
) = range(len(PARAMETERS))  # fmt: skip
SETTINGS = (*PARAMETERS, Port("network_seed", "", "draws V", 1.0, 0.0, 2.0**31))

STATES = (
    Port("u_Nm", "N m", "u, as far as it was integrated"),
    Port("z_Nm", "N m", "z of (3)"),
    Port("started", "", "1 after the first sample"),
    Port("latched", "", "1 once the law was latched off"),
    Port("w", "", "output weights W", size=N_PHI, recorded=False),
    Port("v", "", "first-layer weights V, row by row", size=N_IN * NODES, recorded=False),
    Port("scratch", "", "x, a, s of this period", size=N_IN + NODES + N_PHI, recorded=False),
)
U, Z, STARTED, LATCHED, W = range(5)
V = W + N_PHI
X = V + N_IN * NODES
A, PHI = X + N_IN, X + N_IN + NODES

INPUTS = (
    Port("q_d_rad", "rad", "desired angle"),
    Port("q_d_rate_rad_s", "rad/s", "its first derivative"),
    Port("q_d_acc_rad_s2", "rad/s2", "its second derivative"),
    Port("angle_rad", "rad", "measured angle"),
    Port("rate_rad_s", "rad/s", "measured rate"),
    Port("torque_Nm", "N m", "measured torque behind the gap"),
)
OUTPUTS = (
    Port("command_Nm", "N m", "u (5), 0 once latched off"),
    Port("tau_d_Nm", "N m", "tau_d (2)"),
    Port("e_rad", "rad", "e1"),
    Port("r_rad_s", "rad/s", "r"),
    Port("torque_error_Nm", "N m", "tt (4)"),
    Port("robust_Nm_s", "N m/s", "v2 (8)"),
    Port("network_Nm_s", "N m/s", "y (6)"),
    Port("layer_now_Nm", "N m", "eps (8)"),
    Port("norm_w", "", "|W|"),
    Port("norm_v", "", "|V|"),
    Port("diverged", "", "1 once the law was latched off"),
)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and V (6, 10), drawn uniform in +-1."""
    draw = np.random.default_rng(int(settings["network_seed"])).uniform
    return Prepared(settings, {"v": draw(-1.0, 1.0, (N_IN, NODES)).ravel().tolist()})


@inline
def divide(w: Any, n: int, by: float) -> None:
    """Divide w[0..n-1] in place: the decay (10)."""
    for j in range(n):
        w[j] = w[j] / by


@inline
def desired_torque(u: Any, p: Any) -> tuple[float, float, float]:
    """Return e1, r (1) and tau_d (2); `u`, `p` begin with this file's ports."""
    e1, e2 = u[3] - u[0], u[4] - u[1]
    r = e2 + p[LAM] * e1
    f = -u[4] / p[T_M] - p[G] * sin(u[3])
    return e1, r, u[2] - p[KV] * r - f - p[LAM] * e2


@inline
def robust_term(dt: float, r: float, tt: float, norm: float, p: Any) -> tuple[float, float]:
    """Return v2 and eps of (8); `norm` is that of all weights."""
    zs = norm + p[Z_BOUND]  # (7)
    gain = (p[KZ1] * zs + p[KZ2]) * abs(r) + p[KZ3] * zs * zs
    wide = gain * dt / p[RATIO]
    layer = where(wide > p[LAYER], wide, p[LAYER])
    size = abs(tt) + layer
    switched = where(size > 0.0, gain * tt / size, 0.0)
    return p[KZ1] * zs * tt + switched, layer


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    w, v = tail(x, W), tail(x, V)
    xi, a, phi = tail(x, X), tail(x, A), tail(x, PHI)
    e1, r, tau_d = desired_torque(u, p)
    tt = tau_d - u[5]  # (4)
    z = where(x[STARTED] > 0.5, x[Z], tau_d)
    derivative = p[FILTER] * (tau_d - z)  # (3)
    x[Z] = z + (1.0 - exp(-p[FILTER] * dt)) * (tau_d - z)
    x[STARTED] = 1.0

    xi[0], xi[1], xi[2], xi[3], xi[4], xi[5] = 1.0, r, u[0], u[1], tt, u[5]  # (6)
    hidden(xi, N_IN, NODES, v, a, phi)
    network = output(phi, w, N_PHI)
    w2, v2 = square_sum(w, N_PHI), square_sum(v, N_IN * NODES)
    robust, layer = robust_term(dt, r, tt, sqrt(w2 + v2), p)
    robust = where(p[ROBUST_ON] > 0.5, robust, 0.0)
    correction = robust - where(p[NETWORK_ON] > 0.5, network, 0.0)
    x[U] = x[U] + dt * (p[KB] * tt + derivative + correction)  # (5)
    healthy = abs(x[U]) <= p[U_MAX]  # false for NaN
    x[LATCHED] = where(healthy, x[LATCHED], 1.0)
    sound = x[LATCHED] < 0.5

    tuned_s = where((p[NETWORK_ON] > 0.5) & sound, dt, 0.0)
    tune(-tt, 0.0, p[S_RATE], 0.0, p[T_RATE], tuned_s, xi, N_IN, NODES, 0, a, phi, w, v)  # (9)
    leak = tuned_s * p[KAPPA] * abs(tt)
    divide(w, N_PHI, 1.0 + leak * p[S_RATE])  # (10)
    divide(v, N_IN * NODES, 1.0 + leak * p[T_RATE])

    y[0] = where(sound, x[U], 0.0)
    y[1], y[2], y[3], y[4] = tau_d, e1, r, tt
    y[5] = robust
    y[6], y[7], y[8], y[9] = network, layer, sqrt(w2), sqrt(v2)
    y[10] = x[LATCHED]


BLOCK = Block(
    step,
    inputs=INPUTS,
    outputs=OUTPUTS,
    settings=SETTINGS,
    parameters=PARAMETERS,
    states=STATES,
    prepare=prepare,
)
