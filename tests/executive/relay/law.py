"""The laws of the relay."""

from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage


class Target(Ports):
    """Of the asking node."""

    target = port("", "where to", None, -10.0, 10.0)


class Told(Ports):
    """What the asking node hears."""

    position = port("", "told")


class Asked(Ports):
    """What it asks for."""

    asked = port("", "asked for")
    e = port("", "what is missing")


class Gain(Ports):
    """Of the node between."""

    gain = port("", "of the error", None, 0.0, 100.0)


class Wanted(Ports):
    """What it hears from both sides."""

    target = port("", "asked for")
    position = port("", "measured")


class Command(Ports):
    """What it says to the plant."""

    command = port("", "of the lag")


@stage
def ask_step(t: float, dt: float, p: Target, x: Nothing, u: Told, y: Asked) -> None:
    """Ask for the target; remember the largest error seen."""
    y.asked = p.target
    y.e = p.target - u.position


@stage
def servo_step(t: float, dt: float, p: Gain, x: Nothing, u: Wanted, y: Command) -> None:
    """Drive the lag towards what is asked."""
    y.command = p.gain * (u.target - u.position)


ASK, SERVO = Block(ask_step), Block(servo_step)
