"""The plant of the probe: a first-order lag, one Euler step a cycle.

    x' = (command - x) / tau

Without units. The sample of t goes out before the command of t comes in, as on every rig here.
"""

from typing import Any

from pcpc.executive.laws.block import Block, Port, stage


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Advance the lag from t - dt to t and sample it; at t = 0 only sample."""
    if t > 0.0:
        x[0] += dt / p[0] * (u[0] - x[0])
    y[0] = x[0]


BLOCK = Block(
    step,
    inputs=(Port("command", "", "newest valid command"),),
    outputs=(Port("position", "", "the sample"),),
    states=(Port("x", "", "of the lag"),),
    settings=(Port("tau_s", "s", "time constant", None, 1e-3, 1e3),),
)
