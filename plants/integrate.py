"""The fixed-step integrator of all plants: classic Runge-Kutta.

    k1 = f(t, x),                  k2 = f(t + h/2, x + h/2 k1),
    k3 = f(t + h/2, x + h/2 k2),   k4 = f(t + h, x + h k3)
    x += h/6 (k1 + 2 k2 + 2 k3 + k4)                                                          (1)

`f` writes the derivative of one declaration of states into another of the same kind. What it needs
beside the states (parameters, torques, the integration step) is handed through.
"""

from typing import Any

from pcpc.executive.laws.block import Ports, flat, group, inline


def scratch(motion: type[Ports]) -> type[Ports]:
    """Return the declaration of what `runge_kutta` needs to integrate `motion`."""

    class Scratch(Ports):
        slope = group(motion, "slope_", recorded=False)
        between = group(motion, "between_", recorded=False)
        total = group(motion, "total_", recorded=False)

    return Scratch


@inline
def runge_kutta(f: Any, t: float, h: float, p: Any, w: Any, x: Any, scratch: Any) -> None:
    """Advance `x` from t to t + h (1); f(t, p, w, x, d) writes dx/dt to `d`."""
    s, at = flat(x), flat(scratch.between)
    k, total = flat(scratch.slope), flat(scratch.total)
    for i in range(len(s)):
        at[i] = s[i]
        total[i] = 0.0
    for stage in range(4):
        inner = stage == 1 or stage == 2
        weight = 2.0 if inner else 1.0
        ahead = h if stage == 2 else 0.5 * h
        f(
            t + (0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)),
            p,
            w,
            scratch.between,
            scratch.slope,
        )
        for i in range(len(s)):
            total[i] += weight * k[i]
            at[i] = s[i] + ahead * k[i]
    for i in range(len(s)):
        s[i] += h / 6.0 * total[i]
