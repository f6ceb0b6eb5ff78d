"""The two-link arm with friction as one block: two torques in, samples and truths out.

    M(q) q'' + Vm(q, q') q' + G(q) + F = tau                     two_link.py                 (1)
    friction_model 0   F = 0
                   1   F = level(|v|) Sgn(v), exponential        sliding.py, stick_slip.py   (2)
                   2   F of LuGre, with viscous a2 v             lugre_implicit.py           (3)
    p = M v + dt (tau - h),  h = Vm v + G at the old q, v;  v+ from (2) or (3);  q+ = q + dt v+
                                                                                             (4)
    E = v'M v/2 + (m1 + m2) g a1 sin q1 + m2 g a2 sin(q1 + q2)                               (5)

    call k of `step` at t = k T:  k = 0  samples of the initial state
                                  k > 0  integrates [t - T, t] in whole steps of about `step_s`
                                         under the torque computed from the sample of t - T
                                         (`delay_samples` older ones), then samples

A sample is rounded to a multiple of its `..._lsb_...`, half up; so is the torque that acts. 0 does
not round. In (3) a2 is truly viscous, N m s/rad; in (2) it saturates. E is constant without
friction and torque as dt goes to 0. rad, rad/s, N m, s; positive torque raises q.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 3.
"""

from collections.abc import Mapping
from typing import Any

from pcpc.drivers.jit import inline
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.emath import sin, sincos
from pcpc.executive.laws.models.two_link import gravity_torque, inertia, velocity_torque
from pcpc.plants.actuators import lugre_implicit, sliding, stick_slip
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed

