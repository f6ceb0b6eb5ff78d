"""Backlash compensation of the second-order map by dynamic inversion with prediction.

    tt = tau_d(k) - tau(k)                                 tau_d and r as in map_pd.py       (1)
    g += (1 - rho)(tau_d(k) - tau_d(k-1) - g)              step of tau_d, smoothed; g(0) = 0 (2)
    u(k+1) = clip(-Kb tt + tau_d(k) + g + W's, +-u_max)                                      (3)
    x = [1, r, x_d(k-1), x_d(k), tt, tau(k)]                                                 (4)
    s = [sigma(V'x), tt > 0, tt < 0]                       ten smooth nodes, two jump nodes  (5)
    W += alpha s(k-1) (tt + c_r r) - Gam |I - alpha s s'| W,   s = s(k-1), k > 0             (6)
    |I - alpha s s'| = max(1, |1 - alpha |s|^2|)           spectral norm, exactly            (7)

(6) comes before (3) and uses the s that W was multiplied with a step ago. The answer to the sample
of k is for step k+1, since the inverse needs the next desired torque: `ahead` 1. So the law holds
exactly one sample of transport, and one more makes it unstable.

c_r < 0: on tt + c_r r = 0 the loop is r(k+1) = (Kv + c_r) r. tau_d(k) + g stands for tau_d(k+1);
the filter a z/(z + a) that the book seems to use for it is unstable where it is wanted, for large
a. V is drawn uniform in +-1 from `network_seed` and never tuned, W = 0. `network_on` 0 leaves the
inversion loop alone; `jumps_on` 0 takes the jump nodes out.

Beyond |r| = r_max the law is latched off and sends 0: `diverged`. Without units.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 5.3; all gains, (2), the jump nodes and the sign
of c_r are chosen.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.approximators.two_layer import hidden, output, square_sum
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.controllers.maps import map_pd
from pcpc.executive.laws.controllers.maps.map_pd import desired, sound
from pcpc.executive.laws.emath import clip, sqrt, where

N_IN, NODES, JUMPS = 6, 10, 2
N_S = NODES + JUMPS

PARAMETERS = (
    *map_pd.GAINS,
    Port("kb", "", "Kb, of the torque error", 0.3, -10.0, 10.0),
    Port("smoothing", "", "rho of the smoothed step of tau_d", 0.9, 0.0, 1.0),
    Port("u_max", "", "limit of u", 10.0, 0.0, 1e12),
    Port("network_on", "", "1 adds the network and tunes it", 1.0, 0.0, 1.0),
    Port("jumps_on", "", "1 for the jump nodes", 1.0, 0.0, 1.0),
    Port("alpha", "", "tuning rate", 0.15, 0.0, 10.0),
    Port("gamma", "", "Gam, forgetting", 1e-5, 0.0, 1.0),
    Port("cr", "", "c_r, share of r in the tuning", -0.3, -10.0, 10.0),
)
KB, SMOOTHING, U_MAX, ON, JUMPS_ON, ALPHA, GAMMA, CR = range(len(map_pd.GAINS), len(PARAMETERS))
SETTINGS = (*PARAMETERS, Port("network_seed", "", "draws V", 1.0, 0.0, 2.0**31))
STATES = (
    Port("tau_d_before", "", "tau_d of the sample before"),
    Port("g", "", "g (2)"),
    Port("started", "", "1 after the first sample"),
    map_pd.LATCHED,
    Port("w", "", "output weights W", size=N_S, recorded=False),
    Port("v", "", "first-layer weights V, row by row", size=N_IN * NODES, recorded=False),
    Port("s", "", "nodes, behind a place for two_layer's bias", size=1 + N_S, recorded=False),
    Port("scratch", "", "x, a of this step", size=N_IN + NODES, recorded=False),
)
BEFORE, G, STARTED, LATCHED, W = range(5)
V = W + N_S
S = V + N_IN * NODES
X, A = S + 1 + N_S, S + 1 + N_S + N_IN
INPUTS = (*map_pd.INPUTS, Port("tau", "", "measured tau"))
OUTPUTS = (
    *map_pd.OUTPUTS,
    Port("tau_error", "", "tt (1)"),
    Port("foretold", "", "tau_d(k) + g, for tau_d(k+1)"),
    Port("network", "", "W's"),
    Port("norm_w", "", "|W|"),
)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and V (6, 10), drawn uniform in +-1."""
    draw = np.random.default_rng(int(settings["network_seed"])).uniform
    return Prepared(settings, {"v": draw(-1.0, 1.0, (N_IN, NODES)).ravel().tolist()})


@inline
def tune(drive: float, alpha: float, gamma: float, s: Any, w: Any) -> None:
    """Step (6) of `w` (12,) in place; `s` (12,), `drive` = tt + c_r r."""
    norm = abs(1.0 - alpha * square_sum(s, N_S))  # (7)
    leak = gamma * where(norm > 1.0, norm, 1.0)
    for j in range(N_S):
        w[j] += alpha * s[j] * drive - leak * w[j]


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One step of the map; see the module header."""
    w, s = tail(x, W), tail(x, S + 1)
    xi = tail(x, X)
    e2, r, tau_d = desired(u, p)
    going = sound(r, p, x, LATCHED)
    tt = tau_d - u[5]  # (1)
    first = x[STARTED] < 0.5
    if p[ON] > 0.5 and going and not first:
        tune(tt + p[CR] * r, p[ALPHA], p[GAMMA], s, w)  # (6), s still that of the step before
    change = where(first, 0.0, tau_d - x[BEFORE])
    x[G] = p[SMOOTHING] * x[G] + (1.0 - p[SMOOTHING]) * change  # (2)
    x[BEFORE] = tau_d
    x[STARTED] = 1.0
    foretold = tau_d + x[G]

    xi[0], xi[1], xi[2], xi[3], xi[4], xi[5] = 1.0, r, u[0], u[1], tt, u[5]  # (4)
    hidden(xi, N_IN, NODES, tail(x, V), tail(x, A), tail(x, S))  # (5)
    jumps = p[JUMPS_ON] > 0.5
    s[NODES] = where(jumps & (tt > 0.0), 1.0, 0.0)
    s[NODES + 1] = where(jumps & (tt < 0.0), 1.0, 0.0)
    network = where(p[ON] > 0.5, output(s, w, N_S), 0.0)
    command = clip(-p[KB] * tt + foretold + network, -p[U_MAX], p[U_MAX])  # (3)

    y[0] = where(going, command, 0.0)
    y[1], y[2], y[3], y[4], y[5] = 1.0, e2, r, tau_d, x[LATCHED]
    y[6], y[7], y[8], y[9] = tt, foretold, network, sqrt(square_sum(w, N_S))


BLOCK = Block(
    step,
    inputs=INPUTS,
    outputs=OUTPUTS,
    settings=SETTINGS,
    parameters=PARAMETERS,
    states=STATES,
    prepare=prepare,
)
