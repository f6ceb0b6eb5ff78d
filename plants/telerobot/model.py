"""The telerobot's arm as one block: two links, friction, a payload that comes and goes.

    M(q) q'' + Vm(q, q') q' + G(q) + Fr = tau                    two_link.py                 (1)
    Fr_i = fv q_i' + fc tanh(q_i'/0.05)                                                      (2)
    m2 = load_kg for load_from <= t < load_to, else m2_kg; it changes at samples             (3)
    q'' = M^-1 (tau - Vm q' - G - Fr), classic Runge-Kutta, fixed step                       (4)
    E = v'M v/2 + (m1 + m2) g a1 sin q1 + m2 g a2 sin(q1 + q2)                               (5)

    call k of `step` at t = k T:  k = 0  samples of the initial state
                                  k > 0  integrates [t - T, t] in `substeps` steps under the
                                         torque computed from the sample of t - T
                                         (`delay_samples` older ones), then samples

A sample is rounded to a multiple of its `..._lsb_...`, half up; so is the torque that acts. 0 does
not round. rad, rad/s, N m, s; angles from the horizontal, q2 relative to link 1; positive torque
raises q. Source: Lewis, Campos, Selmic (SIAM 2002), chapters 7 and 8.
"""

from collections.abc import Mapping
from typing import Any

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.emath import sin, sincos, tanh, where
from pcpc.executive.laws.models.two_link import gravity_torque, inertia, velocity_torque
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed

STICTION_RAD_S = 0.05

PARAMETERS = (
    Port("a1_m", "m", "length of link 1", None, 1e-3, 100.0),
    Port("a2_m", "m", "length of link 2", None, 1e-3, 100.0),
    Port("m1_kg", "kg", "point mass at the end of link 1", None, 1e-3, 1e4),
    Port("m2_kg", "kg", "point mass at the end of link 2", None, 1e-3, 1e4),
    Port("gravity_m_s2", "m/s2", "g", None, -100.0, 100.0),
    Port("viscous_Nms_rad", "N m s/rad", "fv of both joints", None, 0.0, 1e4),
    Port("coulomb_Nm", "N m", "fc of both joints", None, 0.0, 1e4),
    Port("load_kg", "kg", "m2 while the payload is on", None, 1e-3, 1e4),
    Port("load_from_s", "s", "payload on", 0.0, 0.0, 1e6),
    Port("load_to_s", "s", "payload off; not after load_from_s: never on", 0.0, 0.0, 1e6),
    Port("substeps", "", "integration steps a period, whole", None, 1.0, 1000.0),
    Port("delay_samples", "", "age of the torque that acts, whole", 0.0, 0.0, DELAY_SIZE - 1.0),
    Port("torque_lsb_Nm", "N m", "quantum of the torque that acts, 0 none", 0.0, 0.0, 1e3),
    Port("position_lsb_rad", "rad", "quantum of the position samples, 0 none", 0.0, 0.0, 1.0),
    Port("rate_lsb_rad_s", "rad/s", "quantum of the rate samples, 0 none", 0.0, 0.0, 10.0),
)
SETTINGS = (
    *PARAMETERS,
    Port("start_1_rad", "rad", "q1 at the start, at rest", None, -10.0, 10.0),
    Port("start_2_rad", "rad", "q2 at the start, at rest", None, -10.0, 10.0),
)
STATES = (
    Port("x_q_1_rad", "rad", "q1"),
    Port("x_q_2_rad", "rad", "q2"),
    Port("x_v_1_rad_s", "rad/s", "q1'"),
    Port("x_v_2_rad_s", "rad/s", "q2'"),
    Port("scratch", "", "stage, slope, sum of the integrator", size=12, recorded=False),
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
    Port("mass_kg", "kg", "m2 up to this sample"),
)
(A1, A2, M1, M2, G, VISCOUS, COULOMB, LOAD, LOAD_FROM, LOAD_TO, SUBSTEPS, DELAY, TORQUE_LSB,
 POSITION_LSB, RATE_LSB) = range(15)  # fmt: skip
