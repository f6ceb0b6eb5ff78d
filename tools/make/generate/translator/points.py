"""What the self-test of generated C computes: every elementary function at spread points."""

from typing import Any

from pcpc.executive.laws.block import inline
from pcpc.executive.laws.emath import (
    ANGLE_MAX,
    clip,
    exp,
    expmsq,
    floor,
    logistic,
    pow2,
    sign,
    sincos,
    sqrt,
    tanh,
)

VALUES, POINTS = 11, 200
GOLDEN = 0.6180339887498949  # its multiples modulo 1 spread evenly over 0..1
DIGEST = 0x60CDFF70DFE8F4A3  # FNV-1a of 64 bits over the bytes of all values, low byte first


@inline
def evaluate(number: float, out: Any) -> None:
    """Write the values of one point to `out` (11,); some results are subnormal."""
    t = number * GOLDEN
    s = 2.0 * (t - floor(t)) - 1.0
    wide = s * s * s  # -1..1, dense at 0
    out[0] = exp(745.0 * wide)
    out[1] = expmsq(27.3 * s)
    out[2] = tanh(22.0 * wide)
    out[3] = logistic(745.0 * wide)
    out[4], out[5] = sincos(ANGLE_MAX * wide)
    out[6] = sqrt(2e-307 * abs(wide))
    out[7] = pow2(floor(1022.0 * s))
    out[8] = floor(1e6 * wide)
    out[9] = clip(s, -0.3, 0.7)
    out[10] = sign(s)
