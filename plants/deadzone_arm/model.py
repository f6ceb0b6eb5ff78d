"""The two-link arm with a deadzone in front of each joint: commands in, angles and rates out.

    M(q) v' + Vm(q, v) v = tau,   q' = v         executive/laws/models/two_link.py, horizontal   (1)
    tau_i = D(u_i)                                plants/actuators/deadzone.py, unmeasured   (2)
    E = v'M(q)v/2,   E' = v'tau                   for M' - 2 Vm is skew-symmetric            (3)

    call k of `step` at t = k dt:  k = 0  samples of the initial state; nothing else happens
                                   k > 0  tau from the command of `delay_samples` calls before,
                                          integrate [t - dt, t] with tau held, sample at t

So with `delay_samples` 0 the command that was computed from the sample at t - dt acts from t - dt
on. Classic Runge-Kutta, `substeps` equal steps. A resolution of 0 means none. rad, rad/s, N m, kg,
m, J; no gravity, friction or disturbance.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.2; the arm's equations as in executive/models.
"""

from typing import Any

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.block import Block, Port, stage
from pcpc.executive.laws.emath import sincos
from pcpc.executive.laws.models.two_link import inertia, velocity_torque
from pcpc.plants.actuators.deadzone import deadzone
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed

SETTINGS = (
    Port("a1_m", "m", "length of the first link", None, 1e-3, 100.0),
    Port("a2_m", "m", "length of the second link", None, 1e-3, 100.0),
    Port("m1_kg", "kg", "mass at the end of the first link", None, 1e-3, 1e4),
    Port("m2_kg", "kg", "mass at the end of the second link", None, 1e-3, 1e4),
    Port("d_plus_Nm", "N m", "width of the deadzones on the positive side", None, 0.0, 1e3),
    Port("d_minus_Nm", "N m", "width on the negative side, a magnitude", None, 0.0, 1e3),
    Port("m_plus", "", "slope on the positive side", None, 1e-3, 1e3),
    Port("m_minus", "", "slope on the negative side", None, 1e-3, 1e3),
    Port("substeps", "", "Runge-Kutta steps a period", None, 1.0, 1000.0),
    Port("delay_samples", "", "whole samples of transport", 0.0, 0.0, DELAY_SIZE - 1.0),
    Port("q_lsb_rad", "rad", "resolution of the angle sensors", 0.0, 0.0, 1.0),
    Port("v_lsb_rad_s", "rad/s", "resolution of the rate sensors", 0.0, 0.0, 10.0),
    Port("u_lsb_Nm", "N m", "resolution of the commands", 0.0, 0.0, 10.0),
)
(A1, A2, M1, M2, D_PLUS, D_MINUS, M_PLUS, M_MINUS, SUBSTEPS, DELAY, Q_LSB, V_LSB, U_LSB) = range(
    len(SETTINGS)
)
INPUTS = (
    Port("u1_Nm", "N m", "newest command of joint 1"),
    Port("u2_Nm", "N m", "newest command of joint 2"),
)
OUTPUTS = (
    Port("q1_rad", "rad", "sample of the first angle"),
    Port("q2_rad", "rad", "sample of the second angle, relative to the first link"),
    Port("v1_rad_s", "rad/s", "sample of the first rate"),
    Port("v2_rad_s", "rad/s", "sample of the second rate"),
    Port("true_q1_rad", "rad", "first angle"),
    Port("true_q2_rad", "rad", "second angle"),
    Port("true_v1_rad_s", "rad/s", "first rate"),
    Port("true_v2_rad_s", "rad/s", "second rate"),
    Port("tau1_Nm", "N m", "torque on joint 1 in the period that ends here"),
    Port("tau2_Nm", "N m", "torque on joint 2 in the period that ends here"),
    Port("energy_J", "J", "kinetic energy (3)"),
)
STATES = (
    Port("x_q1_rad", "rad", "first angle", 0.0),
    Port("x_q2_rad", "rad", "second angle", 0.0),
    Port("x_v1_rad_s", "rad/s", "first rate", 0.0),
    Port("x_v2_rad_s", "rad/s", "second rate", 0.0),
    Port("sent1", "N m", "commands of joint 1 on their way", size=DELAY_SIZE, recorded=False),
    Port("sent2", "N m", "commands of joint 2 on their way", size=DELAY_SIZE, recorded=False),
)
SENT_1, SENT_2 = 4, 4 + DELAY_SIZE


