"""Values that cannot be true, as a receiver judges them: what mutants are run on.

What is expected stands here a second time, in plain Python, from the head of
`executive.loop.plausibility`. Values, ages and counts are drawn on their limits and beside them.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.plausibility import EVENT_CYCLES, Implausibility
from pcpc.tools.dev.evidence.episodes import Episodes

EPISODES, STEPS = 60, 150
ROWS, PLACES, COUNTS = (0, 0, 1), (20, 21, 22), (30, 31, 32)
DRIVER = """

@loop_function
def plausible(_m, n, about, values, told, kept):
    for s in range(about.shape[0]):
        a, t, these = about[s], told[s], n.plausible
        n.k = a[0]
        if a[2] != 0:
            n.guard.faulted = a[3]
        for i in range(these.n):
            if these.row[i] == a[1]:
                n.v[these.place[i]] = values[s, i]
        n.event_taken[0] = n.event_ends.head
        t[0] = m_take_plausible(_m, n, a[1])
        t[1], t[2], t[3] = n.control.implausible, n.guard.faulted, n.control.culprit
        t[4], t[5], t[6] = n.control.odd_place, n.control.odd_cycle, n.control.odd_bits
        event = n.event[(n.event_ends.head - 1) % 1024]
        t[7], t[8], t[9], t[10] = n.event_ends.head, event.code, event.argument, event.bits
        for i in range(these.n):
            kept[s, i] = n.v[these.place[i]]
            kept[s, these.n + i] = n.v[these.count_place[i]]
"""


def _bits(x: float) -> int:
    return int(np.float64(x).view(np.int64))


@dataclass
class Signal:
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


@dataclass
class Receiver:
    """What a node makes of received values."""

    signals: list[Signal]
    fault: int = 0
    count: int = 0
    why: int = 0
    odd: tuple[int, int, int] = (0, 0, 0)
    events: int = 0
    event: tuple[int, int, int] = field(default=(0, 0, 0))

    def step(self, about: list[int], values: list[float]) -> tuple[list[int], list[float]]:
        """Return what is told and kept after a step."""
        k, row, sets, fault = about
        self.fault = fault if sets else self.fault
        own = [i for i, its in enumerate(ROWS) if its == row]
        for i in own:
            signal, x = self.signals[i], values[i]
            why = signal.judge(x, k)
            if why == Implausibility.GOOD:
                signal.taken, signal.taken_at, signal.in_a_row = x, k, 0
            else:
                self.refuse(i, x, k, why)
        known = all(self.signals[i].taken_at != -1 for i in own)
        told = [known, self.count, self.fault, self.why, *self.odd, self.events, *self.event]
        kept = [signal.taken for signal in self.signals]
        return told, kept + [signal.count for signal in self.signals]

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


def _drawn_steps(draw: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the steps of an episode: cycle, row, whether and which fault stands; the values."""
    about = np.zeros((STEPS, 4), np.int64)
    steps = draw.choice([0, 1, 2, 3, 99], STEPS, p=[0.1, 0.6, 0.2, 0.09, 0.01])
    steps[:2] = 0, 1  # what is taken in cycle 0 was taken
    about[:, 0] = np.cumsum(steps)
    about[:, 1] = draw.integers(0, 3, STEPS)  # row 2 has no limits
    about[1, 1] = about[0, 1]
    about[:, 2] = draw.random(STEPS) < 0.1
    about[:, 3] = np.where(draw.random(STEPS) < 0.2, draw.integers(1, 5, STEPS), 0)
    moves = draw.choice(np.array([0.0, 0.0, 0.25, -0.25, 0.5, -0.5, 0.75]), (STEPS, len(ROWS)))
    values = (np.cumsum(moves, axis=0) + 1.5) % 3.0 - 1.5
    edge = [math.nan, math.inf, -math.inf, 1e300, -1e300, math.nextafter(1e300, 0.0), 1.0, -1.0]
    odd = draw.random(values.shape) < 0.08
    values[odd] = draw.choice(edge, int(odd.sum()))
    return about, values


def _signals(number: int, draw: np.random.Generator) -> list[Signal]:
    """Return signals: one within bounds, one with a rate, one without either."""
    after, still = draw.integers(1, 4, 3).tolist(), draw.integers(1, 6, 3).tolist()
    bounds = [(-1.0, 1.0, math.inf), (-1.25, 1.25, 0.25), (-math.inf, math.inf, math.inf)]
    turned = bounds[number % 3 :] + bounds[: number % 3]
    return [Signal(*one, still[i], after[i]) for i, one in enumerate(turned)]


def install(these: Any, signals: list[Signal]) -> None:
    """Write the limits of signals into their part of the LOOP record."""
    these.n = len(signals)
    for i, one in enumerate(signals):
        these.row[i], these.place[i], these.count_place[i] = ROWS[i], PLACES[i], COUNTS[i]
        these.still_cycles[i], these.fault_after[i] = one.still, one.after
        these.bounds[i] = one.low, one.high, one.rate
        these.taken_at[i], these.came[i] = -1, math.nan


def receiver(driver: Any, draw: np.random.Generator, count: int) -> Any:
    """Feed what judges values with `count` episodes."""
    episodes = Episodes(driver.plausible)
    for number in range(count):
        signals = _signals(number, draw)
        install(episodes.new_loop().plausible, signals)
        about, values = _drawn_steps(draw)
        model = Receiver(signals)
        steps = zip(about.tolist(), values.tolist(), strict=True)
        told, kept = zip(*(model.step(*step) for step in steps), strict=True)
        episodes.add((about, values), (np.array(told, np.int64), np.array(kept, np.float64)))
    return episodes.differ
