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
ghat' = Gam (2.5 sc - kap2 ghat). Weights rest in a cycle without new measurements.

With M = Mhat and f of `arm_pd_inertia.py` written as W2*'s2 + eps, r' = f - d - u and alpha = kap1,
~ for ideal less current and L = (|r|^2 + |R|^2 + |W1~|^2 + |W2~|^2/Gam)/2:

    L' = -Kv |r|^2 + beta R'r - |s1|^2 |R|^2 + R'W1~'s1 + kap1 tr(W1~'W1) + kap2 tr(W2~'W2)
         + sc'(eps - d + v)                                                                 (11)

so errors are uniformly ultimately bounded for kz >= |eps| + |d| and
beta^2 < 4 Kv |s1|^2 (1 - 1/(4 kap1)). A payload violates M = Mhat. rad, rad/s, N m; positive
torque raises q. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 7.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.controllers.arm import arm_pd
from pcpc.executive.laws.controllers.arm.arm_pd_inertia import GAINS, KV, errors, torques
from pcpc.executive.laws.emath import logistic, sqrt, where

JOINTS = 2
NODES = 10
INPUTS = 1 + 5 * JOINTS

PARAMETERS = (
    *GAINS,
    Port("action_on", "", "0 switches the action network off", 1.0, 0.0, 1.0),
    Port("critic_on", "", "0 switches the critic off", 1.0, 0.0, 1.0),
    Port("gam", "", "Gam, tuning rate of W2", None, 0.0, 1e5),
    Port("kap1", "", "leak of W1", None, 0.0, 1e3),
    Port("kap2", "", "leak of W2, times Gam", None, 0.0, 1e3),
    Port("alpha", "", "of (9); the proof wants kap1", None, 0.0, 1e3),
    Port("beta", "", "drives the critic", None, 0.0, 1e3),
    Port("kz", "", "robust term; 0 leaves it out", None, 0.0, 1e4),
    Port("delta_rad_s", "rad/s", "smooths its unit vector", None, 1e-6, 1e3),
)
SETTINGS = (
    *PARAMETERS,
    Port("network_seed", "", "draws V1 and V2", 7.0, 0.0, 2.0**31),
    Port("v2_size", "", "half width of V2's draw; 0: ghat only integrates", 1.0, 0.0, 10.0),
)
STATES = (
    Port("v1", "", "V1 (2, 10), row by row", size=JOINTS * NODES, recorded=False),
    Port("v2", "", "V2 (11, 10), row by row", size=INPUTS * NODES, recorded=False),
    Port("w1", "", "W1 (10, 2), row by row", size=NODES * JOINTS, recorded=False),
    Port("w2", "", "W2 (10, 2), row by row", size=NODES * JOINTS, recorded=False),
    Port("rho", "", "rho", size=JOINTS, recorded=False),
    Port("scratch", "", "V1'r, s1, s2, R, sc, x", size=3 * NODES + 4 + INPUTS, recorded=False),
)
OUTPUTS = (
    *arm_pd.OUTPUTS,
    Port("learned_1_rad_s2", "rad/s2", "ghat (5) of joint 1"),
    Port("learned_2_rad_s2", "rad/s2", "ghat (5) of joint 2"),
    Port("robust_1_rad_s2", "rad/s2", "-v (6) of joint 1"),
    Port("robust_2_rad_s2", "rad/s2", "-v (6) of joint 2"),
    Port("critic_1", "", "R (2) of joint 1"),
    Port("critic_2", "", "R (2) of joint 2"),
    Port("norm_w1", "", "Frobenius norm of W1"),
    Port("norm_w2", "", "Frobenius norm of W2"),
    Port("norm_rho", "", "|rho|"),
)
(ACTION_ON, CRITIC_ON, GAM, KAP1, KAP2, ALPHA, BETA, KZ, DELTA) = range(len(GAINS), len(PARAMETERS))
_V1, _V2 = 0, JOINTS * NODES
_W1 = _V2 + INPUTS * NODES
_W2 = _W1 + NODES * JOINTS
_RHO = _W2 + NODES * JOINTS
_Z1 = _RHO + JOINTS
_S1, _S2 = _Z1 + NODES, _Z1 + 2 * NODES
_R = _S2 + NODES
_SC, _XI = _R + JOINTS, _R + 2 * JOINTS
ERRORS = 4  # r in the outputs


@inline
def nodes(xi: Any, n_in: int, v: Any, z: Any, s: Any) -> None:
    """Write z = V'x and s = sigma(z), which may be one view; `xi` (n_in,), `v` (n_in, NODES)."""
    for j in range(NODES):
        total = 0.0
        for i in range(n_in):
            total += v[i * NODES + j] * xi[i]
        z[j] = total
        s[j] = logistic(total)


