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

from pcpc.drivers.jit import inline
from pcpc.executive.laws.emath import cos


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
