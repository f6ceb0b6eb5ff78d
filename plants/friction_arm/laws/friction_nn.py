"""PD law of `arm_pd.py` with the augmented network of `augmented.py`, which learns the friction.

    x    = [1, e1, e2, e1', e2', q_d1, q_d2, q_d1', q_d2', q_d1'', q_d2'']                   (1)
    phi  = [phi_0(q1'), phi_1(q1'), phi_0(q2'), phi_1(q2')],  q' = q_d' - e',
           phi_0 and phi_1 as (4) of augmented.py                                            (2)
    fhat = W1's(V'x) + W2'phi                                                                (3)
    tau  = Kv r + fhat + Kz (|Z| + Z_B) r,  Z = blkdiag(W1, W2, V)                           (4)
    tuning (6) to (8) of augmented.py, driven by r, after (4) with the weights of (4)        (5)

(1) to (3) learn f of M r' = -Vm r - tau + f(x), f = M (q_d'' + Lam e') + Vm (q_d' + Lam e) + G + F;
the last term of (4) adds damping. With W1 = W2 = 0 and V uniform in +-1 at the start and Kz large
enough all errors are uniformly ultimately bounded:
L = r'M r/2 + tr(W1~'S^-1 W1~)/2 + tr(V~'T^-1 V~)/2 + tr(W2~'E^-1 W2~)/2.

`jump_nodes` selects phi:  0 standard  none
                           1 step      steps at zero velocity, as in the book
                           2 ramp      phi_0 rises over +-v_eps, which does not chatter
                           3 project   step, own-joint weights of phi_0 kept >= 0
                           4 const     phi = [1, 0, 1, 0]: the same gain without a jump      (6)

`network_inputs.py` has (1). Weights rest in a cycle without new measurements. `tuning_gain_Nms_rad`
is dt G of augmented.py: the loop through the tuning is stable while it stays below Kv, and wants
half of it. rad, rad/s, N m; positive torque raises q. Source: Lewis, Campos, Selmic (SIAM 2002),
chapter 3; 2 to 4 of (6) are this project's.
"""

from collections.abc import Mapping

import numpy as np

from pcpc.executive.laws.approximators.augmented import (
    hidden,
    norm,
    output,
    ramp,
    step_pair,
    tune,
    tuning_gain,
)
from pcpc.executive.laws.approximators.two_layer import first_layer, square_sum
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
from pcpc.executive.laws.emath import sqrt, where
from pcpc.plants.families.two_link.laws import arm_pd, network_inputs
from pcpc.plants.families.two_link.laws.arm_pd import JOINTS
from pcpc.plants.families.two_link.laws.network_inputs import Inputs, Vector

INPUTS, NODES_MAX, JUMPS = Vector.size, 16, 2 * JOINTS
STANDARD, STEP, RAMP, PROJECT, CONST = 0.0, 1.0, 2.0, 3.0, 4.0


class Parameters(arm_pd.Gains):
    """Those of the PD law, the robust term and the network's."""

    kz = port("", "Kz, robust term", None, 0.0, 100.0)
    z_bound = port("", "Z_B, bound of the ideal weights", None, 0.0, 1e6)
    s_rate = port("", "S, tuning rate of W1", None, 0.0, 1e4)
    t_rate = port("", "T, tuning rate of V", None, 0.0, 1e4)
    e_rate = port("", "E, tuning rate of W2", None, 0.0, 1e4)
    kappa = port("", "e-modification", None, 0.0, 10.0)
    v_eps_rad_s = port("rad/s", "half width of the ramp", 0.01, 1e-6, 10.0)
    jump_nodes = port("", "0 none, 1 step, 2 ramp, 3 project, 4 const", None, 0.0, 4.0)
    nodes = port("", "hidden nodes L, whole", 10.0, 1.0, float(NODES_MAX))


class Settings(Parameters):
    """The parameters, and what draws the first layer."""

    network_seed = port("", "draws V", 1.0, 0.0, 2.0**31)


