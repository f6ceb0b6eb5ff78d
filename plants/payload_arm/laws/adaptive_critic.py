"""Adaptive critic for the two-link arm: a critic network tunes the action network beside itself.

    e, r and Mhat as in `arm_pd_inertia.py`, Kv and Lam scalars
    s1 = sigma(V1'r),  D1 = diag(s1 (1 - s1))            critic, 10 nodes, no bias           (1)
    R  = W1's1 + rho                                     critic signal                       (2)
    sc = r + V1 D1 W1 R                                  performance and critic              (3)
    s2 = sigma(V2'[1; e; e'; q_d; q_d'; q_d''])          action, 10 nodes                    (4)
    ghat = W2's2                                                                             (5)
    v  = -kz sc/(|sc| + delta)                           robust term                         (6)
    tau = Mhat(q) (ghat + Kv r - v)                                                          (7)

    dW1  = -s1 R' - kap1 W1                                                                  (8)
    drho = W1'D1 V1'Kv r + alpha W1's1 + beta r                                              (9)
    dW2  = Gam (s2 sc' - kap2 W2)                                                           (10)

V1 (2, 10), then V2 (11, 10) are drawn uniform in +-1 and stay; W1, W2 (10, 2) and rho start at 0.
All right sides use the old values. `critic_on` 0 leaves sc = r, `action_on` 0 leaves ghat = 0.
Without beta r, which is this project's, R stays 0 for ever. With V2 = 0 (10) is a leaky integrator,
ghat' = Gam (2.5 sc - kap2 ghat). Weights rest in a cycle without new measurements. The vector in
(4) is that of `network_inputs.py`.

With M = Mhat and f of `arm_pd_inertia.py` written as W2*'s2 + eps, r' = f - d - u and alpha = kap1,
~ for ideal less current and L = (|r|^2 + |R|^2 + |W1~|^2 + |W2~|^2/Gam)/2:

    L' = -Kv |r|^2 + beta R'r - |s1|^2 |R|^2 + R'W1~'s1 + kap1 tr(W1~'W1) + kap2 tr(W2~'W2)
         + sc'(eps - d + v)                                                                 (11)

so errors are uniformly ultimately bounded for kz >= |eps| + |d| and
beta^2 < 4 Kv |s1|^2 (1 - 1/(4 kap1)). A payload violates M = Mhat. rad, rad/s, N m; positive
torque raises q. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 7.
"""

from collections.abc import Mapping

from pcpc.executive.laws.approximators.two_layer import (
    first_layer,
    nodes,
    square_sum,
    square_sum_of_rows,
)
from pcpc.executive.laws.block import (
    Array,
    Block,
    Ports,
    Prepared,
    flat,
    group,
    inline,
    port,
    stage,
)
from pcpc.executive.laws.emath import sqrt
from pcpc.plants.families.two_link.laws import arm_pd, arm_pd_inertia, network_inputs
from pcpc.plants.families.two_link.laws.arm_pd import JOINTS
from pcpc.plants.families.two_link.laws.network_inputs import Inputs, Vector

INPUTS, NODES = Vector.size, 10


class Parameters(arm_pd_inertia.Gains):
    """Those of the PD law, of both networks and of the robust term."""

    action_on = port("", "0 switches the action network off", 1.0, 0.0, 1.0)
    critic_on = port("", "0 switches the critic off", 1.0, 0.0, 1.0)
    gam = port("", "Gam, tuning rate of W2", None, 0.0, 1e5)
    kap1 = port("", "leak of W1", None, 0.0, 1e3)
    kap2 = port("", "leak of W2, times Gam", None, 0.0, 1e3)
    alpha = port("", "of (9); the proof wants kap1", None, 0.0, 1e3)
    beta = port("", "drives the critic", None, 0.0, 1e3)
    kz = port("", "robust term; 0 leaves it out", None, 0.0, 1e4)
    delta_rad_s = port("rad/s", "smooths its unit vector", None, 1e-6, 1e3)


class Settings(Parameters):
    """The parameters, and what draws the first layers."""

    network_seed = port("", "draws V1 and V2", 7.0, 0.0, 2.0**31)
    v2_size = port("", "half width of V2's draw; 0: ghat only integrates", 1.0, 0.0, 10.0)


class States(Ports):
    """The weights, and the vectors of this period."""

    v1 = port("", "V1 (2, 10)", shape=(JOINTS, NODES), recorded=False)
    v2 = port("", "V2 (11, 10)", shape=(INPUTS, NODES), recorded=False)
    w1 = port("", "W1 (10, 2)", shape=(NODES, JOINTS), recorded=False, adapts=True)
    w2 = port("", "W2 (10, 2)", shape=(NODES, JOINTS), recorded=False, adapts=True)
    rho = port("", "rho", shape=JOINTS, recorded=False)
    z1 = port("", "V1'r", shape=NODES, recorded=False)
    s1 = port("", "nodes of the critic (1)", shape=NODES, recorded=False)
    x = group(Vector, "x_", recorded=False)  # of (4)
    s2 = port("", "nodes of the action network (4)", shape=NODES, recorded=False)
    sc = port("", "sc (3)", shape=JOINTS, recorded=False)


