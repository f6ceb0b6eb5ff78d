"""LuGre friction at a fixed step: linearly implicit, stable for bristles of any stiffness.

    z' = v - |v|/g(v) z,   g(v) = (a0 + a1 exp(-(v/v0)^2))/s0                                (1)
    F  = s0 z + s1 z' + a2 v                                                                 (2)

With a = |v|/g(v) at the old velocity, z+ = z + dt (v+ - a z+) and F from v+ and z+:

    z+ = (z + dt v+)/(1 + dt a)                                                              (3)
    F  = A v+ + B                                                                            (4)
    A  = (s0 dt + s1)/(1 + dt a) + a2,   B = (s0 - s1 a) z/(1 + dt a)                        (5)
    (M + dt diag(A)) v+ = M v + dt (tau - h - B),   x+ = x + dt v+                           (6)

One or two coupled axes; rad, rad/s, N m, s. First order in dt. |z| <= (a0 + a1)/s0 holds up to a
term of second order in dt, as a is that of the old velocity. friction.py has the same model for a
Runge-Kutta step.

Source: Canudas de Wit, Olsson, Astrom, Lischinsky, A new model for control of systems with
friction, IEEE Trans. Automatic Control 40 (1995); the scheme is this project's.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.executive.laws.emath import expmsq
from pcpc.plants.families.two_link.equations import solved


@inline
def bristle_rate(v: float, s0: float, a0: float, a1: float, v0: float) -> float:
    """Return a = |v|/g(v) of (1), 1/s; `v0` > 0."""
    return s0 * abs(v) / (a0 + a1 * expmsq(v / v0))


@inline
def torque_line(
    z: float, a: float, s0: float, s1: float, a2: float, dt: float
) -> tuple[float, float]:
    """Return A and B of (5), N m s/rad and N m; `a` from `bristle_rate`."""
    fade = 1.0 + dt * a
    return (s0 * dt + s1) / fade + a2, (s0 - s1 * a) * z / fade


@inline
def bristle(z: float, v_new: float, a: float, dt: float) -> float:
    """Return z+ of (3), rad."""
    return (z + dt * v_new) / (1.0 + dt * a)


@inline
def velocity(p: float, slope: float, offset: float, m: float, dt: float) -> float:
    """Return v+ of one axis (6); `p` = m v + dt (tau - h), `slope` A and `offset` B."""
    return (p - dt * offset) / (m + dt * slope)


@inline
def velocities(
    r1: float,
    r2: float,
    slope_1: float,
    slope_2: float,
    m11: float,
    m12: float,
    m22: float,
    dt: float,
) -> tuple[float, float]:
    """Return v+ of two axes (6); `r_i` = p_i - dt B_i, `slope_i` A_i."""
    return solved(m11 + dt * slope_1, m12, m22 + dt * slope_2, r1, r2)
