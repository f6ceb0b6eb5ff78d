"""The laws of the relay."""

from typing import Any

from pcpc.executive.laws.block import Block, Port, stage


@stage
def ask_step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Ask for the target; remember the largest error seen."""
    y[0] = p[0]
    y[1] = p[0] - u[0]


@stage
def servo_step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Drive the lag towards what is asked."""
    y[0] = p[0] * (u[0] - u[1])


ASK = Block(
    ask_step,
    inputs=(Port("position", "", "told"),),
    outputs=(Port("asked", "", "asked for"), Port("e", "", "what is missing")),
    settings=(Port("target", "", "where to", None, -10.0, 10.0),),
)
SERVO = Block(
    servo_step,
    inputs=(Port("target", "", "asked for"), Port("position", "", "measured")),
    outputs=(Port("command", "", "of the lag"),),
    settings=(Port("gain", "", "of the error", None, 0.0, 100.0),),
)
