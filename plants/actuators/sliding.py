"""Static friction: the level of the torque that opposes sliding, as a function of the speed |v|.

    F = level(|v|) Sgn(v),  Sgn(0) = [-1, 1]                                                 (1)
    Coulomb       level = a                                                                  (2)
    viscous       level = a + b |v|                                                          (3)
    empirical     level = a + b exp(-c |v|) + d |v|                                          (4)
    exponential   level = a0 + a1 exp(-B1 |v|) + a2 (1 - exp(-B2 |v|))                       (5)

At rest F takes any value up to the break-away torque level(0): a + b of (4), a0 + a1 of (5). In (4)
a is the Coulomb level, b the excess of stiction, c its decay, d viscous. In (5) a2 grows with speed
and saturates. rad/s, N m. Do not call sgn(v) with these in a step that integrates: see
stick_slip.py.

Source: Lewis, Campos, Selmic (SIAM 2002), chapter 2; the formulas of (4) and (5) are lost in the
available copies, (5) follows the book's list of symbols, the roles in (4) are chosen.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.executive.laws.emath import exp


@inline
def coulomb(a: float) -> float:
    """Return the level of (2), N m."""
    return a


@inline
def viscous(speed: float, a: float, b: float) -> float:
    """Return the level of (3), N m; `speed` >= 0, `b` in N m s/rad."""
    return a + b * speed


@inline
def empirical(speed: float, a: float, b: float, c: float, d: float) -> float:
    """Return the level of (4), N m; `speed` >= 0, `c` in s/rad, `d` in N m s/rad."""
    return a + b * exp(-c * speed) + d * speed


@inline
def exponential(speed: float, a0: float, a1: float, a2: float, beta1: float, beta2: float) -> float:
    """Return the level of (5), N m; `speed` >= 0, `beta1` and `beta2` in s/rad."""
    return a0 + a1 * exp(-beta1 * speed) + a2 * (1.0 - exp(-beta2 * speed))
