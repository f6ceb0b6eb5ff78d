"""The command that moves a gap by one step to a wanted torque, with a network: a part of laws.

    tt = tau_d(k) - tau(k)                                 tau_d and r as in map_pd.py       (1)
    g += (1 - rho)(tau_d(k) - tau_d(k-1) - g)              step of tau_d, smoothed; g(0) = 0 (2)
    u(k+1) = clip(-Kb tt + tau_d(k) + g + W's, +-u_max)                                      (3)
    x = [1, r, x_d(k-1), x_d(k), tt, tau(k)]                                                 (4)
    s = [sigma(V'x), tt > 0, tt < 0]                       ten smooth nodes, two jump nodes  (5)
    W += alpha s(k-1) (tt + c_r r) - Gam |I - alpha s s'| W,   s = s(k-1), k > 0             (6)
    |I - alpha s s'| = max(1, |1 - alpha |s|^2|)           spectral norm, exactly            (7)

(6) comes before (3) and uses the s that W was multiplied with a step ago.

c_r < 0: on tt + c_r r = 0 the loop is r(k+1) = (Kv + c_r) r. tau_d(k) + g stands for tau_d(k+1);
the filter a z/(z + a) that the book seems to use for it is unstable where it is wanted, for large
a. V is never tuned, W = 0 at the start. `network_on` 0 leaves the inversion loop alone; `jumps_on`
0 takes the jump nodes out.

Without units. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 5.3; all gains, (2), the jump
nodes and the sign of c_r are chosen.
"""

from pcpc.executive.laws.approximators.two_layer import hidden, output_from, square_sum
from pcpc.executive.laws.block import Array, Ports, inline, port
from pcpc.executive.laws.emath import clip, sqrt, where

INPUTS, NODES, JUMPS = 6, 10, 2
N_S = NODES + JUMPS


class Inversion(Ports):
    """The inversion's and the network's parameters."""

    kb = port("", "Kb, of the torque error", 0.3, -10.0, 10.0)
    smoothing = port("", "rho of the smoothed step of tau_d", 0.9, 0.0, 1.0)
    u_max = port("", "limit of u", 10.0, 0.0, 1e12)
    network_on = port("", "1 adds the network and tunes it", 1.0, 0.0, 1.0)
    jumps_on = port("", "1 for the jump nodes", 1.0, 0.0, 1.0)
    alpha = port("", "tuning rate", 0.15, 0.0, 10.0)
    gamma = port("", "Gam, forgetting", 1e-5, 0.0, 1.0)
    cr = port("", "c_r, share of r in the tuning", -0.3, -10.0, 10.0)


class States(Ports):
    """The prediction, the latch and the network."""

    tau_d_before = port("", "tau_d of the sample before")
    g = port("", "g (2)")
    started = port("", "1 after the first sample")
    latched = port("", "1 once the law was latched off")
    w = port("", "output weights W", shape=N_S, recorded=False, adapts=True)
    v = port("", "first-layer weights V, row by row", shape=(INPUTS, NODES), recorded=False)
    s = port("", "nodes, behind a place for two_layer's bias", shape=1 + N_S, recorded=False)
    x = port("", "inputs of this step", shape=INPUTS, recorded=False)
    a = port("", "inputs of the nodes", shape=NODES, recorded=False)


class InversionOutputs(Ports):
    """The inversion's and the network's."""

    tau_error = port("", "tt (1)")
    foretold = port("", "tau_d(k) + g, for tau_d(k+1)")
    network = port("", "W's")
    norm_w = port("", "|W|")


@inline
def tune(drive: float, alpha: float, gamma: float, s: Array, w: Array) -> None:
    """Step (6) of `w` (12,) in place; `s` (13,) with the bias's place, `drive` = tt + c_r r."""
    norm = abs(1.0 - alpha * square_sum(s, 1))  # (7)
    leak = gamma * where(norm > 1.0, norm, 1.0)
    for j in range(N_S):
        w[j] += alpha * s[1 + j] * drive - leak * w[j]


@inline
def inverse_command(p: Ports, going: bool, u: Ports, x: States, y: Ports) -> float:
    """Return u(k+1) (3) for the tau_d and r in `y`; tune (6), and write all but the command."""
    tt = y.tau_d - u.tau  # (1)
    first = x.started < 0.5
    if p.network_on > 0.5 and going and not first:
        tune(tt + p.cr * y.r, p.alpha, p.gamma, x.s, x.w)  # (6), s still that of the step before
    change = where(first, 0.0, y.tau_d - x.tau_d_before)
    x.g = p.smoothing * x.g + (1.0 - p.smoothing) * change  # (2)
    x.tau_d_before = y.tau_d
    x.started = 1.0
    y.foretold = y.tau_d + x.g

    x.x[0], x.x[1], x.x[2] = 1.0, y.r, u.x_d_previous  # (4)
    x.x[3], x.x[4], x.x[5] = u.x_d, tt, u.tau
    hidden(x.x, x.v, x.a, x.s)  # (5)
    jumps = p.jumps_on > 0.5
    x.s[1 + NODES] = where(jumps & (tt > 0.0), 1.0, 0.0)
    x.s[2 + NODES] = where(jumps & (tt < 0.0), 1.0, 0.0)
    y.network = where(p.network_on > 0.5, output_from(1, x.s, x.w), 0.0)
    y.tau_error = tt
    y.norm_w = sqrt(square_sum(x.w, 0))
    return clip(-p.kb * tt + y.foretold + y.network, -p.u_max, p.u_max)  # (3)
