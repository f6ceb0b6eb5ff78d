"""References for laws that are difference equations: a sequence with both its neighbours.

    sine          x_k = A sin(W k T + phase);  x_k-1, x_k, x_k+1                             (1)
    older_sine    the same, and x_k-2 for plants of third order

Without unit; W in rad/s, T the period in s. A closed form of t, so that a skipped cycle or a replay
changes nothing.
"""

from pcpc.executive.laws.block import Block, Nothing, Ports, inline, port, stage
from pcpc.executive.laws.emath import sin


class Neighbours(Ports):
    """What all give."""

    previous = port("", "x_k-1")
    now = port("", "x_k")
    next = port("", "x_k+1")


class Older(Neighbours):
    """What plants of third order need."""

    older = port("", "x_k-2")


class Sine(Ports):
    """Of (1)."""

    amplitude = port("", "A", None, -1e3, 1e3)
    omega_rad_s = port("rad/s", "W", None, 0.0, 1e3)
    phase_rad = port("rad", "at t = 0", 0.0, -7.0, 7.0)


@inline
def neighbours(t: float, dt: float, p: Sine, y: Neighbours) -> None:
    """Write (1)."""
    y.previous = p.amplitude * sin(p.omega_rad_s * (t - dt) + p.phase_rad)
    y.now = p.amplitude * sin(p.omega_rad_s * t + p.phase_rad)
    y.next = p.amplitude * sin(p.omega_rad_s * (t + dt) + p.phase_rad)


@stage
def sine_step(t: float, dt: float, p: Sine, x: Nothing, u: Nothing, y: Neighbours) -> None:
    """Equation (1)."""
    neighbours(t, dt, p, y)


@stage
def older_step(t: float, dt: float, p: Sine, x: Nothing, u: Nothing, y: Older) -> None:
    """Equation (1), with the sample before the last."""
    neighbours(t, dt, p, y)
    y.older = p.amplitude * sin(p.omega_rad_s * (t - 2.0 * dt) + p.phase_rad)


sine = Block(sine_step)
older_sine = Block(older_step)
