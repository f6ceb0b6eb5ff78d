"""The law of the probe: command = gain (target - position)."""

from typing import Any

from pcpc.executive.laws.block import Block, Port, stage


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period."""
    y[0] = p[0] * (p[1] - u[0])


BLOCK = Block(
    step,
    inputs=(Port("position", "", "measured"),),
    outputs=(Port("command", "", "what the lag is told"),),
    settings=(
        Port("gain", "", "of the error", None, 0.0, 100.0),
        Port("target", "", "where the lag is to go", None, -10.0, 10.0),
    ),
)