_FRICTION = tuple(
    port
    for i in (1, 2)
    for port in (
        Port(f"coulomb_{i}_Nm", "N m", f"a0 of joint {i}, Coulomb level", None, 0.0, 1e4),
        Port(f"stiction_{i}_Nm", "N m", "a1, what stiction adds to it", None, 0.0, 1e4),
        Port(f"viscous_{i}_Nm", "N m", "a2, saturating; N m s/rad in LuGre", None, 0.0, 1e4),
        Port(f"beta1_{i}_s_rad", "s/rad", "B1, decay of stiction", None, 0.0, 1e6),
        Port(f"beta2_{i}_s_rad", "s/rad", "B2, rise of the viscous part", None, 0.0, 1e6),
    )
)
_SHARED = (
    Port("a1_m", "m", "length of link 1", None, 1e-3, 100.0),
    Port("a2_m", "m", "length of link 2", None, 1e-3, 100.0),
    Port("m1_kg", "kg", "point mass at the end of link 1", None, 1e-3, 1e4),
    Port("m2_kg", "kg", "point mass at the end of link 2", None, 1e-3, 1e4),
    Port("gravity_m_s2", "m/s2", "g; 0 for an arm in a horizontal plane", None, -100.0, 100.0),
    Port("friction_model", "", "0 none, 1 exponential set-valued, 2 LuGre", None, 0.0, 2.0),
    *_FRICTION,
    Port("s0_Nm_rad", "N m/rad", "stiffness of the bristles, LuGre", None, 1e-6, 1e9),
    Port("s1_Nms_rad", "N m s/rad", "damping of the bristles, LuGre", None, 0.0, 1e6),
    Port("v0_rad_s", "rad/s", "Stribeck speed, LuGre", None, 1e-6, 1e3),
    Port("delay_samples", "", "age of the torque that acts, whole", 0.0, 0.0, DELAY_SIZE - 1.0),
    Port("torque_lsb_Nm", "N m", "quantum of the torque that acts, 0 none", 0.0, 0.0, 1e3),
    Port("position_lsb_rad", "rad", "quantum of the position samples, 0 none", 0.0, 0.0, 1.0),
    Port("rate_lsb_rad_s", "rad/s", "quantum of the rate samples, 0 none", 0.0, 0.0, 10.0),
)
PARAMETERS = (*_SHARED, Port("substeps", "", "integration steps a period"))
SETTINGS = (
    *_SHARED,
    Port("step_s", "s", "integration step, made to fit a period", None, 1e-7, 1.0),
    Port("start_1_rad", "rad", "q1 at the start, at rest", 0.0, -10.0, 10.0),
    Port("start_2_rad", "rad", "q2 at the start, at rest", 0.0, -10.0, 10.0),
)
STATES = (
    Port("x_q_1_rad", "rad", "q1"),
    Port("x_q_2_rad", "rad", "q2"),
    Port("x_v_1_rad_s", "rad/s", "q1'"),
    Port("x_v_2_rad_s", "rad/s", "q2'"),
    Port("x_z_1_rad", "rad", "bristles of joint 1, LuGre"),
    Port("x_z_2_rad", "rad", "bristles of joint 2, LuGre"),
    Port("x_friction_1_Nm", "N m", "F1 of the last step"),
    Port("x_friction_2_Nm", "N m", "F2 of the last step"),
    Port("held_1", "N m", "torques of joint 1 on their way", size=DELAY_SIZE, recorded=False),
    Port("held_2", "N m", "torques of joint 2 on their way", size=DELAY_SIZE, recorded=False),
)
INPUTS = (
    Port("torque_1_Nm", "N m", "newest valid command to joint 1", 0.0),
    Port("torque_2_Nm", "N m", "newest valid command to joint 2", 0.0),
)
OUTPUTS = (
    Port("sample_1_rad", "rad", "sensor: q1"),
    Port("sample_2_rad", "rad", "sensor: q2"),
    Port("rate_sample_1_rad_s", "rad/s", "sensor: q1'"),
    Port("rate_sample_2_rad_s", "rad/s", "sensor: q2'"),
    Port("q_1_rad", "rad", "true q1"),
    Port("q_2_rad", "rad", "true q2"),
    Port("rate_1_rad_s", "rad/s", "true q1'"),
    Port("rate_2_rad_s", "rad/s", "true q2'"),
    Port("acting_1_Nm", "N m", "torque on joint 1 up to this sample"),
    Port("acting_2_Nm", "N m", "torque on joint 2 up to this sample"),
    Port("friction_1_Nm", "N m", "friction torque F1, opposes the motion"),
    Port("friction_2_Nm", "N m", "friction torque F2, opposes the motion"),
)
(A1, A2, M1, M2, G, FRICTION_MODEL) = range(6)
LEVEL_1, LEVEL_2 = 6, 11  # a0, a1, a2, B1, B2 of each joint
(S0, S1, V0, DELAY, TORQUE_LSB, POSITION_LSB, RATE_LSB, SUBSTEPS) = range(16, 24)
(Q1, Q2, RATE1, RATE2, Z1, Z2, F1, F2, HELD_1) = range(9)
HELD_2 = HELD_1 + DELAY_SIZE
NONE, SET_VALUED, LUGRE = 0.0, 1.0, 2.0


@inline
def level(speed: float, p: Any, at: int) -> float:
    """Return the friction level (2) of the joint whose parameters begin at p[at], N m."""
    return sliding.exponential(speed, p[at], p[at + 1], p[at + 2], p[at + 3], p[at + 4])


@inline
def set_valued(
    p1: float, p2: float, m11: float, m12: float, m22: float, dt: float, p: Any, x: Any
) -> tuple[float, float]:
    """Return v+ of (2); without friction both levels are 0."""
    c1, c2 = 0.0, 0.0
    if p[FRICTION_MODEL] == SET_VALUED:
        c1, c2 = dt * level(abs(x[RATE1]), p, LEVEL_1), dt * level(abs(x[RATE2]), p, LEVEL_2)
    return stick_slip.velocities(p1, p2, c1, c2, m11, m12, m22)


