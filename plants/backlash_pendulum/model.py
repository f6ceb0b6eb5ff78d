"""A damped pendulum that is driven through a gap: command in, angle, rate and torque out.

    x1' = x2                                                                                 (1)
    x2' = -x2/T_m - m g a sin(x1) + tau                                                      (2)
    tau = play of the command, slope 1, gap d- to d+       actuators/backlash.py (2)         (3)
    E   = x2^2/2 + m g a (1 - cos x1),   E' = -x2^2/T_m + tau x2                             (4)

    call k of `step`:  k = 0  sample of the initial state; nothing else happens
                       k > 0  tau by (3) with the command of `delay_samples` calls before, then
                              (1) (2) from t - dt to t with tau held: classic Runge-Kutta in
                              `substeps` steps; then sample

At call k the input is the answer to sample k-1, so that with `delay_samples` 0 it acts on
[t_k-1, t_k), as in the book's simulations; with 1 one sample later, as with real hardware. It
starts at rest with tau = 0. A sample is rounded to a multiple of its `..._lsb_...`, half up; so is
the command that acts. 0 does not round.

rad, rad/s, N m, s; positive torque raises the angle, which is 0 hanging down; inertia 1 kg m^2.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 5.2; the right side of (2) is lost in the
available copies and is chosen here from the parameters that the book names.
"""

from pcpc.executive.laws.block import Block, Ports, group, inline, port, stage
from pcpc.executive.laws.emath import cos, sin, where
from pcpc.plants.actuators.backlash import backlash
from pcpc.plants.integrate import runge_kutta, scratch
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed


class Parameters(Ports):
    """The pendulum, the gap, and what is between them and the law."""

    time_constant_s = port("s", "T_m, inertia over viscous friction", None, 1e-3, 1e6)
    mass_kg = port("kg", "m", None, 0.0, 1e3)
    length_m = port("m", "a", None, 0.0, 1e3)
    gravity_m_s2 = port("m/s^2", "g; negative stands it on its head", None, -1e2, 1e2)
    d_plus_Nm = port("N m", "d+, command at which rising torque leaves zero", None, 0.0, 1e3)
    d_minus_Nm = port("N m", "d-, the same for falling torque, negative", None, -1e3, 0.0)
    delay_samples = port("", "whole samples of transport", None, 0.0, DELAY_SIZE - 1.0)
    substeps = port("", "Runge-Kutta steps in a period, a whole number", None, 1.0, 64.0)
    position_lsb_rad = port("rad", "quantum of the angle samples, 0 none", None, 0.0, 1.0)
    rate_lsb_rad_s = port("rad/s", "quantum of the rate samples, 0 none", None, 0.0, 10.0)
    torque_lsb_Nm = port("N m", "quantum of the torque samples, 0 none", None, 0.0, 10.0)
    command_lsb_Nm = port("N m", "quantum of the command that acts, 0 none", None, 0.0, 10.0)


class Motion(Ports):
    """What is integrated."""

    q_rad = port("rad", "x1")
    rate_rad_s = port("rad/s", "x2")


class Seen(Motion):
    """What has a sensor."""

    torque_Nm = port("N m", "tau behind the gap")


class States(Ports):
    """Motion, torque, and commands on their way."""

    motion = group(Motion, "x_")
    torque_Nm = port("N m", "tau", named="x_torque_Nm")
    sent_Nm = port("N m", "commands on their way", shape=DELAY_SIZE, recorded=False)
    integrator = group(scratch(Motion))


class Inputs(Ports):
    """The law's command."""

    command_Nm = port("N m", "newest valid command")


class Outputs(Ports):
    """Samples and truths."""

    sample = group(Seen, "sample_")
    true = group(Seen)
    acting_Nm = port("N m", "truth: the command before the gap")
    flank = port("", "truth: 1 pushed up, -1 pushed down, 0 in the gap")
    energy_J = port("J", "truth: E (4)")


@inline
def weight(p: Parameters) -> float:
    """Return m g a, N m."""
    return p.mass_kg * p.gravity_m_s2 * p.length_m


@inline
def slope(t: float, p: Parameters, tau: float, x: Motion, d: Motion) -> None:
    """Write x1' (1) and x2' (2) under the torque `tau`."""
    d.q_rad = x.rate_rad_s
    d.rate_rad_s = tau - x.rate_rad_s / p.time_constant_s - weight(p) * sin(x.q_rad)


@inline
def push(p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Move the gap by the command that now acts (3)."""
    acting = rounded(delayed(u.command_Nm, p.delay_samples, x.sent_Nm), p.command_lsb_Nm)
    up, down = x.torque_Nm <= acting - p.d_plus_Nm, x.torque_Nm >= acting - p.d_minus_Nm
    x.torque_Nm = backlash(x.torque_Nm, acting, p.d_plus_Nm, p.d_minus_Nm)
    y.acting_Nm = acting
    y.flank = where(up, 1.0, where(down, -1.0, 0.0))


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Move the gap and the pendulum from t - dt to t, then sample; at t = 0 only sample."""
    if t > 0.0:
        push(p, x, u, y)
        n = int(p.substeps)
        for _ in range(n):
            runge_kutta(slope, t, dt / n, p, x.torque_Nm, x.motion, x.integrator)
    angle, rate = x.motion.q_rad, x.motion.rate_rad_s
    y.true.q_rad, y.true.rate_rad_s, y.true.torque_Nm = angle, rate, x.torque_Nm
    y.sample.q_rad = rounded(angle, p.position_lsb_rad)
    y.sample.rate_rad_s = rounded(rate, p.rate_lsb_rad_s)
    y.sample.torque_Nm = rounded(x.torque_Nm, p.torque_lsb_Nm)
    y.energy_J = 0.5 * rate * rate + weight(p) * (1.0 - cos(angle))  # (4)


BLOCK = Block(step)
