"""How far apart two numbers are, counted in numbers."""

import math
import struct


def ulp_distance(a: float, b: float) -> int | None:
    """Return how many float64 lie between two numbers; None if one is NaN."""
    if math.isnan(a) or math.isnan(b):
        return None
    bits = struct.unpack("<2q", struct.pack("<2d", a, b))
    first, second = (x if x >= 0 else -(1 << 63) - x for x in bits)
    return abs(first - second)
