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

from typing import Any

from pcpc.drivers.jit import inline
from pcpc.executive.laws.block import Block, Port, stage
from pcpc.executive.laws.emath import cos, sin, where
from pcpc.plants.actuators.backlash import backlash
from pcpc.plants.sensors import rounded
from pcpc.plants.transport import DELAY_SIZE, delayed

SETTINGS = (
    Port("time_constant_s", "s", "T_m, inertia over viscous friction", None, 1e-3, 1e6),
    Port("mass_kg", "kg", "m", None, 0.0, 1e3),
    Port("length_m", "m", "a", None, 0.0, 1e3),
    Port("gravity_m_s2", "m/s^2", "g; negative stands the pendulum on its head", None, -1e2, 1e2),
    Port("d_plus_Nm", "N m", "d+, command at which rising torque leaves zero", None, 0.0, 1e3),
    Port("d_minus_Nm", "N m", "d-, the same for falling torque, negative", None, -1e3, 0.0),
    Port("delay_samples", "", "whole samples of transport", None, 0.0, DELAY_SIZE - 1.0),
    Port("substeps", "", "Runge-Kutta steps in a period, a whole number", None, 1.0, 64.0),
    Port("angle_lsb_rad", "rad", "quantum of the angle samples, 0 none", None, 0.0, 1.0),
    Port("rate_lsb_rad_s", "rad/s", "quantum of the rate samples, 0 none", None, 0.0, 10.0),
    Port("torque_lsb_Nm", "N m", "quantum of the torque samples, 0 none", None, 0.0, 10.0),
    Port("command_lsb_Nm", "N m", "quantum of the command that acts, 0 none", None, 0.0, 10.0),
)
(
    T_M, MASS, LENGTH, GRAVITY, D_PLUS, D_MINUS, DELAY, SUBSTEPS,
    ANGLE_LSB, RATE_LSB, TORQUE_LSB, COMMAND_LSB,
) = range(len(SETTINGS))  # fmt: skip
STATES = (
    Port("x_angle_rad", "rad", "x1"),
    Port("x_rate_rad_s", "rad/s", "x2"),
    Port("x_torque_Nm", "N m", "tau"),
    Port("sent_Nm", "N m", "commands on their way", size=DELAY_SIZE, recorded=False),
)
X1, X2, TAU, SENT = range(len(STATES))
OUTPUTS = (
    Port("angle_rad", "rad", "sensor: x1"),
    Port("rate_rad_s", "rad/s", "sensor: x2"),
    Port("torque_Nm", "N m", "sensor: tau behind the gap"),
    Port("true_angle_rad", "rad", "truth: x1"),
    Port("true_rate_rad_s", "rad/s", "truth: x2"),
    Port("true_torque_Nm", "N m", "truth: tau"),
    Port("acting_Nm", "N m", "truth: the command before the gap"),
    Port("flank", "", "truth: 1 pushed up, -1 pushed down, 0 in the gap"),
    Port("energy_J", "J", "truth: E (4)"),
)


@inline
def acceleration(x1: float, x2: float, tau: float, t_m: float, weight: float) -> float:
    """Return x2' of (2), rad/s^2; `weight` = m g a, N m."""
    return tau - x2 / t_m - weight * sin(x1)


@inline
def advance(x: Any, tau: float, t_m: float, weight: float, h: float) -> None:
    """One Runge-Kutta step of (1) (2) over `h` s on x[0], x[1] with `tau` held."""
    x1, x2, half = x[X1], x[X2], 0.5 * h
    a1 = acceleration(x1, x2, tau, t_m, weight)
    v2 = x2 + half * a1
    a2 = acceleration(x1 + half * x2, v2, tau, t_m, weight)
    v3 = x2 + half * a2
    a3 = acceleration(x1 + half * v2, v3, tau, t_m, weight)
    v4 = x2 + h * a3
    a4 = acceleration(x1 + h * v3, v4, tau, t_m, weight)
    x[X1] = x1 + h / 6.0 * (x2 + 2.0 * v2 + 2.0 * v3 + v4)
    x[X2] = x2 + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Move the gap and the pendulum from t - dt to t, then sample; at t = 0 only sample."""
    weight = p[MASS] * p[GRAVITY] * p[LENGTH]
    if t > 0.0:
        acting = rounded(delayed(u[0], p[DELAY], x, SENT), p[COMMAND_LSB])
        before = x[TAU]
        x[TAU] = backlash(before, acting, p[D_PLUS], p[D_MINUS])  # (3)
        y[6] = acting
        up, down = before <= acting - p[D_PLUS], before >= acting - p[D_MINUS]
        y[7] = where(up, 1.0, where(down, -1.0, 0.0))
        n = int(p[SUBSTEPS])
        for _ in range(n):
            advance(x, x[TAU], p[T_M], weight, dt / n)
    y[0] = rounded(x[X1], p[ANGLE_LSB])
    y[1] = rounded(x[X2], p[RATE_LSB])
    y[2] = rounded(x[TAU], p[TORQUE_LSB])
    y[3] = x[X1]
    y[4] = x[X2]
    y[5] = x[TAU]
    y[8] = 0.5 * x[X2] * x[X2] + weight * (1.0 - cos(x[X1]))  # (4)


BLOCK = Block(
    step,
    inputs=(Port("command_Nm", "N m", "newest valid command"),),
    outputs=OUTPUTS,
    states=STATES,
    settings=SETTINGS,
)
