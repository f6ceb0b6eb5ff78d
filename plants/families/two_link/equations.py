"""The planar two-link arm: point masses at the link ends, angles from the horizontal, q2 relative.

    M(q) q'' + Vm(q, q') q' + G(q) = tau                                                     (1)
    M11 = (m1 + m2) a1^2 + m2 a2^2 + 2 m2 a1 a2 cos q2
    M12 = M21 = m2 a2^2 + m2 a1 a2 cos q2,   M22 = m2 a2^2                                   (2)
    Vm  = [-h q2', -h (q1' + q2'); h q1', 0],  h = m2 a1 a2 sin q2                           (3)
    G   = [(m1 + m2) g a1 cos q1 + m2 g a2 cos(q1 + q2); m2 g a2 cos(q1 + q2)]               (4)

M' - 2 Vm is skew-symmetric with this choice of Vm, which the proofs of the laws need; rad, kg, m,
N m. `a` are the link lengths, `m` the masses. Source: Lewis, Campos, Selmic (SIAM 2002), the arm of
chapters 3, 4 and 7, in the usual textbook form.
"""

from typing import Protocol

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.emath import cos, sincos
from pcpc.executive.laws.ports import Ports, port


class Links(Ports):
    """Of an arm: lengths and masses."""

    a1_m = port("m", "length of link 1", None, 1e-3, 100.0)
    a2_m = port("m", "length of link 2", None, 1e-3, 100.0)
    m1_kg = port("kg", "point mass at the end of link 1", None, 1e-3, 1e4)
    m2_kg = port("kg", "point mass at the end of link 2", None, 1e-3, 1e4)


class LinksLike(Protocol):
    """What `motion` takes of an arm, whose outer mass may change."""

    a1_m: float
    a2_m: float
    m1_kg: float


@inline
def inertia(
    cos_q2: float, a1: float, a2: float, m1: float, m2: float
) -> tuple[float, float, float]:
    """Return M11, M12, M22 of (2), kg m^2."""
    far, cross = m2 * a2 * a2, m2 * a1 * a2 * cos_q2
    return (m1 + m2) * a1 * a1 + far + 2.0 * cross, far + cross, far


@inline
def velocity_torque(h: float, v1: float, v2: float) -> tuple[float, float]:
    """Return Vm q' of (3), N m; h = m2 a1 a2 sin q2."""
    return -h * (2.0 * v1 * v2 + v2 * v2), h * v1 * v1


@inline
def gravity_torque(
    q1: float, q2: float, a1: float, a2: float, m1: float, m2: float, g: float
) -> tuple[float, float]:
    """Return G of (4), N m."""
    outer = m2 * g * a2 * cos(q1 + q2)
    return (m1 + m2) * g * a1 * cos(q1) + outer, outer


@inline
def motion(p: LinksLike, m2: float, q: Array, v: Array) -> tuple[float, float, float, float, float]:
    """Return M11, M12, M22 of (2) and Vm q' of (3); `v` is q'. `q`, `v`: (2,)."""
    sine, cosine = sincos(q[1])
    m11, m12, m22 = inertia(cosine, p.a1_m, p.a2_m, p.m1_kg, m2)
    c1, c2 = velocity_torque(m2 * p.a1_m * p.a2_m * sine, v[0], v[1])
    return m11, m12, m22, c1, c2


@inline
def inertia_times(m11: float, m12: float, m22: float, a1: float, a2: float) -> tuple[float, float]:
    """Return M a."""
    return m11 * a1 + m12 * a2, m12 * a1 + m22 * a2


@inline
def solved(m11: float, m12: float, m22: float, b1: float, b2: float) -> tuple[float, float]:
    """Return M^-1 b."""
    determinant = m11 * m22 - m12 * m12
    return (m22 * b1 - m12 * b2) / determinant, (m11 * b2 - m12 * b1) / determinant
