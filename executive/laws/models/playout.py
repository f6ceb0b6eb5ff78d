"""A play-out buffer: what comes with a tick number is used exactly N ticks after that tick.

    wire tick of k      1 + k mod 4095;  0 means that nothing was sent yet                   (1)
    entry of tick k     slot k mod 512, put there when its frame comes, if that is not late  (2)
    at tick j           the entry of j - N, once; none there: hold the last one and count it (3)

Latency and jitter of the bus below N ticks disappear in it: the delay is N ticks, whatever a frame
took. A ring is a view of 512 entries of `width` values. An entry whose first value is EMPTY is
none. Times are whole ticks; N = 0 needs no buffer.
"""

from typing import Any

from pcpc.drivers.jit import inline
from pcpc.executive.laws.emath import floor, where

SLOTS = 512
LONGEST = SLOTS - 1.0  # ticks of delay
PERIOD = 4095.0  # of wire ticks
EMPTY = 1e300


@inline
def wire_tick(tick: float) -> float:
    """Return the number (1) that a frame of `tick` carries."""
    return 1.0 + tick - PERIOD * floor(tick / PERIOD)


@inline
def tick_of(number: float, now: float) -> float:
    """Return the tick nearest to `now` whose number (1) is `number`."""
    behind = now - (number - 1.0)
    return now - (behind - PERIOD * floor(behind / PERIOD + 0.5))


@inline
def in_time(number: float, now: float, delay: float) -> bool:
    """Return whether a frame with this number came and its play-out is not over."""
    due = tick_of(number, now) + delay
    return (number > 0.5) & (due >= now) & (due < now + SLOTS)


@inline
def slot(tick: float, width: int) -> int:
    """Return where the entry of a tick begins in a ring."""
    return int(tick - SLOTS * floor(tick / SLOTS)) * width


@inline
def put(ring: Any, width: int, number: float, now: float, delay: float, u: Any, at: int) -> None:
    """Put u[at..at+width-1], which came with wire tick `number`, into the ring (2)."""
    first = slot(tick_of(number, now), width)
    fits = in_time(number, now, delay)
    for i in range(width):
        ring[first + i] = where(fits, u[at + i], ring[first + i])


@inline
def take(ring: Any, width: int, tick: float, held: Any) -> float:
    """Take the entry of `tick` out of the ring into `held`; return 0, or 1 if there is none (3)."""
    first = slot(tick, width)
    missing = ring[first] >= EMPTY
    for i in range(width):
        held[i] = where(missing, held[i], ring[first + i])
    ring[first] = EMPTY
    return where(missing, 1.0, 0.0)
