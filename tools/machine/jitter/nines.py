"""How late at 99, 99.9, ... % of the periods, as far as their number supports it.

    wake      from the deadline until the thread runs
    command   from the deadline until send() of the command has returned
    response  from when send() of SYNC(k) had returned until that of the command had that was
              computed from the sample of SYNC(k): about a period, two where the sample was held

All on CLOCK_MONOTONIC of the executive, us. A skipped period counts: its wake-up and its command
are those of the next cycle. A command that the bus refused, or that nothing followed, never came.
Of n sorted times x, with E of the binomial distribution (n, 1 - q):

    point      x(ceil(q n))                                                                   (1)
    interval   x(n - b) to x(n - a), of 95 %; a: greatest with P(E <= a) <= 2.5 %             (2)
                                              b: least with P(E <= b) >= 97.5 %
    a < 0      all n may lie below the quantile: its upper end is unknown                     (3)

It holds for any distribution, of cycles that do not depend on each other; where they are late in
bursts, it is too narrow.
Source: David, Nagaraja, Order Statistics, 3rd ed. (2003), 7.1.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from pcpc.tools.study.binomial import runs_needed
from pcpc.tools.terminal.answer import one_of

WAYS = {
    "wake": "deadline to wake-up",
    "command": "deadline to command sent",
    "response": "SYNC(k) to command(k)",
}
TAIL = 0.025  # on either side of an interval
HELD, BROKEN, OPEN, TOO_FEW = "held", "broken", "open", "not judged"
_FEWEST_BEYOND = Fraction(1, 10**9)  # of the nines that are printed
Vector = NDArray[np.float64]
Ints = NDArray[np.int64]
Judged = tuple[str, "Point", float, str]  # way, quantile, limit in us, verdict
Way = Annotated[str, one_of(*WAYS)]


@dataclass(frozen=True)
class Point:
    """A quantile (1) (2), us; None where an end is unknown (3)."""

    percent: Fraction
    cycles: int
    value: float
    low: float | None
    high: float | None


class Quantile(Struct):
    """At a percentage of the periods."""

    value: float | None
    "us; null: it never came"
    low: float | None
    "of the 95 % interval, us"
    high: float | None
    "of the 95 % interval, us"


_BY_PERCENT = Meta(
    extra_json_schema={
        "properties": {"cycles": {"type": "integer", "minimum": 0}},
        "required": ["cycles"],
    }
)
_Percent = Annotated[str, Meta(pattern="^(cycles|[0-9.]+)$")]
Quantiles = Annotated[dict[_Percent, Quantile], _BY_PERCENT]


class Limit(Struct):
    """A limit, and what became of it."""

    of: Way
    percent: float
    "of the periods"
    limit_us: float
    "us"
    verdict: Annotated[str, one_of(HELD, BROKEN, OPEN, TOO_FEW)]
    value: float | None
    "us; null: it never came"
    low: float | None
    "of the 95 % interval, us"
    high: float | None
    "of the 95 % interval, us"


def whole_path(
    cycle: Ints,
    late_us: Vector,
    wakes_ns: Ints,
    commands_ns: Ints,
    syncs_ns: Ints,
    refused: NDArray[np.bool_],
    held: NDArray[np.bool_],
    period_us: float,
    periods: int,
) -> dict[str, Vector]:
    """Return the times of WAYS of a round of `periods`.

    Of each cycle: its number, lateness, the stamps of its wake-up, its command and the SYNC before
    it; whether the bus refused one of its frames, whether its sample was held.
    Each array: (periods,).
    """
    to_command = late_us + 1e-3 * (commands_ns - wakes_ns)
    to_command[refused] = np.inf
    sampled = np.maximum.accumulate(np.where(held, 0, np.arange(len(cycle))))
    response = 1e-3 * (commands_ns - syncs_ns[sampled])
    response[refused | np.concatenate([[False], refused])[sampled]] = np.inf
    skipped = np.diff(cycle) - 1
    never = np.full(periods - 1 - int(cycle[-1]), np.inf)
    after = np.repeat(np.arange(1, len(cycle)), skipped)  # the cycle that follows each
    first = np.repeat(np.cumsum(skipped) - skipped, skipped)
    behind = (np.arange(len(after)) - first + 1) * period_us
    found = {
        name: np.concatenate([times, times[after] + behind, never])
        for name, times in (("wake", late_us), ("command", to_command))
    }
    return found | {"response": response[1:]}  # before the first one the clock was set


def cycles_needed(percent: Fraction) -> int:
    """Return how many cycles give the interval of a quantile an upper end."""
    return runs_needed(float(1 - percent / 100), 1.0 - TAIL)


def ranks(cycles: int, percent: Fraction) -> tuple[int | None, int, int | None]:
    """Return the ranks, from 1, of (2)'s lower end, (1) and (2)'s upper end; None: there is none.

    The distribution is summed up around its mean, as far as a double can tell it from 0.
    """
    p, q = float(1 - percent / 100), float(percent / 100)
    mean, reach = cycles * p, 12.0 * math.sqrt(cycles * p * q) + 30.0
    low, high = max(0, math.floor(mean - reach)), min(cycles, math.ceil(mean + reach))
    k = np.arange(low, high)
    logs = np.cumsum(np.concatenate([[0.0], np.log((cycles - k) / (k + 1.0)) + math.log(p / q)]))
    shares = np.exp(logs - logs.max())
    below = np.cumsum(shares / shares.sum())
    a = low - 1 + int(np.searchsorted(below, TAIL, "right"))
    b = low + int(np.searchsorted(below, 1.0 - TAIL, "left"))
    point = max(math.ceil(percent / 100 * cycles), 1)
    return (cycles - b if b < cycles else None), point, (cycles - a if a >= 0 else None)


def point(times_us: Vector, percent: Fraction) -> Point:
    """Return a quantile of at least one time; they are sorted. `times_us`: (n,)."""
    low, middle, high = (
        None if rank is None else float(times_us[rank - 1])
        for rank in ranks(len(times_us), percent)
    )
    assert middle is not None
    return Point(percent, len(times_us), middle, low, high)


def nines(times_us: Vector) -> Iterator[Point]:
    """Yield the quantiles 99, 99.9, ... % whose interval is known; the times are sorted.

    `times_us`: (n,).
    """
    beyond = Fraction(1, 100)
    while beyond >= _FEWEST_BEYOND and cycles_needed(100 - 100 * beyond) <= len(times_us):
        yield point(times_us, 100 - 100 * beyond)
        beyond /= 10


def judged(found: Point, limit_us: float) -> str:
    """Return whether a limit holds: the whole interval is below it, or not, or nobody knows."""
    if found.low is not None and found.low >= limit_us:
        return BROKEN
    if found.high is None:
        return TOO_FEW
    return HELD if found.high < limit_us else OPEN


def verdicts(
    paths: Mapping[str, Vector], limits: Mapping[tuple[str, Fraction], float]
) -> list[Judged]:
    """Return what became of each limit, us; the times are sorted. Each way: (n,)."""
    points = [(way, point(paths[way], percent), us) for (way, percent), us in limits.items()]
    return [(way, found, us, judged(found, us)) for way, found, us in points]


def lines(paths: Mapping[str, Vector], interval_ns: int, rounds: int) -> Iterator[str]:
    """Yield the nines of all ways, and what the next one needs; the times are sorted.

    Each way: (n,).
    """
    yield f"{'nines of the executive, us':38}{'%':>11}{'time':>10}   95 % interval"
    for way, times in paths.items():
        label = f"  {way:10}{WAYS[way]}"
        for found in nines(times):
            yield f"{label:38}{_percent(found):>11}{_us(found.value):>10}   {_interval(found)}"
            label = ""
    known = min(len(list(nines(times))) for times in paths.values())
    more = 100 - Fraction(100, 10 ** (known + 2))
    needs = f"{_percent(more)} % {_needs(more, interval_ns, rounds)}"
    yield f"  {len(paths['wake']):,} periods, skipped ones too; {needs}"


def limit_lines(found: list[Judged], interval_ns: int, rounds: int) -> Iterator[str]:
    """Yield a line for each limit, and the interval that it was judged by."""
    for way, one, limit_us, verdict in found:
        why = f"{_interval(one)} us"
        if verdict == TOO_FEW:
            why = _needs(one.percent, interval_ns, rounds)
        limit = f"< {limit_us:.9g} us"
        yield f"  {way:8} {_percent(one):>9} %  {limit:13} {verdict}: {why}"


def quantiles(paths: Mapping[str, Vector]) -> dict[str, Any]:
    """Return the nines by way and percent, with how many cycles there are. Each way: (n,)."""
    return {
        way: {"cycles": len(times)}
        | {_percent(one): Quantile(*_numbers(one)) for one in nines(times)}
        for way, times in paths.items()
    }


def limits(found: list[Judged]) -> list[Limit]:
    """Return the judged limits."""
    return [
        Limit(way, float(one.percent), us, verdict, *_numbers(one))
        for way, one, us, verdict in found
    ]


def _numbers(one: Point) -> Iterator[float | None]:
    """Yield a quantile and its ends; None for an unknown end and for a time without end."""
    for value in (one.value, one.low, one.high):
        yield None if value is None or math.isinf(value) else value


def _percent(one: Point | Fraction) -> str:
    return f"{float(one.percent if isinstance(one, Point) else one):.12g}"


def _us(value: float | None) -> str:
    return "?" if value is None else "never" if math.isinf(value) else f"{value:.1f}"


def _interval(one: Point) -> str:
    return f"{_us(one.low)} to {_us(one.high)}"


def _needs(percent: Fraction, interval_ns: int, rounds: int) -> str:
    """Return how many cycles a quantile needs, and the option that gives a few more."""
    cycles = cycles_needed(percent)
    seconds = math.ceil(1e-9 * interval_ns * (1.01 * cycles + 2 * rounds))
    return f"needs {cycles:,}, -D {seconds}s"