@inline
def acceleration(
    p: Any, q2: float, v1: float, v2: float, tau1: float, tau2: float
) -> tuple[float, float]:
    """Return v' of (1), rad/s2."""
    sine, cosine = sincos(q2)
    m11, m12, m22 = inertia(cosine, p[A1], p[A2], p[M1], p[M2])
    c1, c2 = velocity_torque(p[M2] * p[A1] * p[A2] * sine, v1, v2)
    b1, b2 = tau1 - c1, tau2 - c2
    determinant = m11 * m22 - m12 * m12
    return (m22 * b1 - m12 * b2) / determinant, (m11 * b2 - m12 * b1) / determinant


@inline
def integrate(p: Any, x: Any, h: float, tau1: float, tau2: float) -> None:
    """Advance q1, q2, v1, v2 in `x` by `substeps` steps of `h` s."""
    for _ in range(int(p[SUBSTEPS])):
        q1, q2, v1, v2 = x[0], x[1], x[2], x[3]
        half = 0.5 * h
        a1, a2 = acceleration(p, q2, v1, v2, tau1, tau2)
        w1, w2 = v1 + half * a1, v2 + half * a2
        b1, b2 = acceleration(p, q2 + half * v2, w1, w2, tau1, tau2)
        y1, y2 = v1 + half * b1, v2 + half * b2
        c1, c2 = acceleration(p, q2 + half * w2, y1, y2, tau1, tau2)
        z1, z2 = v1 + h * c1, v2 + h * c2
        d1, d2 = acceleration(p, q2 + h * y2, z1, z2, tau1, tau2)
        x[0] = q1 + h / 6.0 * (v1 + 2.0 * w1 + 2.0 * y1 + z1)
        x[1] = q2 + h / 6.0 * (v2 + 2.0 * w2 + 2.0 * y2 + z2)
        x[2] = v1 + h / 6.0 * (a1 + 2.0 * b1 + 2.0 * c1 + d1)
        x[3] = v2 + h / 6.0 * (a2 + 2.0 * b2 + 2.0 * c2 + d2)


@inline
def torque(u: float, p: Any, x: Any, at: int) -> float:
    """Put a command into its register x[at...] and return the torque that now acts (2)."""
    due = delayed(rounded(u, p[U_LSB]), p[DELAY], x, at)
    return deadzone(due, p[D_PLUS], p[D_MINUS], p[M_PLUS], p[M_MINUS])


@inline
def kinetic_energy(p: Any, q2: float, v1: float, v2: float) -> float:
    """Return E of (3), J."""
    _, cosine = sincos(q2)
    m11, m12, m22 = inertia(cosine, p[A1], p[A2], p[M1], p[M2])
    return 0.5 * (m11 * v1 * v1 + 2.0 * m12 * v1 * v2 + m22 * v2 * v2)


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Advance the arm from t - dt to t and sample it; at t = 0 only sample."""
    truth = tail(y, 4)
    if t > 0.0:
        truth[4] = torque(u[0], p, x, SENT_1)
        truth[5] = torque(u[1], p, x, SENT_2)
        integrate(p, x, dt / p[SUBSTEPS], truth[4], truth[5])
    for i in range(2):
        y[i] = rounded(x[i], p[Q_LSB])
        y[2 + i] = rounded(x[2 + i], p[V_LSB])
    for i in range(4):
        truth[i] = x[i]
    truth[6] = kinetic_energy(p, x[1], x[2], x[3])


BLOCK = Block(step, inputs=INPUTS, outputs=OUTPUTS, states=STATES, settings=SETTINGS)
