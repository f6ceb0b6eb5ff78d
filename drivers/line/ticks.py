"""Ticks: the unit of time of a CAN line, of which its bits are whole multiples.

A tick is a bit; with the second bit rate of CAN FD the longest time of which the bits of both rates
are multiples, `bit` and `fast` ticks. A controller divides one clock for both, so there are few.
"""

import math
from collections.abc import Iterable

from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.line.fd_stuffing import Place
from pcpc.drivers.line.line_layout import Line

MOST_TICKS = 9 * 10**9  # a second: `tick_at` and `ns_of` multiply them by 1e9
_S = 1_000_000_000


def ticks_per_s(bitrate: int, data_bitrate: int | None, others: Iterable[int] = ()) -> int:
    """Return the ticks a second at two bit rates, or one, and at those of some senders."""
    return math.lcm(bitrate, data_bitrate or bitrate, *others)


@loop_function
def tick_at(per_s: int, ns: int) -> int:
    """Return how many ticks have passed after `ns`; no product passes 2^63."""
    return ns // _S * per_s + ns % _S * per_s // _S


@loop_function
def ns_of(per_s: int, tick: int) -> int:
    """Return when `tick` ticks have passed, rounded up."""
    return tick // per_s * _S - -(tick % per_s) * _S // per_s


@loop_inline
def ticks_of(line: Line, n: int) -> int:
    """Return how long the first `n` bits of the frame on a line last."""
    first, end = line.places[Place.FAST], line.places[Place.FAST_END]
    return line.bit * n - (line.bit - line.fast) * max(min(n, end) - first, int64(0))
