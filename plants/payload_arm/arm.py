"""The two-link arm with gravity and smooth friction: its acceleration and a Runge-Kutta step.

    M(q) q'' + Vm(q, q') q' + G(q) + Fr = tau                executive/laws/models/two_link.py   (1)
    Fr_i = fv q_i' + fc tanh(q_i'/w)                         smooth: nothing ever sticks     (2)

Classic Runge-Kutta with tau and the masses held over the step. `p` begins with PORTS; the masses
are arguments, so that a plant may change them between steps. Its local error in the neighbourhood
of q' = 0 wants h well below w M/fc. rad, rad/s, N m, kg, m, s; positive torque raises q.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 7.
"""

from typing import Any

from pcpc.drivers.jit import inline
from pcpc.executive.laws.block import Port
from pcpc.executive.laws.emath import sincos, tanh
from pcpc.executive.laws.models.two_link import gravity_torque, inertia, velocity_torque

PORTS = (
    Port("a1_m", "m", "length of the first link", None, 1e-3, 100.0),
    Port("a2_m", "m", "length of the second link", None, 1e-3, 100.0),
    Port("gravity_m_s2", "m/s2", "g; 0 for an arm in a horizontal plane", None, -100.0, 100.0),
    Port("viscous_Nms_rad", "N m s/rad", "fv of both joints", None, 0.0, 1e4),
    Port("coulomb_Nm", "N m", "fc of both joints", None, 0.0, 1e4),
    Port("smooth_rad_s", "rad/s", "w, where fc is at 0.76 of its height", None, 1e-3, 10.0),
)
(A1, A2, G, VISCOUS, COULOMB, SMOOTH) = range(len(PORTS))


@inline
def friction(p: Any, v: float) -> float:
    """Return Fr_i of (2), N m."""
    return p[VISCOUS] * v + p[COULOMB] * tanh(v / p[SMOOTH])


@inline
def acceleration(
    p: Any, m1: float, m2: float, q1: float, q2: float, v1: float, v2: float,
    tau1: float, tau2: float,
) -> tuple[float, float]:  # fmt: skip
    """Return q'' of (1), rad/s2."""
    sine, cosine = sincos(q2)
    m11, m12, m22 = inertia(cosine, p[A1], p[A2], m1, m2)
    c1, c2 = velocity_torque(m2 * p[A1] * p[A2] * sine, v1, v2)
    g1, g2 = gravity_torque(q1, q2, p[A1], p[A2], m1, m2, p[G])
    b1 = tau1 - c1 - g1 - friction(p, v1)
    b2 = tau2 - c2 - g2 - friction(p, v2)
    determinant = m11 * m22 - m12 * m12
    return (m22 * b1 - m12 * b2) / determinant, (m11 * b2 - m12 * b1) / determinant


@inline
def advance(p: Any, m1: float, m2: float, h: float, tau1: float, tau2: float, x: Any) -> None:
    """Advance q1, q2, q1', q2' in x[0..3] by one step of `h` s."""
    q1, q2, v1, v2 = x[0], x[1], x[2], x[3]
    half = 0.5 * h
    a1, a2 = acceleration(p, m1, m2, q1, q2, v1, v2, tau1, tau2)
    w1, w2 = v1 + half * a1, v2 + half * a2
    b1, b2 = acceleration(p, m1, m2, q1 + half * v1, q2 + half * v2, w1, w2, tau1, tau2)
    y1, y2 = v1 + half * b1, v2 + half * b2
    c1, c2 = acceleration(p, m1, m2, q1 + half * w1, q2 + half * w2, y1, y2, tau1, tau2)
    z1, z2 = v1 + h * c1, v2 + h * c2
    d1, d2 = acceleration(p, m1, m2, q1 + h * y1, q2 + h * y2, z1, z2, tau1, tau2)
    x[0] = q1 + h / 6.0 * (v1 + 2.0 * w1 + 2.0 * y1 + z1)
    x[1] = q2 + h / 6.0 * (v2 + 2.0 * w2 + 2.0 * y2 + z2)
    x[2] = v1 + h / 6.0 * (a1 + 2.0 * b1 + 2.0 * c1 + d1)
    x[3] = v2 + h / 6.0 * (a2 + 2.0 * b2 + 2.0 * c2 + d2)
