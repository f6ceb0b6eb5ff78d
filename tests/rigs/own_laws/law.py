"""A law of a user: memory in an array, a helper, constants of another file."""

from gains import SCALE

from pcpc.executive.laws.block import Block, Ports, inline, port, stage
from pcpc.executive.laws.emath import clip, sin, where


class Settings(Ports):
    """Of the law."""

    gain = port("", "of the error", 2.0, 0.0, 100.0)


class States(Ports):
    """Of the law."""

    past = port("", "errors of the last cycles", shape=5)
    sum = port("", "of the error", adapts=True)


class Inputs(Ports):
    """Of the law."""

    position = port("", "measured")


class Outputs(Ports):
    """Of the law."""

    command = port("", "to the lag")
    e = port("", "error")


@inline
def _mean(past: States) -> float:
    total = 0.0
    for i in range(5):
        total += past[i]
    return total / 5.0


@stage
def step(t: float, dt: float, p: Settings, x: States, u: Inputs, y: Outputs) -> None:
    y.e = SCALE * sin(7.0 * t) - u.position
    for i in range(4):
        x.past[4 - i] = x.past[3 - i]
    x.past[0] = y.e
    x.sum = clip(x.sum + dt * y.e, -0.2, 0.2)
    y.command = where(t < 0.1, 0.0, p.gain * _mean(x.past) + x.sum)


BLOCK = Block(step)
