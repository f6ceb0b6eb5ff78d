"""PD law of `arm_pd.py` with the augmented network of `augmented.py`, which learns the friction.

    x    = [1, e1, e2, e1', e2', q_d1, q_d2, q_d1', q_d2', q_d1'', q_d2'']                   (1)
    phi  = [phi_0(q1'), phi_1(q1'), phi_0(q2'), phi_1(q2')],  q' = q_d' - e'                 (2)
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

Weights rest in a cycle without new measurements. `tuning_gain_Nms_rad` is dt G of augmented.py: the
loop through the tuning is stable while it stays below Kv, and wants half of it.
rad, rad/s, N m; positive torque raises q. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 3; 2
to 4 of (6) are this project's.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.approximators.augmented import (
    hidden,
    norm,
    output,
    ramp,
    step_pair,
    tune,
    tuning_gain,
)
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.controllers.arm import arm_pd
from pcpc.executive.laws.emath import sqrt, where

JOINTS = 2
INPUTS = 11
NODES_MAX = 16
JUMPS = 4
STANDARD, STEP, RAMP, PROJECT, CONST = 0.0, 1.0, 2.0, 3.0, 4.0

PARAMETERS = (
    *arm_pd.GAINS,
    Port("kz", "", "Kz, robust term", None, 0.0, 100.0),
    Port("z_bound", "", "Z_B, bound of the ideal weights", None, 0.0, 1e6),
    Port("s_rate", "", "S, tuning rate of W1", None, 0.0, 1e4),
    Port("t_rate", "", "T, tuning rate of V", None, 0.0, 1e4),
    Port("e_rate", "", "E, tuning rate of W2", None, 0.0, 1e4),
    Port("kappa", "", "e-modification", None, 0.0, 10.0),
    Port("v_eps_rad_s", "rad/s", "half width of the ramp", 0.01, 1e-6, 10.0),
    Port("jump_nodes", "", "0 none, 1 step, 2 ramp, 3 project, 4 const", None, 0.0, 4.0),
    Port("nodes", "", "hidden nodes L, whole", 10.0, 1.0, float(NODES_MAX)),
)
SETTINGS = (*PARAMETERS, Port("network_seed", "", "draws V", 1.0, 0.0, 2.0**31))
STATES = (
    Port("w1", "N m", "W1 (L + 1, 2)", size=(NODES_MAX + 1) * JOINTS, recorded=False),
    Port("w2", "N m", "W2 (4, 2)", size=JUMPS * JOINTS, recorded=False),
    Port("v", "", "V (11, L), rows of 16", size=INPUTS * NODES_MAX, recorded=False),
    Port("scratch", "", "x, z, s, phi, r", size=INPUTS + 2 * NODES_MAX + 7, recorded=False),
)
OUTPUTS = (
    *arm_pd.OUTPUTS,
    Port("network_1_Nm", "N m", "network torque (3) of joint 1"),
    Port("network_2_Nm", "N m", "network torque (3) of joint 2"),
    Port("norm_z", "", "Frobenius norm of all weights"),
    Port("step_weight_1_Nm", "N m", "weight of phi_0(q1') on joint 1; ideally twice its friction"),
    Port("step_weight_2_Nm", "N m", "weight of phi_0(q2') on joint 2"),
    Port("tuning_gain_Nms_rad", "N m s/rad", "dt G, gain of the tuning; unstable beyond Kv"),
)
(KZ, Z_BOUND, S, T, E, KAPPA, V_EPS, JUMP_NODES, NODES) = range(4, 13)
_W1, _W2 = 0, (NODES_MAX + 1) * JOINTS
_V = _W2 + JUMPS * JOINTS
_X = _V + INPUTS * NODES_MAX
_Z = _X + INPUTS
_S = _Z + NODES_MAX
_PHI = _S + NODES_MAX + 1
_R = _PHI + JUMPS
OWN_STEP = (_W2, _W2 + 2 * JOINTS + 1)  # phi_0(q1') on joint 1, phi_0(q2') on joint 2


@inline
def errors(p: Any, u: Any, xi: Any, r: Any) -> None:
    """Write x (1) and the filtered error; `u` as INPUTS of BLOCK."""
    xi[0] = 1.0
    for i in range(JOINTS):
        e = u[i] - u[4 + i]
        e_rate = u[2 + i] - u[6 + i]
        xi[1 + i] = e
        xi[3 + i] = e_rate
        xi[5 + i] = u[i]
        xi[7 + i] = u[2 + i]
        xi[9 + i] = u[8 + i]
        r[i] = e_rate + p[2 + i] * e


@inline
def jumps(rate_1: float, rate_2: float, v_eps: float, variant: float, phi: Any) -> None:
    """Write phi (2) of the `variant` (6)."""
    step_pair(rate_1, phi, 0)
    step_pair(rate_2, phi, 2)
    if variant == RAMP:
        phi[0] = ramp(rate_1, v_eps)
        phi[2] = ramp(rate_2, v_eps)
    if variant == STANDARD:
        for i in range(JUMPS):
            phi[i] = 0.0
    if variant == CONST:
        for i in range(JOINTS):
            phi[2 * i] = 1.0
            phi[2 * i + 1] = 0.0


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    n = int(p[NODES])
    w1, w2, v = tail(x, _W1), tail(x, _W2), tail(x, _V)
    xi, z, s, phi, r = tail(x, _X), tail(x, _Z), tail(x, _S), tail(x, _PHI), tail(x, _R)
    errors(p, u, xi, r)
    hidden(xi, INPUTS, n, NODES_MAX, v, z, s)
    jumps(u[6], u[7], p[V_EPS], p[JUMP_NODES], phi)
    size = norm(INPUTS, n, NODES_MAX, JOINTS, JUMPS, v, w1, w2)
    for i in range(JOINTS):
        learned = output(i, JOINTS, s, n, w1, phi, JUMPS, w2)  # (3)
        y[i] = p[i] * r[i] + learned + p[KZ] * (size + p[Z_BOUND]) * r[i]  # (4)
        y[2 + i] = xi[1 + i]
        y[4 + i] = r[i]
        y[6 + i] = learned
    y[8] = size
    y[11] = dt * tuning_gain(
        p[S], p[T], p[E], xi, INPUTS, n, z, s, JOINTS, w1, phi, JUMPS
    )  # fmt: skip

    rate = where(u[10] > 0.0, 0.0, dt)
    leak = p[KAPPA] * sqrt(r[0] * r[0] + r[1] * r[1])
    tune(
        r, JOINTS, leak, rate * p[S], rate * p[T], rate * p[E],
        xi, INPUTS, n, NODES_MAX, z, s, phi, JUMPS, v, w1, w2,
    )  # fmt: skip  # (5)
    for i in range(JOINTS):
        own = x[OWN_STEP[i]]
        if p[JUMP_NODES] == PROJECT:
            x[OWN_STEP[i]] = where(own < 0.0, 0.0, own)
        y[9 + i] = x[OWN_STEP[i]]


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and V (11, L) uniform in +-1, drawn row by row."""
    nodes = int(settings["nodes"])
    v = np.zeros((INPUTS, NODES_MAX))
    draw = np.random.default_rng(int(settings["network_seed"])).uniform
    v[:, :nodes] = draw(-1.0, 1.0, (INPUTS, nodes))
    own = {port.name: settings[port.name] for port in PARAMETERS}
    return Prepared(own, {"v": v.ravel().tolist()})


BLOCK = Block(
    step,
    inputs=(
        *arm_pd.INPUTS,
        Port("q_d_acc_1_rad_s2", "rad/s2", "desired acceleration of joint 1"),
        Port("q_d_acc_2_rad_s2", "rad/s2", "desired acceleration of joint 2"),
        Port("missing_cycles", "", "cycles since the last measurement; 0 if it is new"),
    ),
    outputs=OUTPUTS,
    settings=SETTINGS,
    parameters=PARAMETERS,
    states=STATES,
    prepare=prepare,
)
