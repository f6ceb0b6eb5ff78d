"""A sine that begins softly: zero with all that matters of it at t = 0, exact derivatives.

    y = A w(t) sin(om t),  w = s^3 (10 - 15 s + 6 s^2),  s = t/rise within 0..1              (1)

0 for t < 0. Source: chosen by this project for runs that start at rest.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.executive.laws.emath import clip, sincos


@inline
def soft_sine(t: float, size: float, omega: float, rise: float) -> tuple[float, float, float]:
    """Return y, y', y'' of (1), in units of `size`; `omega` in rad/s, `rise` in s."""
    s = clip(t / rise, 0.0, 1.0)
    left = 1.0 - s
    w = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
    w1 = 30.0 * s * s * left * left / rise
    w2 = 60.0 * s * left * (1.0 - 2.0 * s) / (rise * rise)
    sine, cosine = sincos(omega * t)
    y = size * w * sine
    y1 = size * (w1 * sine + w * omega * cosine)
    y2 = size * (w2 * sine + 2.0 * w1 * omega * cosine - w * omega * omega * sine)
    return y, y1, y2
