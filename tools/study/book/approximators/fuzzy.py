"""Fuzzy-logic system: product inference, centroid, triangle or tunable Gaussian memberships.

    mu_l  = prod_k MF_r(l,k)(x_k)                    rule l uses set r(l,k) on input k          (1)
    phi_l = mu_l/sum_p mu_p                          fuzzy basis functions, sum 1               (2)
    y_i   = sum_l W_li phi_l                         W: control representative values           (3)

    triangle   centre b_r between its neighbours' on the same input; edges one-sided            (4)
    Gaussian   MF_r(x) = exp(-a_r^2 (x - b_r)^2)                                                (5)
               phi_l by ln mu_l less their largest: no underflow far from all centres           (6)

    dy/dW_l = phi_l                                                                             (7)
    dy/db_r = sum over rules l with r(l,k) = r:  phi_l (W_l - y)   2 a_r^2 (x_k - b_r)          (8)
    dy/da_r = sum over rules l with r(l,k) = r:  phi_l (W_l - y) (-2 a_r (x_k - b_r)^2)         (9)
    |a_r| is kept in a_min..a_max: a flat set (a = 0) has no Jacobian left                     (10)

Sets are numbered through over the inputs. On a full grid of triangles the denominator of (2) is 1
and phi is that of a CMAC. b in the units of the input, a in their inverse. Source: Lewis, Campos,
Selmic (SIAM 2002), chapter 1.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.emath import clip, exp, where


def full_grid(counts: Sequence[int]) -> NDArray[np.float64]:
    """Return r (rules, n) of all combinations, first input slowest; `counts`: sets an input."""
    first = np.concatenate(([0], np.cumsum(counts)[:-1]))
    grids = np.meshgrid(*(np.arange(count) for count in counts), indexing="ij")
    return np.stack([g.ravel() + at for g, at in zip(grids, first, strict=True)], axis=1) * 1.0


@inline
def triangles(x: Array, counts: Array, b: Array, member: Array) -> None:
    """Write the membership (4) of every set: `b`, `member` (sets,); `b` rising on each input.

    `x`, `counts`: (n,).
    """
    at = 0
    for k in range(len(x)):
        count = int(counts[k])
        for j in range(count):
            rise, fall = 1.0, 1.0
            if j > 0:
                rise = (x[k] - b[at + j - 1]) / (b[at + j] - b[at + j - 1])
            if j < count - 1:
                fall = (b[at + j + 1] - x[k]) / (b[at + j + 1] - b[at + j])
            member[at + j] = clip(where(rise < fall, rise, fall), 0.0, 1.0)
        at += count


@inline
def by_product(member: Array, rules: Array, phi: Array) -> None:
    """Write phi (1) (2) from memberships; all 0 where no rule fires. `rules` (rules, n) is r.

    `member`: (sets,), `phi`: (rules,).
    """
    total = 0.0
    for rule in range(len(rules)):
        mu = 1.0
        for k in range(len(rules[rule])):
            mu *= member[int(rules[rule, k])]
        phi[rule] = mu
        total += mu
    for rule in range(len(rules)):
        phi[rule] /= where(total == 0.0, 1.0, total)


@inline
def by_logarithm(x: Array, rules: Array, a: Array, b: Array, phi: Array) -> None:
    """Write phi (1) (2) of Gaussian sets (5) in the form (6): `x` (n,), `a`, `b` (sets,).

    `rules`: (rules, n), `phi`: (rules,).
    """
    largest = -1.0e300
    for rule in range(len(rules)):
        exponent = 0.0
        for k in range(len(x)):
            r = int(rules[rule, k])
            s = a[r] * (x[k] - b[r])
            exponent -= s * s
        phi[rule] = exponent
        largest = where(exponent > largest, exponent, largest)
    total = 0.0
    for rule in range(len(rules)):
        phi[rule] = exp(phi[rule] - largest)
        total += phi[rule]
    for rule in range(len(rules)):
        phi[rule] /= total


@inline
def slopes(
    x: Array,
    rules: Array,
    a: Array,
    b: Array,
    phi: Array,
    c: Array,
    c_mean: float,
    da: Array,
    db: Array,
) -> None:
    """Write d/da, d/db of sum_l c_l phi_l, given its value `c_mean`: (8) (9) for c = a column of W.

    `c`, `phi` (rules,), `a`, `b`, `da`, `db` (sets,), `x` (n,), `rules` (rules, n). For a law
    driven by E: c = W E, c_mean = y'E.
    """
    for r in range(len(a)):
        da[r] = 0.0
        db[r] = 0.0
    for rule in range(len(rules)):
        g = phi[rule] * (c[rule] - c_mean)
        for k in range(len(x)):
            r = int(rules[rule, k])
            distance = x[k] - b[r]
            db[r] += 2.0 * g * a[r] * a[r] * distance
            da[r] -= 2.0 * g * a[r] * distance * distance


@inline
def clamp(a: Array, a_min: float, a_max: float) -> None:
    """Keep |a| (sets,) in a_min..a_max in place (10); the sign stays, a zero becomes a_min."""
    for r in range(len(a)):
        size = clip(abs(a[r]), a_min, a_max)
        a[r] = where(a[r] < 0.0, -size, size)