class States(Ports):
    """The network: weights, with room for 16 nodes, and the vectors of this period."""

    w1 = port("N m", "W1 (L + 1, 2)", shape=(NODES_MAX + 1, JOINTS), recorded=False, adapts=True)
    w2 = port("N m", "W2 (4, 2)", shape=(JUMPS, JOINTS), recorded=False, adapts=True)
    v = port("", "V (11, L)", shape=(INPUTS, NODES_MAX), recorded=False, adapts=True)
    x = group(Vector, "x_", recorded=False)  # (1)
    z = port("", "inputs V'x of the nodes", shape=NODES_MAX, recorded=False)
    s = port("", "threshold and nodes", shape=NODES_MAX + 1, recorded=False)
    phi = port("", "jump nodes (2), a joint after the other", shape=JUMPS, recorded=False)


class Outputs(arm_pd.Outputs):
    """Those of the PD law, and the network's."""

    network_Nm = port("N m", "network torque (3) of joint #", shape=JOINTS, named="network_#_Nm")
    norm_z = port("", "Frobenius norm of all weights")
    step_weight_Nm = port(
        "N m",
        "weight of phi_0(q#') on joint #; ideally twice its friction",
        shape=JOINTS,
        named="step_weight_#_Nm",
    )
    tuning_gain_Nms_rad = port("N m s/rad", "dt G, gain of the tuning; unstable beyond Kv")


@inline
def jumps(rate: Array, v_eps: float, variant: float, phi: Array) -> None:
    """Write phi (2) of the `variant` (6); `rate` (2,) of both joints, `phi` (4,)."""
    for i in range(JOINTS):
        step_pair(rate[i], phi, 2 * i)
        if variant == RAMP:
            phi[2 * i] = ramp(rate[i], v_eps)
        if variant == STANDARD:
            phi[2 * i] = 0.0
            phi[2 * i + 1] = 0.0
        if variant == CONST:
            phi[2 * i] = 1.0
            phi[2 * i + 1] = 0.0


@inline
def learn(dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Tune (5), and show the weights of the own steps."""
    rate = network_inputs.tuned_s(dt, u)
    leak = p.kappa * sqrt(square_sum(y.r_rad_s, 0))
    n, step_s, step_t, step_e = int(p.nodes), rate * p.s_rate, rate * p.t_rate, rate * p.e_rate
    tune(flat(x.x), x, n, y.r_rad_s, leak, step_s, step_t, step_e)
    for i in range(JOINTS):
        own = x.w2[2 * i, i]
        if p.jump_nodes == PROJECT:
            x.w2[2 * i, i] = where(own < 0.0, 0.0, own)
        y.step_weight_Nm[i] = x.w2[2 * i, i]


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One control period; see the module header."""
    n = int(p.nodes)
    network_inputs.observe(u, x.x)  # (1)
    hidden(flat(x.x), x, n)
    jumps(u.rate_rad_s, p.v_eps_rad_s, p.jump_nodes, x.phi)  # (2)
    y.norm_z = norm(x, n)
    for i in range(JOINTS):
        arm_pd.errors(i, p.lam_per_s[i], u, y)
        r, learned = y.r_rad_s[i], output(x, n, i)  # (3)
        y.network_Nm[i] = learned
        y.torque_Nm[i] = p.kv_Nms_rad[i] * r + learned + p.kz * (y.norm_z + p.z_bound) * r  # (4)
    y.tuning_gain_Nms_rad = dt * tuning_gain(flat(x.x), x, n, p.s_rate, p.t_rate, p.e_rate)
    learn(dt, p, x, u, y)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and V (11, L) uniform in +-1, drawn row by row."""
    nodes = int(settings["nodes"])
    v = np.zeros((INPUTS, NODES_MAX))
    layer = first_layer(settings["network_seed"], INPUTS, nodes)
    v[:, :nodes] = np.reshape(layer, (INPUTS, nodes))
    return Prepared(settings, {"v": v.ravel().tolist()})


BLOCK = Block(step, settings=Settings, prepare=prepare)
