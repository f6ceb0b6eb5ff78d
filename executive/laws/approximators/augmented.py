"""Two-layer network with m outputs and a second, fixed first layer of jump nodes; weights in views.

    z    = V'x                                 n hidden inputs, x[0] = 1 for the thresholds  (1)
    s    = [1; 1/(1 + exp(-z))]                                                              (2)
    fhat = W1's + W2'phi                       phi: k jump nodes, see `step_pair`            (3)

    step pair of v     phi_0 = 1 for v >= 0, else 0;  phi_1 = 1 - exp(-v) for v >= 0, else 0 (4)
    ramp               phi_0 = clip(1/2 + v/(2 v_eps), 0, 1) instead                         (5)

Tuning with e-modification, r (m,) the error that drives it, s' = [0; diag(s (1 - s))]:

    dW1 = S s r' - S s' z r' - kappa S |r| W1                                                (6)
    dV  = T x (s''W1 r)'     - kappa T |r| V                                                 (7)
    dW2 = E phi r'           - kappa E |r| W2                                                (8)

All right sides use the old weights. In a sampled loop M r' = -Kv r - y, y+ = y + dt G r the tuning
itself is a gain, and it is stable only for dt G < Kv, whatever M; a bound of G is

    G = S (s's - sum_j s_j s'_j z_j) + E |phi|^2 + T |x|^2 sum_j s'_j^2 |W1_j|^2             (9)

`x` (n_in,); `n` is the number of nodes in use.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 3: augmented network, tuning laws; (9) is this
project's, by linearising the sampled loop (Jury's criterion).
"""

from typing import Protocol

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.approximators.two_layer import nodes, square_sum
from pcpc.executive.laws.emath import clip, exp, sqrt, where


class AugmentedNetwork(Protocol):
    """A law's view of its network, with room for n nodes or more."""

    v: Array  # (n_in, n)
    w1: Array  # (n + 1, m)
    w2: Array  # (k, m)
    z: Array  # (n,)
    s: Array  # (n + 1,)
    phi: Array  # (k,)


@inline
def step_pair(v: float, phi: Array, at: int) -> None:
    """Write the two nodes (4) to phi[at] and phi[at + 1]; at v = 0 they are 1 and 0.

    `phi`: (k,).
    """
    forward = v >= 0.0
    phi[at] = where(forward, 1.0, 0.0)
    phi[at + 1] = where(forward, 1.0 - exp(-v), 0.0)


@inline
def ramp(v: float, v_eps: float) -> float:
    """Return the ramp (5) that may stand for phi_0; `v_eps` > 0."""
    return clip(0.5 + v / (2.0 * v_eps), 0.0, 1.0)


@inline
def hidden(x: Array, net: AugmentedNetwork, n: int) -> None:
    """Write z (1) and s (2) of `x` (n_in,)."""
    net.s[0] = 1.0
    nodes(x, net.v, n, net.z, net.s, 1)


@inline
def output(net: AugmentedNetwork, n: int, i: int) -> float:
    """Return fhat_i (3)."""
    y = 0.0
    for j in range(n + 1):
        y += net.w1[j, i] * net.s[j]
    for j in range(len(net.phi)):
        y += net.w2[j, i] * net.phi[j]
    return y


@inline
def add_squares(total: float, w: Array, rows: int, columns: int) -> float:
    """Return `total` plus the squares of the first rows and columns of a matrix, one by one."""
    for i in range(rows):
        for j in range(columns):
            total += w[i, j] * w[i, j]
    return total


@inline
def norm(net: AugmentedNetwork, n: int) -> float:
    """Return the Frobenius norm of all weights."""
    total = add_squares(0.0, net.v, len(net.v), n)
    total = add_squares(total, net.w1, n + 1, len(net.w1[0]))
    return sqrt(add_squares(total, net.w2, len(net.w2), len(net.w2[0])))


@inline
def tuning_gain(
    x: Array, net: AugmentedNetwork, n: int, rate_s: float, rate_t: float, rate_e: float
) -> float:
    """Return G (9); `x` (n_in,)."""
    outer, inner = 1.0, 0.0  # of the threshold, s_0 = 1 and s'_0 = 0
    for j in range(n):
        s, w = net.s[j + 1], net.w1[j + 1]
        slope = s * (1.0 - s)
        outer += s * (s - slope * net.z[j])
        for i in range(len(w)):
            inner += slope * slope * w[i] * w[i]
    return rate_s * outer + rate_e * square_sum(net.phi, 0) + rate_t * square_sum(x, 0) * inner


@inline
def tune(
    x: Array,
    net: AugmentedNetwork,
    n: int,
    r: Array,
    leak: float,
    step_s: float,
    step_t: float,
    step_e: float,
) -> None:
    """One Euler step of (6) to (8) in place.

    `x` (n_in,), `r` (m,); `leak` = kappa |r|; `step_s`, `step_t`, `step_e` are S, T, E times the
    period.
    """
    phi, v, w1, w2 = net.phi, net.v, net.w1, net.w2
    for j in range(n):
        s = net.s[j + 1]
        slope = s * (1.0 - s)
        back = 0.0
        for i in range(len(r)):
            back += w1[j + 1, i] * r[i]
        for i in range(len(x)):
            v[i, j] += step_t * (x[i] * slope * back - leak * v[i, j])  # (7), W1 still old
        for i in range(len(r)):
            w1[j + 1, i] += step_s * ((s - slope * net.z[j]) * r[i] - leak * w1[j + 1, i])  # (6)
    for i in range(len(r)):
        w1[0, i] += step_s * (r[i] - leak * w1[0, i])  # (6) of the threshold
        for j in range(len(phi)):
            w2[j, i] += step_e * (phi[j] * r[i] - leak * w2[j, i])  # (8)
