"""White noise that is bit-identical everywhere: MRG32k3a in exact double arithmetic.

    s1 = (1403580 s1[n-2] -  810728 s1[n-3]) mod m1        m1 = 2^32 - 209                 (1)
    s2 = ( 527612 s2[n-1] - 1370589 s2[n-3]) mod m2        m2 = 2^32 - 22853               (2)
    u  = ((s1 - s2) mod m1, 0 read as m1) / (m1 + 1)       in (0, 1), never 0 or 1         (3)
    w  = u_1 + ... + u_12 - 6                              standard deviate, |w| < 6       (4)

All states are whole numbers below 2^32 and all products below 2^53, so every operation is exact.
The period is about 2^191. A deviate lies within -6 to 6 and has mean 0, variance 1 and kurtosis 2.9
instead of 3.
A stream is six states (6,): s1, then s2, oldest first.

Source: L'Ecuyer, Good parameters and implementations for combined multiple recursive random number
generators, Operations Research 47 (1999), 159-164.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.emath import ROUND, where

STREAM_SIZE = 6
M1, M2 = 4294967087.0, 4294944443.0
_SUMMANDS = 12  # variance 12/12 = 1
_MASK = (1 << 64) - 1


def seeded(seed: int, stream: int) -> list[float]:
    """Return the start state (6,) of a stream; `seed` and `stream` are any two integers."""
    mixed = _splitmix(_splitmix(seed & _MASK) ^ (stream & _MASK))
    state = []
    for modulus in (M1, M1, M1, M2, M2, M2):
        mixed = (mixed + 0x9E3779B97F4A7C15) & _MASK
        state.append(float(_splitmix(mixed) % (int(modulus) - 1) + 1))  # never all zero
    return state


def _splitmix(value: int) -> int:
    value = ((value ^ (value >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
    value = ((value ^ (value >> 27)) * 0x94D049BB133111EB) & _MASK
    return value ^ (value >> 31)


@inline
def uniform(s: Array) -> float:
    """Advance the stream `s` (6,) and return its next number in (0, 1)."""
    a = 1403580.0 * s[1] - 810728.0 * s[0]
    a = a - (a * (1.0 / M1) + ROUND - ROUND) * M1
    a = where(a < 0.0, a + M1, a)  # (1)
    s[0], s[1], s[2] = s[1], s[2], a
    b = 527612.0 * s[5] - 1370589.0 * s[3]
    b = b - (b * (1.0 / M2) + ROUND - ROUND) * M2
    b = where(b < 0.0, b + M2, b)  # (2)
    s[3], s[4], s[5] = s[4], s[5], b
    return where(a <= b, a - b + M1, a - b) / (M1 + 1.0)  # (3)


@inline
def normal(s: Array) -> float:
    """Advance the stream `s` (6,) and return its next standard deviate."""  # (4)
    total = -6.0
    for _ in range(_SUMMANDS):
        total += uniform(s)
    return total
