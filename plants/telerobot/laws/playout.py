"""A play-out buffer: what comes with a tick number is used exactly N ticks after that tick.

    wire tick of k      = 1 + k mod 4095;  0 means that nothing was sent yet                 (1)
    entry of tick k     slot k mod 512, put there when its frame comes, if that is not late  (2)
    at tick j           the entry of j - N, once; none there: hold the last one and count it (3)

Latency and jitter of the bus below N ticks disappear in it: the delay is N ticks, whatever a frame
took. A ring holds 512 entries, EMPTY for none. Times are whole ticks; N = 0 needs no buffer.
Source: chosen by this project.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
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
def slot(tick: float) -> int:
    """Return the place of the entry of a tick in a ring."""
    return int(tick - SLOTS * floor(tick / SLOTS))


@inline
def put(ring: Array, number: float, now: float, delay: float, value: float) -> None:
    """Put a value that came with wire tick `number` into the ring (512,), see (2)."""
    at = slot(tick_of(number, now))
    ring[at] = where(in_time(number, now, delay), value, ring[at])


@inline
def take(ring: Array, tick: float, held: float) -> tuple[float, float]:
    """Take the entry of `tick` out; return it and 0, or `held` and 1 if there is none (3).

    `ring`: (512,).
    """
    at = slot(tick)
    entry = ring[at]
    ring[at] = EMPTY
    missing = entry >= EMPTY
    return where(missing, held, entry), where(missing, 1.0, 0.0)