@inline
def read_out(w: Any, s: Any, i: int) -> float:
    """Return entry i of W's."""
    total = 0.0
    for j in range(NODES):
        total += w[j * JOINTS + i] * s[j]
    return total


@inline
def norm(w: Any, n: int) -> float:
    """Return the root of the sum of squares of w[0..n-1]."""
    total = 0.0
    for j in range(n):
        total += w[j] * w[j]
    return sqrt(total)


@inline
def blame(r: Any, v1: Any, w1: Any, s1: Any, signal: Any, sc: Any) -> None:
    """Write sc (3)."""
    for i in range(JOINTS):
        sc[i] = r[i]
    for j in range(NODES):
        back = w1[j * JOINTS] * signal[0] + w1[j * JOINTS + 1] * signal[1]
        back = s1[j] * (1.0 - s1[j]) * back
        for i in range(JOINTS):
            sc[i] += v1[i * NODES + j] * back


@inline
def tune_critic(
    dt: float, p: Any, r: Any, z1: Any, s1: Any, signal: Any, w1: Any, rho: Any
) -> None:
    """One Euler step of (9), then of (8), which does not use rho."""
    for i in range(JOINTS):
        rate = p[BETA] * r[i]
        for j in range(NODES):
            slope = s1[j] * (1.0 - s1[j])
            rate += w1[j * JOINTS + i] * (slope * p[KV] * z1[j] + p[ALPHA] * s1[j])
        rho[i] += dt * rate  # (9)
    for j in range(NODES):
        for i in range(JOINTS):
            k = j * JOINTS + i
            w1[k] += dt * (-s1[j] * signal[i] - p[KAP1] * w1[k])  # (8)


@inline
def tune_action(dt: float, p: Any, s2: Any, sc: Any, w2: Any) -> None:
    """One Euler step of (10)."""
    for j in range(NODES):
        for i in range(JOINTS):
            k = j * JOINTS + i
            w2[k] += dt * p[GAM] * (s2[j] * sc[i] - p[KAP2] * w2[k])


@inline
def action_inputs(u: Any, xi: Any) -> None:
    """Write the input vector of (4)."""
    xi[0] = 1.0
    for i in range(JOINTS):
        xi[1 + i] = u[i] - u[4 + i]
        xi[3 + i] = u[2 + i] - u[6 + i]
        xi[5 + i] = u[i]
        xi[7 + i] = u[2 + i]
        xi[9 + i] = u[8 + i]


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    v1, v2, w1, w2, rho = tail(x, _V1), tail(x, _V2), tail(x, _W1), tail(x, _W2), tail(x, _RHO)
    z1, s1, s2, xi = tail(x, _Z1), tail(x, _S1), tail(x, _S2), tail(x, _XI)
    signal, sc, r = tail(x, _R), tail(x, _SC), tail(y, ERRORS)
    errors(p, u, y)
    nodes(r, JOINTS, v1, z1, s1)  # (1)
    action_inputs(u, xi)
    nodes(xi, INPUTS, v2, s2, s2)  # (4)
    for i in range(JOINTS):
        signal[i] = 0.0
        if p[CRITIC_ON] > 0.5:
            signal[i] = read_out(w1, s1, i) + rho[i]  # (2)
    blame(r, v1, w1, s1, signal, sc)
    size = norm(sc, JOINTS) + p[DELTA]
    for i in range(JOINTS):
        y[6 + i] = 0.0
        if p[ACTION_ON] > 0.5:
            y[6 + i] = read_out(w2, s2, i)  # (5)
        y[8 + i] = p[KZ] * sc[i] / size  # (6)
        y[10 + i] = signal[i]
    torques(p, u[5], y[6] + p[KV] * r[0] + y[8], y[7] + p[KV] * r[1] + y[9], y)  # (7)
    y[12] = norm(w1, NODES * JOINTS)
    y[13] = norm(w2, NODES * JOINTS)
    y[14] = norm(rho, JOINTS)

    rate = where(u[10] > 0.0, 0.0, dt)
    if p[CRITIC_ON] > 0.5:
        tune_critic(rate, p, r, z1, s1, signal, w1, rho)
    if p[ACTION_ON] > 0.5:
        tune_action(rate, p, s2, sc, w2)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given, and V1, then V2, uniform in +-1, drawn row by row."""
    draw = np.random.default_rng(int(settings["network_seed"])).uniform
    v1 = draw(-1.0, 1.0, (JOINTS, NODES))
    v2 = settings["v2_size"] * draw(-1.0, 1.0, (INPUTS, NODES))
    own = {port.name: settings[port.name] for port in PARAMETERS}
    return Prepared(own, {"v1": v1.ravel().tolist(), "v2": v2.ravel().tolist()})


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
