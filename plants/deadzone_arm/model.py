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
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.2; (1) as in executive/laws/models.
"""

from typing import Any

from pcpc.executive.laws.block import Block, Ports, group, inline, port, stage
from pcpc.executive.laws.emath import cos
from pcpc.executive.laws.models.two_link import inertia, motion, solved
from pcpc.plants.actuators.deadzone import deadzone
from pcpc.plants.integrate import runge_kutta, scratch
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed


class Parameters(Ports):
    """The arm, its deadzones, and what is between it and the law."""

    a1_m = port("m", "length of the first link", None, 1e-3, 100.0)
    a2_m = port("m", "length of the second link", None, 1e-3, 100.0)
    m1_kg = port("kg", "mass at the end of the first link", None, 1e-3, 1e4)
    m2_kg = port("kg", "mass at the end of the second link", None, 1e-3, 1e4)
    d_plus_Nm = port("N m", "width of the deadzones on the positive side", None, 0.0, 1e3)
    d_minus_Nm = port("N m", "width on the negative side, a magnitude", None, 0.0, 1e3)
    m_plus = port("", "slope on the positive side", None, 1e-3, 1e3)
    m_minus = port("", "slope on the negative side", None, 1e-3, 1e3)
    substeps = port("", "Runge-Kutta steps a period", None, 1.0, 1000.0)
    delay_samples = port("", "whole samples of transport", 0.0, 0.0, DELAY_SIZE - 1.0)
    q_lsb_rad = port("rad", "resolution of the angle sensors", 0.0, 0.0, 1.0)
    v_lsb_rad_s = port("rad/s", "resolution of the rate sensors", 0.0, 0.0, 10.0)
    u_lsb_Nm = port("N m", "resolution of the commands", 0.0, 0.0, 10.0)


class Motion(Ports):
    """What is integrated; the second angle is relative to the first link."""

    q_rad = port("rad", "angle of joint #", shape=2, named="q#_rad")
    v_rad_s = port("rad/s", "rate of joint #", shape=2, named="v#_rad_s")


class States(Ports):
    """Motion, and commands on their way."""

    motion = group(Motion, "x_")
    sent_Nm = port("N m", "commands on their way", shape=(2, DELAY_SIZE), recorded=False)
    integrator = group(scratch(Motion))


class Inputs(Ports):
    """The law's commands."""

    u_Nm = port("N m", "newest command of joint #", shape=2, named="u#_Nm")


class Outputs(Ports):
    """Samples and truths."""

    sample = group(Motion)
    true = group(Motion, "true_")
    tau_Nm = port("N m", "torque on joint # in the period that ends here", shape=2, named="tau#_Nm")
    energy_J = port("J", "kinetic energy (3)")


@inline
def torque(u: float, p: Any, sent: Any) -> float:
    """Put a command into its register and return the torque that now acts (2)."""
    due = delayed(rounded(u, p.u_lsb_Nm), p.delay_samples, sent)
    return deadzone(due, p.d_plus_Nm, p.d_minus_Nm, p.m_plus, p.m_minus)


@inline
def slope(t: float, p: Any, y: Any, x: Any, d: Any) -> None:
    """Write q' and v' of (1) under the torques in `y`."""
    m11, m12, m22, c1, c2 = motion(p, p.m2_kg, x.q_rad, x.v_rad_s)
    d.q_rad[0], d.q_rad[1] = x.v_rad_s[0], x.v_rad_s[1]
    b1, b2 = y.tau_Nm[0] - c1, y.tau_Nm[1] - c2
    d.v_rad_s[0], d.v_rad_s[1] = solved(m11, m12, m22, b1, b2)


@inline
def kinetic_energy(p: Any, x: Any) -> float:
    """Return E of (3), J."""
    m11, m12, m22 = inertia(cos(x.q_rad[1]), p.a1_m, p.a2_m, p.m1_kg, p.m2_kg)
    v1, v2 = x.v_rad_s[0], x.v_rad_s[1]
    return 0.5 * (m11 * v1 * v1 + 2.0 * m12 * v1 * v2 + m22 * v2 * v2)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Advance the arm from t - dt to t and sample it; at t = 0 only sample."""
    if t > 0.0:
        for j in range(len(u.u_Nm)):
            y.tau_Nm[j] = torque(u.u_Nm[j], p, x.sent_Nm[j])
        for _ in range(int(p.substeps)):
            runge_kutta(slope, t, dt / p.substeps, p, y, x.motion, x.integrator)
    q, v = x.motion.q_rad, x.motion.v_rad_s
    for j in range(len(q)):
        y.sample.q_rad[j] = rounded(q[j], p.q_lsb_rad)
        y.sample.v_rad_s[j] = rounded(v[j], p.v_lsb_rad_s)
        y.true.q_rad[j] = q[j]
        y.true.v_rad_s[j] = v[j]
    y.energy_J = kinetic_energy(p, x.motion)


BLOCK = Block(step)