class Outputs(arm_pd.Outputs):
    """Those of the PD law, and what both networks and the robust term add."""

    learned_rad_s2 = port("rad/s2", "ghat (5) of joint #", shape=2, named="learned_#_rad_s2")
    robust_rad_s2 = port("rad/s2", "-v (6) of joint #", shape=2, named="robust_#_rad_s2")
    critic = port("", "R (2) of joint #", shape=2, named="critic_#")
    norm_w1 = port("", "Frobenius norm of W1")
    norm_w2 = port("", "Frobenius norm of W2")
    norm_rho = port("", "|rho|")


@inline
def read_out(w: Array, s: Array, i: int) -> float:
    """Return entry i of W's; `w` (10, 2), `s` (10,)."""
    total = 0.0
    for j in range(NODES):
        total += w[j, i] * s[j]
    return total


@inline
def criticise(p: Parameters, x: States, y: Outputs) -> None:
    """Write s1 (1), R (2) and sc (3)."""
    nodes(y.r_rad_s, x.v1, NODES, x.z1, x.s1, 0)  # (1)
    for i in range(JOINTS):
        y.critic[i] = 0.0
        if p.critic_on > 0.5:
            y.critic[i] = read_out(x.w1, x.s1, i) + x.rho[i]  # (2)
        x.sc[i] = y.r_rad_s[i]
    for j in range(NODES):
        back = x.w1[j, 0] * y.critic[0] + x.w1[j, 1] * y.critic[1]
        back = x.s1[j] * (1.0 - x.s1[j]) * back
        for i in range(JOINTS):
            x.sc[i] += x.v1[i, j] * back  # (3)


@inline
def act(p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Write ghat (4) (5) and -v (6)."""
    network_inputs.observe(u, x.x)
    nodes(flat(x.x), x.v2, NODES, x.s2, x.s2, 0)  # (4)
    size = sqrt(square_sum(x.sc, 0)) + p.delta_rad_s
    for i in range(JOINTS):
        y.learned_rad_s2[i] = 0.0
        if p.action_on > 0.5:
            y.learned_rad_s2[i] = read_out(x.w2, x.s2, i)  # (5)
        y.robust_rad_s2[i] = p.kz * x.sc[i] / size  # (6)


@inline
def wanted_acceleration(i: int, p: Parameters, y: Outputs) -> float:
    """Return the acceleration that (7) wants of joint i, rad/s2."""
    return y.learned_rad_s2[i] + p.kv_per_s * y.r_rad_s[i] + y.robust_rad_s2[i]


@inline
def tune_critic(dt: float, p: Parameters, x: States, y: Outputs) -> None:
    """One Euler step of (9), then of (8), which does not use rho."""
    for i in range(JOINTS):
        rate = p.beta * y.r_rad_s[i]
        for j in range(NODES):
            slope = x.s1[j] * (1.0 - x.s1[j])
            rate += x.w1[j, i] * (slope * p.kv_per_s * x.z1[j] + p.alpha * x.s1[j])
        x.rho[i] += dt * rate  # (9)
    for j in range(NODES):
        for i in range(JOINTS):
            x.w1[j, i] += dt * (-x.s1[j] * y.critic[i] - p.kap1 * x.w1[j, i])  # (8)


@inline
def tune_action(dt: float, p: Parameters, x: States) -> None:
    """One Euler step of (10)."""
    for j in range(NODES):
        for i in range(JOINTS):
            x.w2[j, i] += dt * p.gam * (x.s2[j] * x.sc[i] - p.kap2 * x.w2[j, i])


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One control period; see the module header."""
    arm_pd_inertia.errors(p, u, y)
    criticise(p, x, y)
    act(p, x, u, y)
    a_1, a_2 = wanted_acceleration(0, p, y), wanted_acceleration(1, p, y)
    arm_pd_inertia.torques(p, u.q_rad, a_1, a_2, y.torque_Nm)  # (7)
    y.norm_w1 = sqrt(square_sum_of_rows(x.w1))
    y.norm_w2 = sqrt(square_sum_of_rows(x.w2))
    y.norm_rho = sqrt(square_sum(x.rho, 0))

    rate = network_inputs.tuned_s(dt, u)
    if p.critic_on > 0.5:
        tune_critic(rate, p, x, y)
    if p.action_on > 0.5:
        tune_action(rate, p, x)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given, and V1, then V2, uniform in +-1, drawn row by row."""
    drawn = first_layer(settings["network_seed"], JOINTS + INPUTS, NODES)
    cut = JOINTS * NODES
    v2 = [settings["v2_size"] * entry for entry in drawn[cut:]]
    return Prepared(settings, {"v1": drawn[:cut], "v2": v2})


BLOCK = Block(step, settings=Settings, prepare=prepare)
