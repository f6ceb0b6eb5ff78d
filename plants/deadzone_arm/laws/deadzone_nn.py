"""Two neural networks a joint that undo an unknown deadzone in front of the two-link arm.

    e = q_d - q,  e' = q_d' - v,  r = e' + Lam e                                             (1)
    f = M(q)(q_d'' + Lam e') + Vm(q, v)(q_d' + Lam e)        the arm's model                 (2)
    w = f + Kv r                                             all that PD sends               (3)
    s   = [s_1..s_L, p0, p1],  s_j = sgm(Vi_j w + v0i_j)                                     (4)
    p0  = 1 for w >= 0 else 0,  p1 = 1 - exp(-w) for w >= 0 else 0        jump nodes         (5)
    y   = Wi's,  u = clip(w + y, u_max)                      network II, the compensator     (6)
    tau^ = sum_j W_j sgm(V_j u + v0_j)                       network I, the deadzone as seen (7)
    b_j = sgm'(V_j u + v0_j) V_j,  J = W'b                   its slope, u before the clip    (8)

(4) to (8) stand once for each joint i = 1, 2. Tuning, |r| and |Wi| over both joints:

    Wi' =  T s r_i J   - k1 T |r| Wi - k2 T |r| |Wi| Wi                                      (9)
    W'  = -S b y_i r_i - k1 S |r| W                                                         (10)
    gradient terms by an Euler step, decay by 1/(1 + dt ...); all from the old W, Wi, y     (11)

Signs follow from L = r'M r/2 + tr(W~'W~)/2S + tr(Wi~'Wi~)/2T, whose cross terms they cancel. tau^
itself is not needed: only its slope and its gradient enter. The torque is not measured.

Start: for joint 1, then 2: V and v0, W, then Vi and v0i; |V| uniform in 0..1 with random signs, v0
in +-35, W in +-50; Wi = 0. With `positive_slope` 1, W takes the signs of V: the slope (8) then
begins non-negative at every u, as a deadzone's is. V and v0 stay as drawn.

Guard: as soon as |r| or the norm of all tuned weights is no finite number within its limit, both
commands are 0 and tuning ends, for good. rad, rad/s, N m; positive torque raises q.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.2; signs and (11) are derived.
"""

from collections.abc import Mapping

import numpy as np

from pcpc.executive.laws.approximators.two_layer import square_sum_of_rows
from pcpc.executive.laws.block import Block, Ports, Prepared, group, inline, port, stage
from pcpc.executive.laws.emath import clip, exp, logistic, sincos, sqrt, where
from pcpc.plants.families.two_link.equations import inertia

JOINTS, MOST_NODES, JUMPS = 2, 40, 2
COLUMN = MOST_NODES + JUMPS  # room of a joint's output weights


def _joint(number: int) -> type[Ports]:
    """Return the declaration of what is wanted and measured of one joint."""

    class Joint(Ports):
        q_d_rad = port("rad", f"desired angle of joint {number}", named=f"q_d_{number}_rad")
        q_d_rate_rad_s = port(
            "rad/s", f"desired rate of joint {number}", named=f"q_d_rate_{number}_rad_s"
        )
        q_d_acc_rad_s2 = port(
            "rad/s2", f"desired acceleration of joint {number}", named=f"q_d_acc_{number}_rad_s2"
        )
        q_rad = port("rad", f"measured angle of joint {number}", named=f"q_{number}_rad")
        rate_rad_s = port("rad/s", f"measured rate of joint {number}", named=f"rate_{number}_rad_s")

    return Joint


class Inputs(Ports):
    """The reference and the measured motion, a joint after the other."""

    joint_1 = group(_joint(1))
    joint_2 = group(_joint(2))


class Outputs(Ports):
    """The commands and what led to them."""

    torque_Nm = port("N m", "command of joint # (6)", shape=JOINTS, named="torque_#_Nm")
    tau_d_Nm = port("N m", "wanted torque of joint # (3)", shape=JOINTS, named="tau_d_#_Nm")
    e_rad = port("rad", "error of joint # as measured", shape=JOINTS, named="e_#_rad")
    r_rad_s = port("rad/s", "filtered error of joint # (1)", shape=JOINTS, named="r_#_rad_s")
    diverged = port("", "1 once the guard has ended the control")


class NetworkOutputs(Outputs):
    """Those of PD, and the networks'."""

    y_Nm = port("N m", "compensator's output of joint # (6)", shape=JOINTS, named="y_#_Nm")
    slope = port("", "slope of the deadzone as seen by joint # (8)", shape=JOINTS, named="slope_#")
    norm_wi = port("", "Frobenius norm of Wi, both joints")
    norm_w = port("", "Frobenius norm of W, both joints")


