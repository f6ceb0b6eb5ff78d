"""References for laws that are difference equations: a sequence with both its neighbours.

    sine    x_k = A sin(W k T + phase);  x_k-1, x_k, x_k+1                                   (1)

Without unit; W in rad/s, T the period in s. A closed form of t, so that a skipped cycle or a replay
changes nothing.
"""

from typing import Any

from pcpc.executive.laws.block import Block, Port, stage
from pcpc.executive.laws.emath import sin


@stage
def sine_step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Equation (1)."""
    amplitude, omega, phase = p[0], p[1], p[2]
    y[0] = amplitude * sin(omega * (t - dt) + phase)
    y[1] = amplitude * sin(omega * t + phase)
    y[2] = amplitude * sin(omega * (t + dt) + phase)


sine = Block(
    sine_step,
    outputs=(
        Port("previous", "", "x_k-1"),
        Port("now", "", "x_k"),
        Port("next", "", "x_k+1"),
    ),
    settings=(
        Port("amplitude", "", "A", None, -1e3, 1e3),
        Port("omega_rad_s", "rad/s", "W", None, 0.0, 1e3),
        Port("phase_rad", "rad", "at t = 0", 0.0, -7.0, 7.0),
    ),
)
