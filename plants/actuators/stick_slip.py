"""Dry friction at a fixed step: the velocity after the step as the solution of an inclusion.

    M v+ + diag(c) Sgn(v+)  contains  p,   c_i = dt level_i(|v_i|),  Sgn(0) = [-1, 1]        (1)
    p = M v + dt (tau - h),   x+ = x + dt v+                                                 (2)

The level is that of the old velocity, so with M > 0 the monotone problem (1) has one solution. A
stuck axis has exactly v+ = 0.0 and holds up to level(0). First order in dt.

    one axis     v+ = soft(p, c)/m,  soft(p, c) = p - clip(p, -c, c)                         (3)
    one sticks   v_i = 0, v_j = soft(p_j, c_j)/m_jj     valid if |p_i - m_ij v_j| <= c_i     (4)
    both slip    v = M^-1 (p - [s_1 c_1; s_2 c_2])      valid if v_i s_i > 0, s_i = +-1      (5)
    both stick   is (4) with v_j = 0

With two axes all six candidates are computed and one is selected, without branches. Where rounding
leaves none valid, the candidate of (4) with the smaller excess is taken. Nothing chatters or
creeps, unlike sgn(v) in an explicit step. p and c are dt times torque, e.g. N m s.

Source: implicit time stepping of set-valued friction, as in J. J. Moreau, Unilateral contact and
dry friction in finite freedom dynamics (1988).
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.executive.laws.emath import clip, where
from pcpc.plants.families.two_link.equations import solved


@inline
def soft(p: float, c: float) -> float:
    """Return (3): `p` shortened by `c` >= 0, exactly 0.0 for |p| <= c."""
    return where(abs(p) <= c, 0.0, p - clip(p, -c, c))


@inline
def velocity(p: float, c: float, m: float) -> float:
    """Return v+ of one axis (3)."""
    return soft(p, c) / m


@inline
def velocities(
    p1: float, p2: float, c1: float, c2: float, m11: float, m12: float, m22: float
) -> tuple[float, float]:
    """Return v+ of two axes (4) (5); M = [m11, m12; m12, m22] positive definite."""
    one = soft(p1, c1) / m11  # (4), axis 2 sticks
    two = soft(p2, c2) / m22  # (4), axis 1 sticks
    excess_2 = abs(p2 - m12 * one) - c2
    excess_1 = abs(p1 - m12 * two) - c1
    first = excess_2 <= excess_1  # the valid one of (4), else the less wrong one
    v1, v2 = where(first, one, 0.0), where(first, 0.0, two)
    slips = (excess_1 > 0.0) & (excess_2 > 0.0)

    for k in range(4):  # (5)
        s1, s2 = 1.0 - 2.0 * (k // 2), 1.0 - 2.0 * (k % 2)
        w1, w2 = solved(m11, m12, m22, p1 - s1 * c1, p2 - s2 * c2)
        valid = slips & (w1 * s1 > 0.0) & (w2 * s2 > 0.0)
        v1, v2 = where(valid, w1, v1), where(valid, w2, v2)
    return v1, v2
