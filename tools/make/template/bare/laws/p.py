"""Proportional control: write your own law in its place.

e = r - y                                                                       (1)
u = K e                                                                         (2)
"""

from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage


class Gains(Ports):
    """What `pcpc set controller.gain=20` tunes while it runs."""

    gain = port("", "K", None, 0.0, 1e3)


class Inputs(Ports):
    """The reference, and what came over the bus."""

    wanted = port("", "r")
    measured = port("", "y")


class Outputs(Ports):
    """The command and the error."""

    command = port("", "u (2)", low=-100.0, high=100.0)
    error = port("", "e (1)")


@stage
def step(t: float, dt: float, p: Gains, x: Nothing, u: Inputs, y: Outputs) -> None:
    """One control period."""
    y.error = u.wanted - u.measured  # (1)
    y.command = p.gain * y.error  # (2)


BLOCK = Block(step)
