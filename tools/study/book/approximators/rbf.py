"""Radial basis functions: Gaussian nodes on a grid with one-sided edges, or scattered with full P.

    phi_j = exp(-(x - mu_j)' P_j^-1 (x - mu_j)/2)              P_j: variances, not widths       (1)
    grid:  phi_j = prod_k exp(-(x_k - mu_jk)^2/(2 p_k))        first input slowest              (2)
    edges: a node of the outermost centre is 1 beyond it       one-sided                        (3)
    p_k = d_k^2/(8 ln 2)                                       neighbours cross at 1/2          (4)
    y = W'phi, W <- W + F phi E'                               backprop.output, .tune_output    (5)

d_k is the spacing of the n_k centres on axis k. On a grid of 5 x 5, 9 nodes are full Gaussians.
x and mu in the units of the input, P in their squares. Source: Lewis, Campos, Selmic (SIAM 2002),
chapter 1; (4) is chosen.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.emath import exp, expmsq, where

CROSSING = 1.6651092223153954  # sqrt(4 ln 2): (x/d CROSSING)^2 = x^2/(2 p) with (4)


@inline
def gaussian_axis(x: float, low: float, d: float, count: int, at: int, out: Array) -> None:
    """Write the factors (2) (3) (4) of one axis to out[at..]; centres low, low + d, ...

    `out`: (at + count,) or longer.
    """
    for j in range(count):
        r = (x - (low + j * d)) / d
        if j == 0:
            r = where(r < 0.0, 0.0, r)
        if j == count - 1:
            r = where(r > 0.0, 0.0, r)
        out[at + j] = expmsq(CROSSING * r)


@inline
def products(factors: Array, counts: Array, phi: Array) -> None:
    """Write the product of one factor an axis for every node, first input slowest.

    `factors` (sum of counts,), `counts` (n,) whole numbers, `phi` (product of counts,).
    """
    phi[0] = 1.0
    size, at = 1, 0
    for k in range(len(counts)):
        count = int(counts[k])
        for j in range(size - 1, -1, -1):  # backwards: phi grows in place
            value = phi[j]
            for i in range(count):
                phi[j * count + i] = value * factors[at + i]
        size *= count
        at += count


@inline
def grid(x: Array, low: Array, d: Array, counts: Array, factors: Array, phi: Array) -> None:
    """Write phi (2); `x`, `low`, `d`, `counts` (n,), `factors` (sum of counts,) is scratch.

    `phi`: (product of counts,).
    """
    at = 0
    for k in range(len(x)):
        count = int(counts[k])
        gaussian_axis(x[k], low[k], d[k], count, at, factors)
        at += count
    products(factors, counts, phi)


@inline
def scattered(x: Array, centres: Array, precisions: Array, phi: Array) -> None:
    """Write phi (1): `centres` (nodes, n), `precisions` (nodes, n, n) the P_j^-1.

    `x`: (n,), `phi`: (nodes,).
    """
    n = len(x)
    for j in range(len(phi)):
        total = 0.0
        for i in range(n):
            for k in range(n):
                di, dk = x[i] - centres[j, i], x[k] - centres[j, k]
                total += di * precisions[j, i, k] * dk
        phi[j] = exp(-0.5 * total)
