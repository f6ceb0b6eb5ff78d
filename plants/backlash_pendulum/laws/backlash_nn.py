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

from pcpc.executive.laws.approximators.two_layer import (
    first_layer,
    hidden,
    output,
    square_sum,
    square_sum_of_rows,
    tune,
)
from pcpc.executive.laws.block import Block, Ports, Prepared, inline, port, stage
from pcpc.executive.laws.emath import exp, sin, sqrt, where

N_IN, NODES = 6, 10
N_PHI = 1 + NODES


class Parameters(Ports):
    """Gains, the model, the robust term and the network."""

    lam_per_s = port("1/s", "Lam", 5.0, 0.0, 1e3)
    kv_Nms_rad = port("N m s/rad", "Kv", 10.0, 0.0, 1e4)
    kb_per_s = port("1/s", "Kb, of the torque error", 15.0, 0.0, 1e4)
    model_time_constant_s = port("s", "T_m of f", None, 1e-3, 1e6)
    model_gravity_Nm = port("N m", "G of f", None, -1e4, 1e4)
    filter_rad_s = port("rad/s", "a, of the derivative", 100.0, 0.1, 1e4)
    robust_on = port("", "1 adds the robust term", None, 0.0, 1.0)
    kz1_per_s = port("1/s", "Kz1", 2.0, 0.0, 1e3)
    kz2_Nm_rad = port("N m/rad", "Kz2", 2.0, 0.0, 1e3)
    kz3_Nm_s = port("N m/s", "Kz3", 2.0, 0.0, 1e3)
    z_bound = port("", "Z_M, added to the weight norm", 1.0, 0.0, 1e6)
    layer_Nm = port("N m", "eps_0, smallest boundary layer", 0.1, 0.0, 1e3)
    layer_ratio = port("", "rho; 1e30 for a layer of eps_0 alone", 0.15, 1e-3, 1e30)
    network_on = port("", "1 adds the network and tunes it", None, 0.0, 1.0)
    s_rate = port("", "S, tuning rate of W", 30.0, 0.0, 1e6)
    t_rate = port("", "T_V, tuning rate of V", 50.0, 0.0, 1e6)
    kappa = port("", "kappa, e-modification", 0.01, 0.0, 10.0)
    u_max_Nm = port("N m", "command at which the law is latched off", 300.0, 0.0, 1e9)


class Settings(Parameters):
    """The parameters, and what draws the first layer."""

    network_seed = port("", "draws V", 1.0, 0.0, 2.0**31)


class States(Ports):
    """The command, the filter, the latch and the network."""

    u_Nm = port("N m", "u, as far as it was integrated", adapts=True)
    z_Nm = port("N m", "z of (3)")
    started = port("", "1 after the first sample")
    latched = port("", "1 once the law was latched off")
    w = port("", "output weights W", shape=N_PHI, recorded=False, adapts=True)
    v = port(
        "", "first-layer weights V, row by row", shape=(N_IN, NODES), recorded=False, adapts=True
    )
    x = port("", "inputs of this period", shape=N_IN, recorded=False)
    a = port("", "inputs of the nodes", shape=NODES, recorded=False)
    phi = port("", "s of this period", shape=N_PHI, recorded=False)


class Inputs(Ports):
    """The reference and what the sensors say."""

    q_d_rad = port("rad", "desired angle")
    q_d_rate_rad_s = port("rad/s", "its first derivative")
    q_d_acc_rad_s2 = port("rad/s2", "its second derivative")
    q_rad = port("rad", "measured angle")
    rate_rad_s = port("rad/s", "measured rate")
    torque_Nm = port("N m", "measured torque behind the gap")