_STAGE, _SLOPE, _SUM, HELD_1 = 4, 8, 12, 16
HELD_2 = HELD_1 + DELAY_SIZE


@inline
def friction(rate: float, p: Any) -> float:
    """Return Fr of (2), N m."""
    return p[VISCOUS] * rate + p[COULOMB] * tanh(rate / STICTION_RAD_S)


@inline
def slope(x: Any, tau1: float, tau2: float, m2: float, p: Any, out: Any) -> None:
    """Write x' (4) of x = (q1, q2, v1, v2) to `out`."""
    sin_q2, cos_q2 = sincos(x[1])
    m11, m12, m22 = inertia(cos_q2, p[A1], p[A2], p[M1], m2)
    c1, c2 = velocity_torque(m2 * p[A1] * p[A2] * sin_q2, x[2], x[3])
    g1, g2 = gravity_torque(x[0], x[1], p[A1], p[A2], p[M1], m2, p[G])
    f1 = tau1 - c1 - g1 - friction(x[2], p)
    f2 = tau2 - c2 - g2 - friction(x[3], p)
    det = m11 * m22 - m12 * m12
    out[0] = x[2]
    out[1] = x[3]
    out[2] = (m22 * f1 - m12 * f2) / det
    out[3] = (m11 * f2 - m12 * f1) / det


@inline
def advance(tau1: float, tau2: float, m2: float, h: float, p: Any, x: Any) -> None:
    """One Runge-Kutta step of (4) under a constant torque."""
    at, k, total = tail(x, _STAGE), tail(x, _SLOPE), tail(x, _SUM)
    for i in range(4):
        at[i] = x[i]
        total[i] = 0.0
    for stage_number in range(4):
        slope(at, tau1, tau2, m2, p, k)
        inner = stage_number == 1 or stage_number == 2
        weight = 2.0 if inner else 1.0
        ahead = h if stage_number == 2 else 0.5 * h
        for i in range(4):
            total[i] += weight * k[i]
            at[i] = x[i] + ahead * k[i]
    for i in range(4):
        x[i] += h / 6.0 * total[i]


@inline
def energy(m2: float, p: Any, x: Any) -> float:
    """Return E of (5), J."""
    m11, m12, m22 = inertia(sincos(x[1])[1], p[A1], p[A2], p[M1], m2)
    moving = 0.5 * (m11 * x[2] * x[2] + m22 * x[3] * x[3]) + m12 * x[2] * x[3]
    outer = m2 * p[G] * p[A2] * sin(x[0] + x[1])
    return moving + (p[M1] + m2) * p[G] * p[A1] * sin(x[0]) + outer


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Advance to t, sample; see the module header."""
    middle = t - 0.5 * dt  # of the period: clear of the rounding of its ends
    loaded = (middle >= p[LOAD_FROM]) & (middle < p[LOAD_TO])
    y[10] = where(loaded, p[LOAD], p[M2])
    if t > 0.0:
        y[8] = rounded(delayed(u[0], p[DELAY], x, HELD_1), p[TORQUE_LSB])
        y[9] = rounded(delayed(u[1], p[DELAY], x, HELD_2), p[TORQUE_LSB])
        for _ in range(int(p[SUBSTEPS])):
            advance(y[8], y[9], y[10], dt / p[SUBSTEPS], p, x)
    for i in range(2):
        y[i] = rounded(x[i], p[POSITION_LSB])
        y[2 + i] = rounded(x[2 + i], p[RATE_LSB])
        y[4 + i] = x[i]
        y[6 + i] = x[2 + i]


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and the arm at rest at its start."""
    own = {port.name: settings[port.name] for port in PARAMETERS}
    states = {"x_q_1_rad": settings["start_1_rad"], "x_q_2_rad": settings["start_2_rad"]}
    return Prepared(own, states)


BLOCK = Block(
    step,
    inputs=INPUTS,
    outputs=OUTPUTS,
    parameters=PARAMETERS,
    states=STATES,
    settings=SETTINGS,
    prepare=prepare,
)
