"""The law of the probe: command = gain (target - position)."""

from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage


class Gains(Ports):
    """Gain and target."""

    gain = port("", "of the error", None, 0.0, 100.0)
    target = port("", "where the lag is to go", None, -10.0, 10.0)


class Inputs(Ports):
    """From the plant."""

    position = port("", "measured")


class Outputs(Ports):
    """To the plant."""

    command = port("", "what the lag is told", low=-2000.0, high=2000.0)


@stage
def step(t: float, dt: float, p: Gains, x: Nothing, u: Inputs, y: Outputs) -> None:
    """One control period."""
    y.command = p.gain * (p.target - u.position)


BLOCK = Block(step)
