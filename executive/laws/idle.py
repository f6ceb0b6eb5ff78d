"""The step of an unused place of the loop."""

from pcpc.executive.laws.block import Nothing, stage


@stage
def idle(t: float, dt: float, p: Nothing, x: Nothing, u: Nothing, y: Nothing) -> None:
    """Do nothing."""