class Gains(Ports):
    """Of PD with the arm's model."""

    kv_Nms_rad = port("N m s/rad", "gain on the filtered error", None, 0.0, 1e4)
    lam_per_s = port("1/s", "slope of the filtered error", None, 0.0, 1e3)
    u_max_Nm = port("N m", "limit of the commands", None, 0.0, 1e4)
    a1_m = port("m", "length of the first link, as known", None, 1e-3, 100.0)
    a2_m = port("m", "length of the second link, as known", None, 1e-3, 100.0)
    m1_kg = port("kg", "mass at the end of the first link, as known", None, 1e-3, 1e4)
    m2_kg = port("kg", "mass at the end of the second link, as known", None, 1e-3, 1e4)
    r_max_rad_s = port("rad/s", "|r| at which control ends", None, 0.0, 1e6)


class Parameters(Gains):
    """Those of PD, and the networks'."""

    network_on = port("", "1 engages both networks, 0 leaves (3) alone", 1.0, 0.0, 1.0)
    t_rate = port("", "T, tuning rate of the compensator", None, 0.0, 1e5)
    s_rate = port("", "S, tuning rate of network I; 0 freezes it", None, 0.0, 1e5)
    k1 = port("", "decay of both networks", None, 0.0, 10.0)
    k2 = port("", "further decay of the compensator", None, 0.0, 10.0)
    jumps_on = port("", "1 gives the compensator its jump nodes", 1.0, 0.0, 1.0)
    nodes = port("", "L, logistic nodes of each network", 20.0, 1.0, MOST_NODES)
    norm_max = port("", "norm of W and Wi at which control ends", None, 0.0, 1e9)


class Settings(Parameters):
    """The parameters, and what draws the networks."""

    network_seed = port("", "draws the networks", None, 0.0, 2.0**31)
    positive_slope = port("", "1 gives W the signs of V at the start", 1.0, 0.0, 1.0)


class Guard(Ports):
    """The guard."""

    latched = port("", "1 once the guard has ended the control")


class States(Guard):
    """The guard, the networks with a row for each joint, and the vectors of this period."""

    w = port("N m", "W", shape=(JOINTS, MOST_NODES), recorded=False, adapts=True)
    v = port("1/(N m)", "V", shape=(JOINTS, MOST_NODES), recorded=False)
    v0 = port("", "v0", shape=(JOINTS, MOST_NODES), recorded=False)
    vi = port("1/(N m)", "Vi", shape=(JOINTS, MOST_NODES), recorded=False)
    v0i = port("", "v0i", shape=(JOINTS, MOST_NODES), recorded=False)
    wi = port("N m", "Wi, jumps last", shape=(JOINTS, COLUMN), recorded=False, adapts=True)
    b = port("1/(N m)", "b of (8)", shape=(JOINTS, MOST_NODES), recorded=False)
    s = port("", "s of (4), alike", shape=(JOINTS, COLUMN), recorded=False)


@inline
def errors(i: int, lam: float, joint: Ports, y: Outputs) -> tuple[float, float]:
    """Write e and r (1) of joint i, whose inputs are `joint`; return what (2) multiplies.

    That is q_d'' + Lam e' and q_d' + Lam e.
    """
    e, e_rate = joint.q_d_rad - joint.q_rad, joint.q_d_rate_rad_s - joint.rate_rad_s
    y.e_rad[i] = e
    y.r_rad_s[i] = e_rate + lam * e
    return joint.q_d_acc_rad_s2 + lam * e_rate, joint.q_d_rate_rad_s + lam * e


@inline
def follow(p: Gains, u: Inputs, y: Outputs) -> float:
    """Write w (3), e and r (1) of both joints; return |r|, rad/s."""
    acc_1, rate_1 = errors(0, p.lam_per_s, u.joint_1, y)
    acc_2, rate_2 = errors(1, p.lam_per_s, u.joint_2, y)
    v_1, v_2 = u.joint_1.rate_rad_s, u.joint_2.rate_rad_s
    sine, cosine = sincos(u.joint_2.q_rad)
    m11, m12, m22 = inertia(cosine, p.a1_m, p.a2_m, p.m1_kg, p.m2_kg)
    h = p.m2_kg * p.a1_m * p.a2_m * sine
    c_1 = -h * v_2 * rate_1 - h * (v_1 + v_2) * rate_2
    f_1 = m11 * acc_1 + m12 * acc_2 + c_1  # (2)
    f_2 = m12 * acc_1 + m22 * acc_2 + h * v_1 * rate_1
    r_1, r_2 = y.r_rad_s[0], y.r_rad_s[1]
    y.tau_d_Nm[0], y.tau_d_Nm[1] = f_1 + p.kv_Nms_rad * r_1, f_2 + p.kv_Nms_rad * r_2  # (3)
    return sqrt(r_1 * r_1 + r_2 * r_2)


@inline
def latch_guard(healthy: bool, x: Guard, y: Outputs) -> bool:
    """Latch the end of control; return whether it still goes on."""
    x.latched = where(healthy, x.latched, 1.0)
    y.diverged = x.latched
    return bool(x.latched < 0.5)


