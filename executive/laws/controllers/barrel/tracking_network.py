"""The neural network of the pointing laws: learns friction, gravity, inertia along the reference.

    x   = [1, e/0.02, e'/0.2, q_d/0.5, q_d'/0.5, q_d''/3, w/0.2]   entries 2.. within +-3    (1)
    v_j = q_d' - hull rate             DESIRED speed against the hull: at rest the measured
                                       one is zero and could not flip the friction term      (2)
    phi = [1, s_1..s_10, j+-(v_j; 0.004), j+-(v_j; 0.04)]                                    (3)
    y   = W'phi                                                                              (4)
    rob = Kz (|Z|_F + Z_B) r,  Z = blkdiag(W, V)       robust term                           (5)
    tuning of two_layer.py, driven by clip(r, +-0.3), only while |e| > 0.1 mrad or the
    reference accelerates                                                                    (6)

y and |Z| use the weights before the update. w is the measured speed of the hub against the hull.

Health: as soon as y is no finite number within y_max or |Z| exceeds z_max, the network is latched
off: the torque of (4) and (5) that was last sent fades away in 0.1 s and the PD law beneath goes on
alone. With W = 0 at the start, V uniform in +-1 from `network_seed`, tuning laws and
e-modification, the errors are uniformly ultimately bounded:
L = r'M r/2 + tr(W~'F^-1 W~)/2 + tr(V~'G^-1 V~)/2.

rad, rad/s, N m. Source: augmented network and tuning after Lewis, Campos, Selmic (SIAM 2002),
chapter 3.
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
from pcpc.executive.laws.block import Port, Prepared
from pcpc.executive.laws.emath import clip, sqrt, where

INPUTS = 7
NODES = 10
JUMPS = 4
PHI = 1 + NODES + JUMPS
JUMP_SPEEDS_RAD_S = (0.004, 0.04)  # one inside, one beyond the Stribeck range
R_MAX_RAD_S = 0.3  # raw steps would wind the weights up
DEAD_BAND_RAD = 1e-4
FADE_S = 0.1
NORM_SHOWN = 1e6  # beyond any bound that a rig may set; stands for what is not finite, too

PARAMETERS = (
    Port("network_on", "", "1 engages the network, 0 leaves the PD law alone", None, 0.0, 1.0),
    Port("f_rate", "", "F, tuning rate of bias and smooth nodes", None, 0.0, 1e5),
    Port("fj_rate", "", "FJ, tuning rate of the jump nodes", None, 0.0, 1e5),
    Port("g_rate", "", "G, tuning rate of the first layer", None, 0.0, 1e5),
    Port("kappa", "", "e-modification", None, 0.0, 10.0),
    Port("kz", "", "Kz, robust term", None, 0.0, 100.0),
    Port("z_bound", "", "Z_B, bound of the ideal weights", None, 0.0, 1e6),
    Port("z_max", "", "weight norm at which the network is latched off", None, 0.0, 1e6),
    Port("y_max_Nm", "N m", "output at which the network is latched off", None, 0.0, 1e6),
)
STATES = (
    Port("w", "N m", "output weights W", size=PHI, recorded=False),
    Port("v", "", "first-layer weights V, row by row", size=INPUTS * NODES, recorded=False),
    Port("network_fault", "", "1 once the network was latched off"),
    Port("faded_Nm", "N m", "network torque last sent, fading after a fault"),
    Port("scratch", "", "x, a, phi of this period", size=INPUTS + NODES + PHI, recorded=False),
)
SETTINGS = (
    *PARAMETERS,
    Port("network_seed", "", "draws the first layer", None, 0.0, 2.0**31),
)
OUTPUTS = (
    Port("network_Nm", "N m", "network torque (4), or what is left of it after a fault"),
    Port("norm_z", "", "Frobenius norm of all weights; 1e6 if larger or not finite"),
    Port("fallback", "", "1 once the network was latched off and PD is alone"),
)
(ON, F, FJ, G, KAPPA, KZ, Z_BOUND, Z_MAX, Y_MAX) = range(len(PARAMETERS))
_W, _V = 0, PHI
_FAULT = _V + INPUTS * NODES
_FADED, _X = _FAULT + 1, _FAULT + 2
_A, _PHI = _X + INPUTS, _X + INPUTS + NODES
SIZE = _PHI + PHI


def first_layer(settings: Mapping[str, float]) -> dict[str, Any]:
    """Return the initial state: V (7, 10) uniform in +-1, everything else 0."""
    draw = np.random.default_rng(int(settings["network_seed"])).uniform
    return {"v": draw(-1.0, 1.0, (INPUTS, NODES)).ravel()}


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and the drawn first layer."""
    return Prepared(settings, first_layer(settings))


@inline
def learned_torque(dt: float, e: float, r: float, u: Any, p: Any, x: Any, y: Any) -> float:
    """Return network and robust torque (4) (5), tune (6), write OUTPUTS to `y`.

    `u` = (e', q_d, q_d', q_d'', w, hull rate); `p`, `x`, `y` begin with this file's ports.
    """
    w, v = tail(x, _W), tail(x, _V)
    xi, a, phi = tail(x, _X), tail(x, _A), tail(x, _PHI)
    xi[0] = 1.0
    xi[1] = scaled(e, 0.02)
    xi[2] = scaled(u[0], 0.2)
    xi[3] = scaled(u[1], 0.5)
    xi[4] = scaled(u[2], 0.5)
    xi[5] = scaled(u[3], 3.0)
    xi[6] = scaled(u[4], 0.2)
    hidden(xi, INPUTS, NODES, v, a, phi)
    v_j = u[2] - u[5]  # (2)
    jump_pair(v_j, JUMP_SPEEDS_RAD_S[0], phi, 1 + NODES)
    jump_pair(v_j, JUMP_SPEEDS_RAD_S[1], phi, 3 + NODES)
    norm = sqrt(square_sum(w, PHI) + square_sum(v, INPUTS * NODES))
    network = output(phi, w, PHI)  # (4)
    learned = network + p[KZ] * (norm + p[Z_BOUND]) * r  # (5)

    on = p[ON] > 0.5
    healthy = (abs(network) <= p[Y_MAX]) & (norm <= p[Z_MAX])  # false for NaN
    x[_FAULT] = where(on, where(healthy, x[_FAULT], 1.0), x[_FAULT])
    trusted = on & (x[_FAULT] < 0.5)
    x[_FADED] = where(trusted, learned, x[_FADED] * (1.0 - dt / FADE_S))

    moving = (abs(e) > DEAD_BAND_RAD) | (abs(u[3]) > 1e-6)
    rate = where(trusted & moving, dt, 0.0)
    driven = clip(r, -R_MAX_RAD_S, R_MAX_RAD_S)
    tune(driven, p[KAPPA], p[F], p[FJ], p[G], rate, xi, INPUTS, NODES, JUMPS, a, phi, w, v)  # (6)
    y[0] = where(trusted, network, x[_FADED])
    y[1] = where(norm <= NORM_SHOWN, norm, NORM_SHOWN)
    y[2] = x[_FAULT]
    return x[_FADED]
