"""The lag of the probe, whose sample goes out in frames of two layouts, and of one that is none."""

from pcpc.executive.laws.block import Block, Ports, port, stage
from pcpc.plants.probe.model import Inputs, Parameters, States


class Outputs(Ports):
    """To the law."""

    position = port("", "the sample", low=-2000.0, high=2000.0)
    which = port("", "layout in turn")
    twice = port("", "the sample, doubled")


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Advance the lag from t - dt to t and sample it; at t = 0 only sample."""
    if t > 0.0:
        x.x += dt / p.tau_s * (u.command - x.x)
    y.position = x.x
    y.which = y.which + 1.0 if y.which < 2.0 else 0.0
    y.twice = 2.0 * x.x


BLOCK = Block(step)
