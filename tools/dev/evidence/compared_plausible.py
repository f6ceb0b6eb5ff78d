"""Values that cannot be true, as a receiver judges them: what mutants are run on.

What is expected stands here a second time, in plain Python, from the head of
`executive.loop.plausibility`. Values, ages and counts are drawn on their limits and beside them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import numpy as np

from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.plausibility import EVENT_CYCLES, Implausibility, take_plausible
from pcpc.tools.dev.evidence.comparison import LAST_EVENT, Compared, Episodes

STEPS = 150
ROWS, PLACES, COUNTS = (0, 0, 1), (20, 21, 22), (30, 31, 32)


def _bits(x: float) -> int:
    return int(np.float64(x).view(np.int64))


@dataclass
class LimitedSignal:
    """A limited signal and what came of it."""

    low: float
    high: float
    rate: float
    still: int
    after: int
    taken: float = 0.0
    taken_at: int = -1
    came: float = math.nan
    came_at: int = 0
    in_a_row: int = 0
    told_until: int = 0
    count: float = 0.0

    def judge(self, x: float, k: int) -> int:
        """Return what is wrong with a value in cycle k."""
        if x != self.came:
            self.came, self.came_at = x, k
        if not math.isfinite(x) or abs(x) >= 1e300:
            return Implausibility.NO_NUMBER
        if not self.low <= x <= self.high:
            return Implausibility.OUTSIDE
        most = self.rate * max(k - self.taken_at, 1)
        if self.taken_at != -1 and abs(x - self.taken) > most:
            return Implausibility.TOO_FAST
        return Implausibility.STILL if k - self.came_at > self.still else Implausibility.GOOD


class Step(NamedTuple):
    """Received values, and a fault that stands."""

    k: int
    row: int
    sets: int
    fault: int
    values: Annotated[Sequence[float], "<f8", len(ROWS)]


def plausible(n: Any, given: Step) -> Any:
    """Put the values of a row into the table; judge them."""
    n.k = given.k
    if given.sets != 0:
        n.guard.faulted = given.fault
    for i in range(n.plausible.n):
        if n.plausible.row[i] == given.row:
            n.v[n.plausible.place[i]] = given.values[i]
    n.event_taken[0] = n.event_ends.head
    return take_plausible(n, given.row)


@dataclass
class LimitedReceiver:
    """What a node makes of received values."""

    signals: list[LimitedSignal]
    known: bool = False
    fault: int = 0
    count: int = 0
    why: int = 0
    odd: tuple[int, int, int] = (0, 0, 0)
    events: int = 0
    event: tuple[int, int, int] = field(default=(0, 0, 0))

    def step(self, given: Step) -> None:
        """Judge the values of a row."""
        self.fault = given.fault if given.sets else self.fault
        own = [i for i, its in enumerate(ROWS) if its == given.row]
        for i in own:
            signal, x = self.signals[i], given.values[i]
            why = signal.judge(x, given.k)
            if why == Implausibility.GOOD:
                signal.taken, signal.taken_at, signal.in_a_row = x, given.k, 0
            else:
                self.refuse(i, x, given.k, why)
        self.known = all(self.signals[i].taken_at != -1 for i in own)

    def refuse(self, i: int, x: float, k: int, why: int) -> None:
        """Count and tell a value; fault after too many in a row."""
        signal = self.signals[i]
        self.count, signal.count = self.count + 1, signal.count + 1
        signal.in_a_row += 1
        if k >= signal.told_until:
            signal.told_until = k + EVENT_CYCLES
            self.event, self.events = (Event.IMPLAUSIBLE, PLACES[i], _bits(x)), self.events + 1
        if signal.in_a_row >= signal.after and self.fault == 0:
            self.fault, self.why = Fault.NOT_PLAUSIBLE, why
            self.odd = PLACES[i] + 1, k, _bits(x)


RECEIVER = Compared(
    Step, plausible,
    whole={
        "came": lambda m: m.known, "control.implausible": lambda m: m.count,
        "guard.faulted": lambda m: m.fault, "control.culprit": lambda m: m.why,
        "control.odd_place": lambda m: m.odd[0], "control.odd_cycle": lambda m: m.odd[1],
        "control.odd_bits": lambda m: m.odd[2], **LAST_EVENT,
    },
    real={
        f"v[{PLACES[0]}:{PLACES[-1] + 1}]": lambda m: [one.taken for one in m.signals],
        f"v[{COUNTS[0]}:{COUNTS[-1] + 1}]": lambda m: [one.count for one in m.signals],
    },
)  # fmt: skip


def _draw_steps(given: Any, draw: np.random.Generator) -> None:
    """Draw the steps of an episode."""
    steps = draw.choice([0, 1, 2, 3, 99], STEPS, p=[0.1, 0.6, 0.2, 0.09, 0.01])
    steps[:2] = 0, 1  # what is taken in cycle 0 was taken
    given.k = np.cumsum(steps)
    given.row = draw.integers(0, 3, STEPS)  # row 2 has no limits
    given.row[1] = given.row[0]
    given.sets = draw.random(STEPS) < 0.1
    given.fault = np.where(draw.random(STEPS) < 0.2, draw.integers(1, 5, STEPS), 0)
    moves = draw.choice(np.array([0.0, 0.0, 0.25, -0.25, 0.5, -0.5, 0.75]), (STEPS, len(ROWS)))
    values = (np.cumsum(moves, axis=0) + 1.5) % 3.0 - 1.5
    edge = [math.nan, math.inf, -math.inf, 1e300, -1e300, math.nextafter(1e300, 0.0), 1.0, -1.0]
    odd = draw.random(values.shape) < 0.08
    values[odd] = draw.choice(edge, int(odd.sum()))
    given.values = values


def _signals(number: int, draw: np.random.Generator) -> list[LimitedSignal]:
    """Return signals: one within bounds, one with a rate, one without either."""
    after, still = draw.integers(1, 4, 3).tolist(), draw.integers(1, 6, 3).tolist()
    bounds = [(-1.0, 1.0, math.inf), (-1.25, 1.25, 0.25), (-math.inf, math.inf, math.inf)]
    turned = bounds[number % 3 :] + bounds[: number % 3]
    return [LimitedSignal(*one, still[i], after[i]) for i, one in enumerate(turned)]


def install(these: Any, signals: list[LimitedSignal]) -> None:
    """Write the limits of signals into their part of the LOOP record."""
    these.n = len(signals)
    for i, one in enumerate(signals):
        these.row[i], these.place[i], these.count_place[i] = ROWS[i], PLACES[i], COUNTS[i]
        these.still_cycles[i], these.fault_after[i] = one.still, one.after
        these.bounds[i] = one.low, one.high, one.rate
        these.taken_at[i], these.came[i] = -1, math.nan


def receiver(feed: Any, draw: np.random.Generator, count: int) -> Episodes:
    """Feed what judges values with `count` episodes."""
    episodes = Episodes(RECEIVER, feed)
    for number in range(count):
        signals = _signals(number, draw)
        install(episodes.new_loop().plausible, signals)
        rows = episodes.new_rows(STEPS)
        _draw_steps(rows, draw)
        episodes.add(rows, LimitedReceiver(signals))
    return episodes
