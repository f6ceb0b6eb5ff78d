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

Shapes: x (n_in,), V (n_in, n) with rows of `stride` >= n values, W1 (n + 1, m), W2 (k, m).
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 3: augmented network, tuning laws; (9) is this
project's, by linearising the sampled loop (Jury's criterion).
"""

from typing import Any

from pcpc.drivers.jit import inline
from pcpc.executive.laws.emath import clip, exp, logistic, sqrt, where


@inline
def step_pair(v: float, phi: Any, at: int) -> None:
    """Write the two nodes (4) to phi[at] and phi[at + 1]; at v = 0 they are 1 and 0."""
    forward = v >= 0.0
    phi[at] = where(forward, 1.0, 0.0)
    phi[at + 1] = where(forward, 1.0 - exp(-v), 0.0)


@inline
def ramp(v: float, v_eps: float) -> float:
    """Return the ramp (5) that may stand for phi_0; `v_eps` > 0."""
    return clip(0.5 + v / (2.0 * v_eps), 0.0, 1.0)


@inline
def hidden(x: Any, n_in: int, n: int, stride: int, v: Any, z: Any, s: Any) -> None:
    """Write z (1) and s (2); `z` (n,), `s` (n + 1,)."""
    s[0] = 1.0
    for j in range(n):
        total = 0.0
        for i in range(n_in):
            total += v[i * stride + j] * x[i]
        z[j] = total
        s[j + 1] = logistic(total)


@inline
def output(i: int, m: int, s: Any, n: int, w1: Any, phi: Any, k: int, w2: Any) -> float:
    """Return fhat_i (3)."""
    y = 0.0
    for j in range(n + 1):
        y += w1[j * m + i] * s[j]
    for j in range(k):
        y += w2[j * m + i] * phi[j]
    return y


@inline
def norm(n_in: int, n: int, stride: int, m: int, k: int, v: Any, w1: Any, w2: Any) -> float:
    """Return the Frobenius norm of all weights."""
    total = 0.0
    for i in range(n_in):
        for j in range(n):
            total += v[i * stride + j] * v[i * stride + j]
    for j in range((n + 1) * m):
        total += w1[j] * w1[j]
    for j in range(k * m):
        total += w2[j] * w2[j]
    return sqrt(total)


@inline
def tuning_gain(
    rate_s: float, rate_t: float, rate_e: float,
    x: Any, n_in: int, n: int, z: Any, s: Any, m: int, w1: Any, phi: Any, k: int,
) -> float:  # fmt: skip
    """Return G (9)."""
    inputs, jumps = 0.0, 0.0
    for i in range(n_in):
        inputs += x[i] * x[i]
    for j in range(k):
        jumps += phi[j] * phi[j]
    outer, inner = 1.0, 0.0  # of the threshold, s_0 = 1 and s'_0 = 0
    for j in range(n):
        slope = s[j + 1] * (1.0 - s[j + 1])
        outer += s[j + 1] * (s[j + 1] - slope * z[j])
        for i in range(m):
            inner += slope * slope * w1[(j + 1) * m + i] * w1[(j + 1) * m + i]
    return rate_s * outer + rate_e * jumps + rate_t * inputs * inner


@inline
def tune(
    r: Any, m: int, leak: float, ds: float, dt: float, de: float,
    x: Any, n_in: int, n: int, stride: int, z: Any, s: Any, phi: Any, k: int,
    v: Any, w1: Any, w2: Any,
) -> None:  # fmt: skip
    """One Euler step of (6) to (8) in place.

    `leak` = kappa |r|; `ds`, `dt`, `de` are S, T, E times the period.
    """
    for j in range(n):
        slope = s[j + 1] * (1.0 - s[j + 1])
        back = 0.0
        for i in range(m):
            back += w1[(j + 1) * m + i] * r[i]
        for i in range(n_in):
            at = i * stride + j
            v[at] += dt * (x[i] * slope * back - leak * v[at])  # (7), W1 still old
        for i in range(m):
            at = (j + 1) * m + i
            w1[at] += ds * ((s[j + 1] - slope * z[j]) * r[i] - leak * w1[at])  # (6)
    for i in range(m):
        w1[i] += ds * (r[i] - leak * w1[i])
        for j in range(k):
            at = j * m + i
            w2[at] += de * (phi[j] * r[i] - leak * w2[at])  # (8)