class Outputs(Ports):
    """The command and what led to it."""

    command_Nm = port("N m", "u (5), 0 once latched off")
    tau_d_Nm = port("N m", "tau_d (2)")
    e_rad = port("rad", "e1")
    r_rad_s = port("rad/s", "r")
    torque_error_Nm = port("N m", "tt (4)")
    robust_Nm_s = port("N m/s", "v2 (8)")
    network_Nm_s = port("N m/s", "y (6)")
    layer_now_Nm = port("N m", "eps (8)")
    norm_w = port("", "|W|")
    norm_v = port("", "|V|")
    diverged = port("", "1 once the law was latched off")


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and V (6, 10), drawn uniform in +-1."""
    return Prepared(settings, {"v": first_layer(settings["network_seed"], N_IN, NODES)})


@inline
def decay(x: States, of_w: float, of_v: float) -> None:
    """Divide the weights in place (10)."""
    for j in range(N_PHI):
        x.w[j] = x.w[j] / of_w
    for i in range(N_IN):
        for j in range(NODES):
            x.v[i, j] = x.v[i, j] / of_v


@inline
def desired_torque(p: Parameters, u: Inputs, y: Outputs) -> None:
    """Write e1, r (1) and tau_d (2)."""
    e2 = u.rate_rad_s - u.q_d_rate_rad_s
    y.e_rad = u.q_rad - u.q_d_rad
    y.r_rad_s = e2 + p.lam_per_s * y.e_rad
    f = -u.rate_rad_s / p.model_time_constant_s - p.model_gravity_Nm * sin(u.q_rad)
    y.tau_d_Nm = u.q_d_acc_rad_s2 - p.kv_Nms_rad * y.r_rad_s - f - p.lam_per_s * e2


@inline
def robust_term(dt: float, tt: float, norm: float, p: Parameters, y: Outputs) -> float:
    """Return v2 and write eps (8); `norm` is that of all weights."""
    zs = norm + p.z_bound  # (7)
    gain = (p.kz1_per_s * zs + p.kz2_Nm_rad) * abs(y.r_rad_s) + p.kz3_Nm_s * zs * zs
    wide = gain * dt / p.layer_ratio
    y.layer_now_Nm = where(wide > p.layer_Nm, wide, p.layer_Nm)
    size = abs(tt) + y.layer_now_Nm
    switched = where(size > 0.0, gain * tt / size, 0.0)
    return p.kz1_per_s * zs * tt + switched


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One control period; see the module header."""
    desired_torque(p, u, y)
    tau_d = y.tau_d_Nm
    tt = tau_d - u.torque_Nm  # (4)
    z = where(x.started > 0.5, x.z_Nm, tau_d)
    derivative = p.filter_rad_s * (tau_d - z)  # (3)
    x.z_Nm = z + (1.0 - exp(-p.filter_rad_s * dt)) * (tau_d - z)
    x.started = 1.0

    x.x[0], x.x[1], x.x[2] = 1.0, y.r_rad_s, u.q_d_rad  # (6)
    x.x[3], x.x[4], x.x[5] = u.q_d_rate_rad_s, tt, u.torque_Nm
    hidden(x.x, x.v, x.a, x.phi)
    network = output(x.phi, x.w)
    w2, v2 = square_sum(x.w, 0), square_sum_of_rows(x.v)
    robust = robust_term(dt, tt, sqrt(w2 + v2), p, y)
    robust = where(p.robust_on > 0.5, robust, 0.0)
    correction = robust - where(p.network_on > 0.5, network, 0.0)
    x.u_Nm = x.u_Nm + dt * (p.kb_per_s * tt + derivative + correction)  # (5)
    healthy = abs(x.u_Nm) <= p.u_max_Nm  # false for NaN
    x.latched = where(healthy, x.latched, 1.0)
    sound = x.latched < 0.5

    tuned_s = where((p.network_on > 0.5) & sound, dt, 0.0)
    tune(x, -tt, 0.0, tuned_s * p.s_rate, 0.0, tuned_s * p.t_rate)  # (9)
    leak = tuned_s * p.kappa * abs(tt)
    decay(x, 1.0 + leak * p.s_rate, 1.0 + leak * p.t_rate)

    y.command_Nm = where(sound, x.u_Nm, 0.0)
    y.torque_error_Nm, y.robust_Nm_s, y.network_Nm_s = tt, robust, network
    y.norm_w, y.norm_v = sqrt(w2), sqrt(v2)
    y.diverged = x.latched


BLOCK = Block(step, settings=Settings, prepare=prepare)
