"""Sensors: a first-order lag that the plant integrates, white noise, a resolution.

    l' = 2 pi f (s - l)                            bandwidth f, -3 dB           (1)
    y_k = l(t_k) + std w_k                         w_k of plants.noise          (2)
    y_k = lsb floor(l(t_k)/lsb + 1/2)              coarser than the codec's     (3)

Where the scale of the CAN signal is the sensor's resolution, the codec rounds and (3) is not used.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.emath import floor
from pcpc.plants.noise import normal

TWO_PI = 6.283185307179586


@inline
def lag_rate(lagged: float, signal: float, bandwidth_hz: float) -> float:
    """Return l' of (1) in units of the signal per second."""
    return TWO_PI * bandwidth_hz * (signal - lagged)


@inline
def noisy(value: float, std: float, stream: Array) -> float:
    """Return the sample of (2), drawing once from a stream (6,) of plants.noise."""
    return value + std * normal(stream)


@inline
def rounded(value: float, lsb: float) -> float:
    """Return the sample of (3); `value` itself where `lsb` is 0."""
    if lsb > 0.0:
        return lsb * floor(value / lsb + 0.5)
    return value
