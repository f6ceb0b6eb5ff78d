"""The plant of a drawn rig: a lag that is sampled, doubled, and says which layout is in turn.

x' = (command - x) / tau                                             one Euler step a cycle
"""

from pcpc.executive.laws.block import Block, Ports, port, stage
from pcpc.executive.laws.emath import clip, where


class Parameters(Ports):
    """Of the lag."""

    tau_s = port("s", "time constant", None, 1e-3, 1e3)
    layouts = port("", "layouts of a frame, in turn", 2.0, 1.0, 8.0)
    press_s = port("s", "when the emergency stop is pressed", 1e6, 0.0, 1e6)


class States(Ports):
    """Of the lag."""

    x = port("", "of the lag")


class Inputs(Ports):
    """From the law."""

    command = port("", "newest valid command")


class Outputs(Ports):
    """To the law."""

    position = port("", "the sample", low=-2000.0, high=2000.0)
    twice = port("", "the sample, doubled")
    which = port("", "layout in turn")
    pressed = port("", "1 once the emergency stop is pressed")


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Advance the lag from t - dt to t and sample it; at t = 0 only sample."""
    if t > 0.0:
        x.x += clip(dt / p.tau_s, 0.0, 1.0) * (u.command - x.x)
    y.position = x.x
    y.twice = 2.0 * x.x
    y.pressed = where(t >= p.press_s, 1.0, 0.0)
    y.which = where(y.which + 1.0 < p.layouts, y.which + 1.0, 0.0)


BLOCK = Block(step)
