"""What plants that are two-link arms have in common: torques that come late, samples, truths.

    M(q) q'' + Vm(q, q') q' + G(q) + Fr = tau          plants/families/two_link/equations.py     (1)
    Fr_i = fv q_i' + fc tanh(q_i'/w)                         smooth: nothing ever sticks     (2)

A sample is rounded to a multiple of its `..._lsb_...`, half up; so is the torque that acts; 0 does
not round. rad, rad/s, N m.
"""

from collections.abc import Callable
from typing import Protocol

from pcpc.executive.laws.block import Array, Ports, group, inline, port
from pcpc.executive.laws.emath import tanh
from pcpc.plants.families.two_link.equations import LinksLike, gravity_torque, motion, solved
from pcpc.plants.integrate import runge_kutta, scratch
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed


class Arm(LinksLike, Protocol):
    """What (1) and (2) take of a plant's parameters."""

    gravity_m_s2: float
    viscous_Nms_rad: float
    coulomb_Nm: float


class Interface(Ports):
    """The age of what acts, and quanta."""

    delay_samples = port("", "age of the torque that acts, whole", 0.0, 0.0, DELAY_SIZE - 1.0)
    torque_lsb_Nm = port("N m", "quantum of the torque that acts, 0 none", 0.0, 0.0, 1e3)
    position_lsb_rad = port("rad", "quantum of the position samples, 0 none", 0.0, 0.0, 1.0)
    rate_lsb_rad_s = port("rad/s", "quantum of the rate samples, 0 none", 0.0, 0.0, 10.0)


class Held(Ports):
    """The registers of the delay."""

    torque_Nm = port("N m", "torques on their way", shape=(2, DELAY_SIZE), recorded=False)


class Inputs(Ports):
    """The law's torques."""

    torque_Nm = port("N m", "newest valid command to joint #", shape=2, named="torque_#_Nm")


class Motion(Ports):
    """Angles and rates; q2 is relative to link 1."""

    q_rad = port("rad", "angle of joint #", shape=2, named="q_#_rad")
    rate_rad_s = port("rad/s", "rate of joint #", shape=2, named="rate_#_rad_s")


class States(Ports):
    """Motion, and torques on their way."""

    motion = group(Motion, "x_")
    held = group(Held, "held_")
    integrator = group(scratch(Motion))


class Outputs(Ports):
    """Samples and truths."""

    sample = group(Motion, "sample_")
    true = group(Motion)
    acting_Nm = port("N m", "torque on joint # up to this sample", shape=2, named="acting_#_Nm")


@inline
def friction(p: Arm, width: float, v: float) -> float:
    """Return Fr_i of (2), N m."""
    return p.viscous_Nms_rad * v + p.coulomb_Nm * tanh(v / width)


@inline
def rates(p: Arm, m2: float, width: float, tau: Array, x: Motion, d: Motion) -> None:
    """Write q' and q'' of (1) to `d`, with `width` = w and `tau` (2,)."""
    q, v = x.q_rad, x.rate_rad_s
    m11, m12, m22, c1, c2 = motion(p, m2, q, v)
    g1, g2 = gravity_torque(q[0], q[1], p.a1_m, p.a2_m, p.m1_kg, m2, p.gravity_m_s2)
    b1 = tau[0] - c1 - g1 - friction(p, width, v[0])
    b2 = tau[1] - c2 - g2 - friction(p, width, v[1])
    d.q_rad[0], d.q_rad[1] = v[0], v[1]
    d.rate_rad_s[0], d.rate_rad_s[1] = solved(m11, m12, m22, b1, b2)


@inline
def receive(p: Interface, held: Held, u: Inputs, y: Outputs) -> None:
    """Write the torques that act in this period."""
    for j in range(len(u.torque_Nm)):
        due = delayed(u.torque_Nm[j], p.delay_samples, held.torque_Nm[j])
        y.acting_Nm[j] = rounded(due, p.torque_lsb_Nm)


@inline
def advance(f: Callable[..., None], t: float, dt: float, p: Ports, x: States, y: Outputs) -> None:
    """Integrate over the period in `substeps` steps; `f` as `runge_kutta` wants it."""
    for _ in range(int(p.substeps)):
        runge_kutta(f, t, dt / p.substeps, p, y, x.motion, x.integrator)


@inline
def sample(p: Interface, q: Array, v: Array, y: Outputs) -> None:
    """Write samples and truths of angles and rates, `q` and `v` (2,)."""
    for j in range(len(q)):
        y.sample.q_rad[j] = rounded(q[j], p.position_lsb_rad)
        y.sample.rate_rad_s[j] = rounded(v[j], p.rate_lsb_rad_s)
        y.true.q_rad[j] = q[j]
        y.true.rate_rad_s[j] = v[j]
