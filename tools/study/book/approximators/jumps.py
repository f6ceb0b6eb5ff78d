"""Jump basis functions, and the neural network augmented with them.

    z = x_1 - c or another V_2'[1; x]      jump at z = 0                                        (1)
    polynomial   f_k(z)   = z^k               for z >= 0, else 0     unbounded: off-line only   (2)
    sigmoid      phi_k(z) = (1 - exp(-z))^k   for z >= 0, else 0     in 0..1                    (3)
    tanh         phi_k(z) = tanh(z)^k         for z >= 0, else 0     in 0..1                    (4)
    k = 0: the unit step, 1 at z = 0 (right-continuous); only it jumps, k = 1 has a kink        (5)
    y = W_1'[1; sigma(V_1'[1; x])] + W_2'phi(V_2'[1; x])    V_2 fixed, V_1, W_1, W_2 tuned      (6)

A sum of a_k f_k is one of b_k phi_k up to a remainder of order z^(N+1) (Lemma 3.1.4):

    b_0 = a_0,  b_k = a_k - sum_m=1..k-1 b_m sum_i=0..m C(m,i) (-1)^(i+k) i^k/k!                (7)

(3) is computed as 2t/(1 + t), t = tanh(z/2): exact to the last digits near z = 0. z without unit.
Nodes with fixed V_2 along one input make a jump whose height is the same all along the hyperplane;
nodes at the wrong c do nothing. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 3.
"""

import math
from collections.abc import Sequence

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.emath import tanh, where

POLYNOMIAL, SIGMOID, TANH = range(3)
NAMES = ("polynomial", "sigmoid", "tanh")


@inline
def jump_nodes(kind: int, z: float, count: int, phi: Array, at: int) -> None:
    """Write the basis functions k = 0 .. count - 1 of z, (2) to (5), to phi[at..].

    `phi`: (at + count,) or longer.
    """
    base = z
    if kind == SIGMOID:
        t = tanh(0.5 * where(z < 0.0, 0.0, z))
        base = 2.0 * t / (1.0 + t)
    if kind == TANH:
        base = tanh(z)
    power = where(z < 0.0, 0.0, 1.0)
    for k in range(count):
        phi[at + k] = power
        power = where(z < 0.0, 0.0, power * base)


def sigmoid_coefficients(a: Sequence[float]) -> list[float]:
    """Return b of (7), coefficients of the sigmoid basis, from those of the polynomial one."""
    b = [float(a[0])]
    for k in range(1, len(a)):
        known = sum(b[m] * _taylor(m, k) for m in range(1, k))
        b.append(float(a[k]) - known)
    return b


def _taylor(m: int, k: int) -> float:
    """Return the coefficient of z^k in (1 - exp(-z))^m."""
    terms = (math.comb(m, i) * (-1) ** (i + k) * i**k for i in range(m + 1))
    return sum(terms) / math.factorial(k)