@inline
def compensator(i: int, w: float, p: Parameters, x: States) -> float:
    """Write s (4) (5) of joint i and return y (6), N m."""
    s, wi = x.s[i], x.wi[i]
    total = 0.0
    for j in range(int(p.nodes)):
        s[j] = logistic(x.vi[i, j] * w + x.v0i[i, j])  # (4)
        total += wi[j] * s[j]
    right = where(w >= 0.0, p.jumps_on, 0.0)
    s[MOST_NODES] = right  # (5)
    s[MOST_NODES + 1] = right * (1.0 - exp(-abs(w)))
    return total + wi[MOST_NODES] * s[MOST_NODES] + wi[MOST_NODES + 1] * s[MOST_NODES + 1]


@inline
def slope(i: int, u: float, p: Parameters, x: States) -> float:
    """Write b (8) of joint i and return J; `u` in N m, before the clip."""
    v, b = x.v[i], x.b[i]
    total = 0.0
    for j in range(int(p.nodes)):
        z = logistic(v[j] * u + x.v0[i, j])
        b[j] = z * (1.0 - z) * v[j]
        total += x.w[i, j] * b[j]
    return total


@inline
def tune(i: int, dt: float, norm_r: float, p: Parameters, x: States, y: NetworkOutputs) -> None:
    """One step (11) of both networks of joint i."""
    r = y.r_rad_s[i]
    fall = 1.0 + dt * p.t_rate * (p.k1 * norm_r + p.k2 * norm_r * y.norm_wi)
    rise = dt * p.t_rate * r * y.slope[i]
    for j in range(COLUMN):
        x.wi[i, j] = (x.wi[i, j] + rise * x.s[i, j]) / fall  # (9)
    fall = 1.0 + dt * p.s_rate * p.k1 * norm_r
    rise = dt * p.s_rate * y.y_Nm[i] * r
    for j in range(int(p.nodes)):
        x.w[i, j] = (x.w[i, j] - rise * x.b[i, j]) / fall  # (10)


@stage
def pd_step(t: float, dt: float, p: Gains, x: Guard, u: Inputs, y: Outputs) -> None:
    """One control period of (1) to (3) alone."""
    good = latch_guard(follow(p, u, y) <= p.r_max_rad_s, x, y)  # false for NaN
    for i in range(JOINTS):
        y.torque_Nm[i] = where(good, clip(y.tau_d_Nm[i], -p.u_max_Nm, p.u_max_Nm), 0.0)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: NetworkOutputs) -> None:
    """One control period; see the module header."""
    norm_r = follow(p, u, y)
    y.norm_wi = sqrt(square_sum_of_rows(x.wi))
    y.norm_w = sqrt(square_sum_of_rows(x.w))
    weights = sqrt(y.norm_wi * y.norm_wi + y.norm_w * y.norm_w)
    good = latch_guard((norm_r <= p.r_max_rad_s) & (weights <= p.norm_max), x, y)  # false for NaN
    engaged = p.network_on > 0.5
    tuned_s = where(good & engaged, dt, 0.0)
    for i in range(JOINTS):
        y.y_Nm[i] = where(engaged, compensator(i, y.tau_d_Nm[i], p, x), 0.0)
        u_i = y.tau_d_Nm[i] + y.y_Nm[i]
        y.torque_Nm[i] = where(good, clip(u_i, -p.u_max_Nm, p.u_max_Nm), 0.0)  # (6)
        y.slope[i] = slope(i, u_i, p, x)
        tune(i, tuned_s, norm_r, p, x, y)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and the networks as drawn from `network_seed`.

    Raises ValueError for a number of nodes that is not whole.
    """
    n = int(settings["nodes"])
    if n != settings["nodes"]:
        raise ValueError(f"nodes is {settings['nodes']:g}; expected a whole number")
    draw = np.random.default_rng(int(settings["network_seed"]))
    drawn = {name: np.zeros((JOINTS, MOST_NODES)) for name in ("v", "v0", "w", "vi", "v0i")}
    for i in range(JOINTS):
        for first, bias in (("v", "v0"), ("vi", "v0i")):
            size = draw.uniform(0.0, 1.0, n)
            drawn[first][i, :n] = size * np.where(draw.random(n) < 0.5, -1.0, 1.0)
            drawn[bias][i, :n] = draw.uniform(-35.0, 35.0, n)
            if first == "v":
                drawn["w"][i, :n] = draw.uniform(-50.0, 50.0, n)
    if settings["positive_slope"] > 0.5:
        drawn["w"] = np.abs(drawn["w"]) * np.sign(drawn["v"])
    return Prepared(settings, {name: values.ravel().tolist() for name, values in drawn.items()})


PD = Block(pd_step)
BLOCK = Block(step, settings=Settings, prepare=prepare)
