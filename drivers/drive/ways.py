"""Steps on the way to a goal."""

import math

from pcpc.drivers.compiled.jit import loop_inline


@loop_inline
def toward(x: float, goal: float, step: float) -> float:
    """Return `goal`, or the nearest to it that is at most `step` from `x`."""
    return min(max(goal, x - step), x + step)


@loop_inline
def braking_velocity(distance: float, velocity_limit: float, slow: float, dt: float) -> float:
    """Return the velocity from which one, slowing down at `slow`, still stops after `distance`."""
    half = 0.5 * slow * dt
    fastest = min(math.sqrt(half * half + 2.0 * slow * abs(distance)) - half, velocity_limit)
    return fastest if distance > 0.0 else -fastest
