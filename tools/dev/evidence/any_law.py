"""Any law: command(k) = answers[k mod 64] + gain position. `envelope` writes them."""

from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage

COUNT = 64


class States(Ports):
    """What it answers, cycle by cycle."""

    answers = port("", "commands in turn", shape=COUNT, recorded=False)
    gain = port("", "of the position", recorded=False)


class Inputs(Ports):
    """From the plant."""

    position = port("", "measured")


class Outputs(Ports):
    """To the plant."""

    command = port("", "what the lag is told")


@stage
def step(t: float, dt: float, p: Nothing, x: States, u: Inputs, y: Outputs) -> None:
    """One control period."""
    y.command = x.answers[int(t / dt + 0.5) % COUNT] + x.gain * u.position


BLOCK = Block(step)
