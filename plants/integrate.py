"""The fixed-step integrator of the plants: classic Runge-Kutta.

    k1 = f(t, x),                  k2 = f(t + h/2, x + h/2 k1),
    k3 = f(t + h/2, x + h/2 k2),   k4 = f(t + h, x + h k3)
    x += h/6 (((k1 + 2 k2) + 2 k3) + k4)                                                      (1)

`f` writes the derivative of one declaration of states into another of the same kind:

    @inline
    def slope(t: float, p: Parameters, w: Inputs, x: Motion, d: Motion) -> None:
        d.q_rad = x.rate_rad_s
        d.rate_rad_s = (w.torque_Nm - p.viscous_Nms_rad * x.rate_rad_s) / p.inertia_kgm2

    class States(Ports):
        motion = group(Motion, "x_")
        integrator = group(scratch(Motion))

    runge_kutta(slope, t, h, p, w, x.motion, x.integrator)

`w` holds what is constant over the step, such as torques.
"""

from collections.abc import Callable
from typing import Any

from pcpc.executive.laws.block import Ports, flat, group, inline
from pcpc.executive.laws.emath import where


def scratch(motion: type[Ports]) -> type[Ports]:
    """Return the declaration of what `runge_kutta` needs to integrate `motion`."""

    class Scratch(Ports):
        stage = group(motion, "stage_", recorded=False)
        slope = group(motion, "slope_", recorded=False)
        total = group(motion, "total_", recorded=False)

    return Scratch


@inline
def runge_kutta(
    f: Callable[..., None], t: float, h: float, p: Ports, w: Any, x: Ports, scratch: Ports
) -> None:
    """Advance `x` from t to t + h (1); f(t, p, w, x, d) writes dx/dt to `d`."""
    start, at = flat(x), flat(scratch.stage)
    k, total = flat(scratch.slope), flat(scratch.total)
    for i in range(len(start)):
        at[i] = start[i]
    ahead = 0.0  # of a stage's time
    for number in range(4):
        f(t + ahead, p, w, scratch.stage, scratch.slope)
        weight = where((number == 1) | (number == 2), 2.0, 1.0)
        ahead = where(number < 2, 0.5 * h, h)  # of the next stage
        for i in range(len(start)):
            total[i] = where(number == 0, k[i], total[i] + weight * k[i])
            at[i] = start[i] + ahead * k[i]
    for i in range(len(start)):
        start[i] += h / 6.0 * total[i]
