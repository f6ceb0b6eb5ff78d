"""Neural backstepping: the composite law asks for a torque, an inner loop delivers it.

    tau_d = sat(w, tau_max)                                        w: pd_nn_fast.py (1)       (1)
    tt    = tau_d - tau,  ttc = clip(tt, +-2 N m)      torque error; tau: shaft torque        (2)
    tdd   = 60 (tau_d - tdf),  tdf += T tdd            wanted torque, smoothed, and its rate  (3)
    x_2   = [1, r/0.3, tt/20, tdf/20, tdd/1000, (q_d' - hull rate)/0.5]  2.. within +-3       (4)
    phi_2 = [1, s_1..s_10, j+-(q_d' - hull rate; 0.004), j+-(tdf; 3 N m)]                     (5)
    y_2   = clip(W_2'phi_2, +-8 N m),  tuned by two_layer.py with ttc, no dead band           (6)
    tau   = tau_d + y_2 + I                        from here on as tau in pd.py (5) (6)       (7)
    I    += T Kb ttc     frozen while |tau_d + y_2 + I| >= tau_max; (7) has I from before     (8)

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

from pcpc.executive.laws.approximators.two_layer import (
    first_layer,
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
from pcpc.plants.atb1000.laws.tracking_network import FADE_S, NORM_SHOWN

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


class Network(Ports):
    """The inner network."""

    w = port("N m", "W_2, its output weights", shape=PHI, adapts=True)
    v = port("", "its first layer, row by row", shape=(INPUTS, NODES), adapts=True)
    x = port("", "x_2, its inputs", shape=INPUTS)
    a = port("", "inputs of its nodes", shape=NODES)
    phi = port("", "phi_2, its hidden vector", shape=PHI)


class InnerStates(Ports):
    """Integral, smoothed torque, health and weights of the inner loop."""

    integral_Nm = port("N m", "integral of the torque error (8)", adapts=True)
    tau_smooth_Nm = port("N m", "smoothed wanted torque tdf (3)")
    inner_fault = port("", "1 once the inner network was latched off")
    inner_faded_Nm = port("N m", "y_2 last sent, fading after a fault")
    network = group(Network, "inner_", recorded=False)


class States(pd_nn_fast.States):
    """Of the composite law and of the inner loop."""

    inner = group(InnerStates)


class Inputs(pd.FlexibleInputs):
    """Those of the composite law, and the torque."""

    shaft_torque_Nm = port("N m", "measured shaft torque, tau")


class Outputs(pd_nn_fast.Outputs):
    """Those of the composite law, and of the inner loop."""

    inner_Nm = port("N m", "output of the inner network, y_2")
    norm_z2 = port("", "Frobenius norm of its weights; 1e6 if larger or not finite")


@inline
def torque_error(dt: float, tau_d: float, r: float, x: InnerStates, u: Inputs) -> float:
    """Return tt (2); smooth tau_d (3) and write x_2 (4)."""
    tt = tau_d - u.shaft_torque_Nm  # (2)
    tdd = SMOOTHING_PER_S * (tau_d - x.tau_smooth_Nm)  # (3)
    x.tau_smooth_Nm += dt * tdd
    seen = x.network.x  # (4)
    seen[0] = 1.0
    seen[1] = scaled(r, 0.3)
    seen[2] = scaled(tt, 20.0)
    seen[3] = scaled(x.tau_smooth_Nm, 20.0)
    seen[4] = scaled(tdd, 1000.0)
    seen[5] = scaled(u.q_d_rate_rad_s - u.hull_rate_rad_s, 0.5)
    return tt


@inline
def network_torque(tau_smooth: float, v_j: float, net: Network) -> float:
    """Return y_2 (6) and write phi_2 (5); `v_j` is the desired speed against the hull."""
    hidden(net.x, net.v, net.a, net.phi)  # (5)
    jump_pair(v_j, JUMP_SPEED_RAD_S, net.phi, 1 + NODES)
    jump_pair(tau_smooth, JUMP_TORQUE_NM, net.phi, 3 + NODES)
    return clip(output(net.phi, net.w), -Y_MAX_NM, Y_MAX_NM)  # (6)


@inline
def is_trusted(y_2: float, p: Parameters, x: States, y: Outputs) -> bool:
    """Latch and return whether neither network was ever unsound; write |Z_2|."""
    norm_z = norm(x.inner.network.w, x.inner.network.v)
    sound = (abs(y_2) <= Y_MAX_NM) & (norm_z <= p.network.z_max)  # false for NaN
    healthy = (x.network.network_fault < 0.5) & sound
    x.inner.inner_fault = where(healthy, x.inner.inner_fault, 1.0)
    y.norm_z2 = where(norm_z <= NORM_SHOWN, norm_z, NORM_SHOWN)
    return x.inner.inner_fault < 0.5


@inline
def inner_loop(dt: float, tau_d: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> float:
    """Return y_2 + I of (7), then tune (6) and integrate (8)."""
    gains, s = p.inner, x.inner
    tt = torque_error(dt, tau_d, y.r_rad_s, s, u)
    y_2 = network_torque(s.tau_smooth_Nm, u.q_d_rate_rad_s - u.hull_rate_rad_s, s.network)
    trusted = is_trusted(y_2, p, x, y)
    s.inner_faded_Nm = where(trusted, y_2, s.inner_faded_Nm * (1.0 - dt / FADE_S))
    y.inner_Nm, y.fallback = s.inner_faded_Nm, s.inner_fault
    added = s.inner_faded_Nm + s.integral_Nm

    ttc = clip(tt, -ERROR_MAX_NM, ERROR_MAX_NM)
    leak, rate = gains.kappa2 * abs(ttc), where(trusted, dt, 0.0)
    tune(s.network, ttc, leak, rate * gains.f2_rate, rate * gains.fj2_rate, rate * gains.g2_rate)
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
    y.motor_torque_Nm = pd.motor_torque(y.tau_Nm + added, p.pd, u)  # (7)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and both first layers, drawn one after the other."""
    outer = tracking_network.INPUTS
    drawn = first_layer(settings["network_seed"], outer + INPUTS, NODES)
    cut = outer * NODES
    return Prepared(settings, {"v": drawn[:cut], "inner_v": drawn[cut:]})


BLOCK = Block(step, settings=Settings, prepare=prepare)
