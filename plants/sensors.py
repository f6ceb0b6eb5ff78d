"""Sensors: a first-order lag that the plant integrates, and white noise added to each sample.

    l' = 2 pi f (s - l)                            bandwidth f, -3 dB           (1)
    y_k = l(t_k) + std w_k                         w_k of plants.noise          (2)

The rounding to a quantum is not done here: the CAN codec does it, whose scale is the quantum.
"""

from typing import Any

from drivers.jit import inline
from plants.noise import normal

TWO_PI = 6.283185307179586


@inline
def lag_rate(lagged: float, signal: float, bandwidth_hz: float) -> float:
    """Return l' of (1) in units of the signal per second."""
    return TWO_PI * bandwidth_hz * (signal - lagged)


@inline
def noisy(value: float, std: float, x: Any, at: int) -> float:
    """Return the sample of (2), drawing once from the stream at x[at]."""
    return value + std * normal(x, at)
