"""Check that this thread computes the bits of `emath` that every other machine computes.

A foreign library may have changed the rounding mode or switched subnormal numbers off (one linked
with gcc -ffast-math does), or a compiler may contract a*b + c. Then no run would replay elsewhere.
Both modes belong to a thread: call `selftest` at the start of the thread that runs the loop.
"""

import hashlib
import sys

import numpy as np

from pcpc.drivers.compiled.jit import compiled
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws import emath

POINTS = 1000
GOLDEN = 0.6180339887498949  # its multiples modulo 1 spread evenly over 0..1

FINGERPRINTS = {
    "exp": "6c821e3a6fc63bdf",
    "expmsq": "38bb297d7046b94d",
    "tanh": "c92556f239160492",
    "logistic": "85339b1b7469f1e0",
    "sin": "5b3c6069b188f8db",
    "cos": "70e3fa1e6a20745b",
    "sqrt": "2d5c96b56e304872",
    "pow2": "3cb28065c690958c",
    "floor": "474b78db1eacbd0f",
    "clip": "ef7608fe0e90e5fb",
    "sign": "16fd07e4e6633a38",
}


@compiled()
def evaluate(out: Array) -> None:
    """Write each function of FINGERPRINTS at spread points to its row of `out` (11, n).

    The results of exp, expmsq and logistic and the arguments of sqrt are in part subnormal.
    """
    for i in range(out.shape[1]):
        t = i * GOLDEN
        s = 2.0 * (t - emath.floor(t)) - 1.0
        wide = s * s * s  # -1..1, dense at 0
        out[0, i] = emath.exp(745.0 * wide)
        out[1, i] = emath.expmsq(27.3 * s)
        out[2, i] = emath.tanh(22.0 * wide)
        out[3, i] = emath.logistic(745.0 * wide)
        out[4, i], out[5, i] = emath.sincos(emath.ANGLE_MAX * wide)
        out[6, i] = emath.sqrt(2e-307 * abs(wide))
        out[7, i] = emath.pow2(emath.floor(1022.0 * s))
        out[8, i] = emath.floor(1e6 * wide)
        out[9, i] = emath.clip(s, -0.3, 0.7)
        out[10, i] = emath.sign(s)


def fingerprints() -> dict[str, str]:
    """Return 16 hex digits over the values of each function, computed in the calling thread.

    These are the values for FINGERPRINTS after a function has been changed on purpose.
    """
    out = np.empty((len(FINGERPRINTS), POINTS))
    evaluate(out)
    rows = zip(FINGERPRINTS, out.astype("<f8"), strict=True)
    return {name: hashlib.sha256(row.tobytes()).hexdigest()[:16] for name, row in rows}


def floating_point_fault() -> str:
    """Return what is wrong with the calling thread's floating-point modes; "" if nothing is."""
    one, smallest = 1.0, sys.float_info.min
    if smallest / 2.0 == 0.0:
        return "subnormal numbers are flushed to zero"
    if one + 2.0**-53 != one or one - 2.0**-54 != one:
        return "the rounding mode is not to nearest"
    return ""


def selftest() -> None:
    """Compare all functions with their stored fingerprints.

    Raises RuntimeError with the functions that differ and the probable cause.
    """
    now = fingerprints()
    changed = [name for name, stored in FINGERPRINTS.items() if now[name] != stored]
    if not changed:
        return
    fault = floating_point_fault()
    cause = "executive/laws/emath.py was edited, or the compiler contracts a*b + c"
    if fault:
        cause = f"{fault}; a library loaded into this process did that: load it elsewhere"
    raise RuntimeError(
        f"the bits differ from those of other machines in {', '.join(changed)}: "
        f"a log would not replay there. {cause}"
    )
