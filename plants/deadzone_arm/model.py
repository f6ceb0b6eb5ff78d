"""The two-link arm with a deadzone in front of each joint: commands in, angles and rates out.

    M(q) v' + Vm(q, v) v = tau,   q' = v         families/two_link/equations.py, horizontal    (1)
    tau_i = D(u_i)                                plants/actuators/deadzone.py, unmeasured (2)
    E = v'M(q)v/2,   E' = v'tau                   for M' - 2 Vm is skew-symmetric            (3)

    call k of `step` at t = k dt:  k = 0  samples of the initial state; nothing else happens
                                   k > 0  tau from the command of `delay_samples` calls before,
                                          integrate [t - dt, t] with tau held, sample at t

So with `delay_samples` 0 the command that was computed from the sample at t - dt acts from t - dt
on. Classic Runge-Kutta, `substeps` equal steps. Samples, delay and the commands' rounding:
plants/families/two_link/arm.py. rad, rad/s, N m, kg, m, J; no gravity, friction or disturbance.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.2; (1) as in families/two_link.
"""

from pcpc.executive.laws.block import Block, inline, port, stage
from pcpc.executive.laws.emath import cos
from pcpc.plants.actuators.deadzone import deadzone
from pcpc.plants.families.two_link import arm as two_link_arm
from pcpc.plants.families.two_link.arm import Inputs, Interface, Motion, States
from pcpc.plants.families.two_link.equations import Links, inertia, motion, solved


class Arm(Links):
    """The arm and its deadzones."""

    d_plus_Nm = port("N m", "width of the deadzones on the positive side", None, 0.0, 1e3)
    d_minus_Nm = port("N m", "width on the negative side, a magnitude", None, 0.0, 1e3)
    m_plus = port("", "slope on the positive side", None, 1e-3, 1e3)
    m_minus = port("", "slope on the negative side", None, 1e-3, 1e3)
    substeps = port("", "Runge-Kutta steps a period", None, 1.0, 1000.0)


class Parameters(Arm, Interface):
    """These, and what is between them and the law."""


class Outputs(two_link_arm.Outputs):
    """Samples and truths."""

    energy_J = port("J", "kinetic energy (3)")


@inline
def slope(t: float, p: Parameters, y: Outputs, x: Motion, d: Motion) -> None:
    """Write q' and v' of (1) under the torques in `y`."""
    m11, m12, m22, c1, c2 = motion(p, p.m2_kg, x.q_rad, x.rate_rad_s)
    d.q_rad[0], d.q_rad[1] = x.rate_rad_s[0], x.rate_rad_s[1]
    b1, b2 = y.acting_Nm[0] - c1, y.acting_Nm[1] - c2
    d.rate_rad_s[0], d.rate_rad_s[1] = solved(m11, m12, m22, b1, b2)


@inline
def kinetic_energy(p: Parameters, x: Motion) -> float:
    """Return E of (3), J."""
    m11, m12, m22 = inertia(cos(x.q_rad[1]), p.a1_m, p.a2_m, p.m1_kg, p.m2_kg)
    v1, v2 = x.rate_rad_s[0], x.rate_rad_s[1]
    return 0.5 * (m11 * v1 * v1 + 2.0 * m12 * v1 * v2 + m22 * v2 * v2)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Advance the arm from t - dt to t and sample it; at t = 0 only sample."""
    if t > 0.0:
        two_link_arm.receive(p, x.held, u, y)
        for j in range(len(y.acting_Nm)):  # (2)
            tau = deadzone(y.acting_Nm[j], p.d_plus_Nm, p.d_minus_Nm, p.m_plus, p.m_minus)
            y.acting_Nm[j] = tau
        two_link_arm.advance(slope, t, dt, p, x, y)
    two_link_arm.sample(p, x.motion.q_rad, x.motion.rate_rad_s, y)
    y.energy_J = kinetic_energy(p, x.motion)


BLOCK = Block(step)