@inline
def lugre(
    p1: float, p2: float, m11: float, m12: float, m22: float, dt: float, p: Any, x: Any
) -> tuple[float, float]:
    """Return v+ of (3) and advance the bristles."""
    s0, s1, v0 = p[S0], p[S1], p[V0]
    rate_1 = lugre_implicit.bristle_rate(x[RATE1], s0, p[LEVEL_1], p[LEVEL_1 + 1], v0)
    rate_2 = lugre_implicit.bristle_rate(x[RATE2], s0, p[LEVEL_2], p[LEVEL_2 + 1], v0)
    slope_1, offset_1 = lugre_implicit.torque_line(x[Z1], rate_1, s0, s1, p[LEVEL_1 + 2], dt)
    slope_2, offset_2 = lugre_implicit.torque_line(x[Z2], rate_2, s0, s1, p[LEVEL_2 + 2], dt)
    v1, v2 = lugre_implicit.velocities(
        p1 - dt * offset_1, p2 - dt * offset_2, slope_1, slope_2, m11, m12, m22, dt
    )
    x[Z1] = lugre_implicit.bristle(x[Z1], v1, rate_1, dt)
    x[Z2] = lugre_implicit.bristle(x[Z2], v2, rate_2, dt)
    return v1, v2


@inline
def advance(tau1: float, tau2: float, dt: float, p: Any, x: Any) -> None:
    """One step (4) of positions, rates, bristles and friction torques under a constant torque."""
    sin_q2, cos_q2 = sincos(x[Q2])
    a1, a2, m1, m2 = p[A1], p[A2], p[M1], p[M2]
    m11, m12, m22 = inertia(cos_q2, a1, a2, m1, m2)
    c1, c2 = velocity_torque(m2 * a1 * a2 * sin_q2, x[RATE1], x[RATE2])
    g1, g2 = gravity_torque(x[Q1], x[Q2], a1, a2, m1, m2, p[G])
    p1 = m11 * x[RATE1] + m12 * x[RATE2] + dt * (tau1 - c1 - g1)
    p2 = m12 * x[RATE1] + m22 * x[RATE2] + dt * (tau2 - c2 - g2)
    if p[FRICTION_MODEL] == LUGRE:
        v1, v2 = lugre(p1, p2, m11, m12, m22, dt, p, x)
    else:
        v1, v2 = set_valued(p1, p2, m11, m12, m22, dt, p, x)
    x[F1] = (p1 - m11 * v1 - m12 * v2) / dt
    x[F2] = (p2 - m12 * v1 - m22 * v2) / dt
    x[RATE1] = v1
    x[RATE2] = v2
    x[Q1] += dt * v1
    x[Q2] += dt * v2


@inline
def energy(p: Any, x: Any) -> float:
    """Return E of (5), J."""
    a1, a2, m1, m2 = p[A1], p[A2], p[M1], p[M2]
    m11, m12, m22 = inertia(sincos(x[Q2])[1], a1, a2, m1, m2)
    v1, v2 = x[RATE1], x[RATE2]
    moving = 0.5 * (m11 * v1 * v1 + m22 * v2 * v2) + m12 * v1 * v2
    outer = m2 * p[G] * a2 * sin(x[Q1] + x[Q2])
    return moving + (m1 + m2) * p[G] * a1 * sin(x[Q1]) + outer


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Advance to t, sample; see the module header."""
    if t > 0.0:
        y[8] = rounded(delayed(u[0], p[DELAY], x, HELD_1), p[TORQUE_LSB])
        y[9] = rounded(delayed(u[1], p[DELAY], x, HELD_2), p[TORQUE_LSB])
        for _ in range(int(p[SUBSTEPS])):
            advance(y[8], y[9], dt / p[SUBSTEPS], p, x)
    for i in range(2):
        y[i] = rounded(x[Q1 + i], p[POSITION_LSB])
        y[2 + i] = rounded(x[RATE1 + i], p[RATE_LSB])
        y[4 + i] = x[Q1 + i]
        y[6 + i] = x[RATE1 + i]
        y[10 + i] = x[F1 + i]


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters, with the steps a period, and the arm at rest at its start."""
    shared = {port.name: settings[port.name] for port in _SHARED}
    substeps = max(1, round(1.0 / (rate_hz * settings["step_s"])))
    states = {"x_q_1_rad": settings["start_1_rad"], "x_q_2_rad": settings["start_2_rad"]}
    return Prepared({**shared, "substeps": float(substeps)}, states)


BLOCK = Block(
    step,
    inputs=INPUTS,
    outputs=OUTPUTS,
    parameters=PARAMETERS,
    states=STATES,
    settings=SETTINGS,
    prepare=prepare,
)
