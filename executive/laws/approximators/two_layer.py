"""Two-layer neural network with logistic nodes, a bias and jump nodes; weights live in views.

    a   = V'x                                  n hidden inputs                               (1)
    s   = 1/(1 + exp(-a))                      logistic nodes                                (2)
    phi = [1, s_1..s_n, j_1..j_m]              hidden vector: bias, smooth, jump nodes       (3)
    y   = W'phi                                output                                        (4)

A jump node is zero on one side of its switching point and rises as 1 - exp(-|v|/v_s) on the other;
one node per side, so that both heights are learned:

    j+ = 1 - exp(-v/v_s) for v > 0, else 0;    j- = 1 - exp(v/v_s) for v < 0, else 0         (5)

Tuning by backpropagation with e-modification; r is the error that drives it, kappa > 0, the s' of
the smooth nodes is s (1 - s):

    dW_0 = F  (r                - kappa |r| W_0)                                             (6)
    dW_s = F  ((s - s' a) r     - kappa |r| W_s)                                             (7)
    dW_j = FJ (j r              - kappa |r| W_j)                                             (8)
    dV   = G  (x (s' W_s)' r    - kappa |r| V)                                               (9)

All right sides use the old W and V. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 3: augmented
neural network for jump functions, and the tuning laws with e-modification.
"""

from typing import Protocol

import numpy as np

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.emath import clip, exp, logistic, sqrt, where


class TwoLayerNetwork(Protocol):
    """A law's view of its network."""

    x: Array  # (n_in,)
    a: Array  # (n,)
    phi: Array  # (1 + n + n_jump,)
    w: Array  # (1 + n + n_jump,)
    v: Array  # (n_in, n)


def first_layer(seed: float, inputs: int, nodes: int) -> list[float]:
    """Return V (inputs, nodes) uniform in +-1, row by row, the first that is drawn from `seed`."""
    draw = np.random.default_rng(int(seed)).uniform
    drawn: list[float] = draw(-1.0, 1.0, (inputs, nodes)).ravel().tolist()
    return drawn


@inline
def jump_pair(v: float, v_s: float, phi: Array, at: int) -> None:
    """Write the two jump nodes (5) of `v` to phi[at] and phi[at + 1].

    `phi`: (at + 2,) or longer.
    """
    rise = 1.0 - exp(-abs(v) / v_s)
    phi[at] = where(v > 0.0, rise, 0.0)
    phi[at + 1] = where(v < 0.0, rise, 0.0)


@inline
def nodes(x: Array, v: Array, n: int, a: Array, s: Array, first: int) -> None:
    """Write a (1) of the first `n` nodes, and s (2) to s[first..]; `x` (n_in,), `v` (n_in, >= n).

    `a` (n,) may be `s` (first + n,) itself where `first` is 0.
    """
    for j in range(n):
        total = 0.0
        for i in range(len(x)):
            total += v[i, j] * x[i]
        a[j] = total
        s[first + j] = logistic(total)


@inline
def hidden(x: Array, v: Array, a: Array, phi: Array) -> None:
    """Write a (1), phi[0] = 1, phi[1..n] (2). `x` (n_in,), `v` (n_in, n), `a` (n,).

    `phi`: (n + 1,).
    """
    phi[0] = 1.0
    nodes(x, v, len(a), a, phi, 1)


@inline
def output(phi: Array, w: Array) -> float:
    """Return y (4); `phi` and `w` (n_phi,)."""
    return output_from(0, phi, w)


@inline
def output_from(first: int, phi: Array, w: Array) -> float:
    """Return y (4) of the nodes from `first` on; `phi` (first + n,), `w` (n,)."""
    y = 0.0
    for j in range(len(w)):
        y += w[j] * phi[first + j]
    return y


@inline
def square_sum(w: Array, first: int) -> float:
    """Return the sum of squares of a vector from `first` on."""
    total = 0.0
    for j in range(first, len(w)):
        total += w[j] * w[j]
    return total


@inline
def square_sum_of_rows(v: Array) -> float:
    """Return the sum of squares of a matrix."""
    total = 0.0
    for i in range(len(v)):
        row = v[i]
        for j in range(len(row)):
            total += row[j] * row[j]
    return total


@inline
def norm(w: Array, v: Array) -> float:
    """Return the Frobenius norm of all weights; `w` (n_phi,), `v` (n_in, n)."""
    return sqrt(square_sum(w, 0) + square_sum_of_rows(v))


@inline
def tune(
    net: TwoLayerNetwork, r: float, leak: float, step_f: float, step_fj: float, step_g: float
) -> None:
    """One Euler step of (6) to (9) in place.

    `leak` = kappa |r|; `step_f`, `step_fj`, `step_g` are F, FJ, G times the period.
    """
    x, a, phi, w, v = net.x, net.a, net.phi, net.w, net.v
    n = len(a)
    for j in range(n):
        s = phi[j + 1]
        slope = s * (1.0 - s)
        back = slope * w[j + 1] * r
        for i in range(len(x)):
            v[i, j] += step_g * (x[i] * back - leak * v[i, j])  # (9), W still old
        w[j + 1] += step_f * ((s - slope * a[j]) * r - leak * w[j + 1])  # (7)
    w[0] += step_f * (r - leak * w[0])  # (6)
    for j in range(n + 1, len(w)):
        w[j] += step_fj * (phi[j] * r - leak * w[j])  # (8)


@inline
def scaled(value: float, size: float) -> float:
    """Return value/size within +-3: an entry of x."""
    return clip(value / size, -3.0, 3.0)
