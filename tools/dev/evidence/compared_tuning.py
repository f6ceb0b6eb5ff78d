"""Tunings of the rig and of clients: what mutants are run on.

What is expected stands here a second time, in plain Python, from the head of
`executive.loop.tuning`, docs/rig.md and docs/bus-safety.md. Values are drawn on the ends of their
ranges, counts and indices beside theirs.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.loop.clock import Time
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.requests import Refusal
from pcpc.executive.loop.states import State
from pcpc.executive.loop.variables import RESET_ASKED, STATE, STOP_ASKED
from pcpc.tools.dev.evidence.episodes import Episodes

STEPS, VARIABLES, FAULT_AT = 120, 200, 190
RANGES = {150: (-1.0, 1.0), 0: (0.0, 4.0), 151: (-math.inf, math.inf), 199: (2.0, 2.0),
          200: (0.0, 1.0), STOP_ASKED: (0.0, 2.0), RESET_ASKED: (0.0, 1.0)}  # fmt: skip
SCHEDULE = ((3, 150, 0.5), (3, 151, 7.0), (9, 150, -4.0), (60, 199, 0.0))  # the rig may do all
STUBS = """
from types import ModuleType
libc = ModuleType("libc")
def _load(record, word):
    return record.request
def _store(record, word, value):
    record.request = value
libc.load_acquire, libc.store_release = loop_function(_load), loop_function(_store)
_push = push_event
def _limited(n, code, argument, value):
    _push(n, code, argument, value)
    if n.event_ends.dropped > 0:  # dropped
        n.k = -(1 << 62)
push_event = loop_function(_limited)
"""  # no mutant may go on for ever
DRIVER = """

@loop_function
def tuned(_m, n, about, gain, index, value, told, kept):
    for s in range(about.shape[0]):
        a, t = about[s], told[s]
        n.k, n.clock.kind, n.clock.behind, n.faults.stalled = a[0], a[1], a[2], a[3]
        n.mail.request, n.mail.count, n.mail.lock = a[4], a[5], a[6]
        n.v[1], n.guard.waits, n.guard.gain, n.faults.n_places = a[7], a[8], gain[s], a[9]
        for i in range(64):
            n.mail_index[i], n.mail_value[i] = index[s, i], value[s, i]
        n.event_taken[0] = n.event_ends.head
        m_tune(_m, n)
        for i in range(4):
            t[i] = words(n.answer)[i]
        event = n.event[(n.event_ends.head - 1) % 1024]
        t[4], t[5], t[6], t[7] = n.event_ends.head, event.code, event.argument, event.bits
        t[8], t[9] = n.control.refused, n.tuning.done
        for i in range(201):
            kept[s, i] = n.v[i]
"""


def _bits(x: float) -> int:
    return int(np.float64(math.nan if x != x else x).view(np.int64))


class TuningModel:
    """What a node makes of tunings."""

    def __init__(self) -> None:
        self.v, self.done, self.refused, self.events = [0.0] * 201, 0, 0, 0
        self.answer, self.event = [0, 0, 0, 0], (0, 0, 0)
        self.v[FAULT_AT] = 100.0

    def step(
        self, given: list[int], gain: float, index: list[int], value: list[float]
    ) -> tuple[list[int], list[float]]:
        """Return what is told and kept after a step."""
        k, clock, behind, stalled, request, count, lock, state, waits, places = given
        self.v[STATE] = state
        if places and clock != Time.GIVEN:
            self.v[FAULT_AT] = max(self.v[FAULT_AT] - (1 + behind - stalled), 0.0)
        while self.done < len(SCHEDULE) and SCHEDULE[self.done][0] <= k:
            self.set(*SCHEDULE[self.done][1:])
            self.done += 1
        if request != self.answer[0]:
            may_reset = state == State.FAULT and waits and gain <= 0.0
            asked = list(zip(index, value, strict=True))
            why, entry = self.refusal(asked, count, lock, bool(may_reset))
            if why == Refusal.ACCEPTED:
                for one in asked[:count]:
                    self.set(*one)
            else:
                self.refused += 1
                self.tell(Event.REFUSED, *asked[entry])
            self.answer = [request, k, why, entry]
        return [*self.answer, self.events, *self.event, self.refused, self.done], [*self.v]

    def refusal(
        self, asked: list[tuple[int, float]], count: int, lock: int, may_reset: bool
    ) -> tuple[int, int]:
        """Return why a request is refused, and the entry that is the reason."""
        if not 0 <= count <= len(asked):
            return Refusal.BAD_COUNT, 0
        if lock and count and not (count == 1 and asked[0][0] == STOP_ASKED):
            return Refusal.LOCKED, 0
        for i, (place, value) in enumerate(asked[:count]):
            if place not in RANGES or place >= VARIABLES:
                return Refusal.NO_PARAMETER, i
            low, high = RANGES[place]
            if not (math.isfinite(value) and low <= value <= high):
                return Refusal.OUT_OF_RANGE, i
            if place == RESET_ASKED and not may_reset:
                return Refusal.NO_RESET, i
        return Refusal.ACCEPTED, 0

    def set(self, place: int, value: float) -> None:
        """Apply a tuning."""
        self.v[place] = value
        self.tell(Event.TUNING, place, value)

    def tell(self, code: int, place: int, value: float) -> None:
        """Note an event."""
        self.events, self.event = self.events + 1, (code, place, _bits(value))


def _drawn_steps(draw: np.random.Generator) -> tuple[NDArray[Any], ...]:
    """Return steps, gains, and what stands in the mailbox: indices and values."""
    about, gain = np.zeros((STEPS, 10), np.int64), draw.choice([0.0, 0.0, 0.5, -0.5], STEPS)
    about[:, 0] = np.cumsum(draw.integers(0, 3, STEPS))
    about[:, 1] = draw.choice([Time.REAL, Time.GIVEN], STEPS)
    about[:, 2] = draw.choice([0, 0, 3], STEPS)
    about[:, 3] = np.minimum(draw.choice([0, 1], STEPS), about[:, 2])
    about[:, 4] = np.cumsum(draw.random(STEPS) < 0.8)
    counts, weights = [-1, 0, 1, 2, 63, 64, 65], [0.1, 0.1, 0.3, 0.3, 0.05, 0.1, 0.05]
    about[:, 5] = draw.choice(counts, STEPS, p=weights)
    about[:, 6] = draw.choice([0, 0, 1, 2], STEPS)
    about[:, 7] = np.where(draw.random(STEPS) < 0.7, State.FAULT, draw.integers(0, 6, STEPS))
    about[:, 8], about[:, 9] = draw.random(STEPS) < 0.7, draw.random(STEPS) < 0.5
    good = [place for place in RANGES if place < VARIABLES]
    index = draw.choice([150, 151, 199, 0], (STEPS, 64))
    index[:, 0] = draw.choice([*good, STOP_ASKED, RESET_ASKED], STEPS)
    odd = draw.random(index.shape) < np.where(np.arange(64) < 2, 0.12, 0.002)
    index[odd] = draw.choice([-1, 200, 201, 8000, 149, RESET_ASKED, STOP_ASKED], int(odd.sum()))
    ends = np.array([RANGES.get(place, (0.0, 1.0)) for place in range(-1, 8001)]).clip(-3.0, 3.0)
    low, high = ends[index + 1, 0], ends[index + 1, 1]
    drawn = np.stack([low, high, np.full_like(low, 2.0), np.full_like(low, 0.5)])
    value = np.choose(draw.integers(0, 4, index.shape), drawn).clip(low, high)
    wild = draw.random(value.shape) < np.where(np.arange(64) < 2, 0.08, 0.002)
    value[wild] = draw.choice([math.nan, math.inf, -math.inf, -1.25, 4.5, 1.25], int(wild.sum()))
    value[about[:, 5] > 64, 0] = 0.0  # these bits are the index behind the last one
    return about, gain, index, value


def tuning(driver: Any, draw: np.random.Generator, count: int) -> Any:
    """Feed tune with `count` episodes."""
    episodes = Episodes(driver.tuned)
    n = episodes.new_loop()
    n.n_variables, n.faults.every_place[0], n.v[FAULT_AT] = VARIABLES, FAULT_AT, 100.0
    n.tuning.low[:] = n.tuning.high[:] = math.nan
    for place, (low, high) in RANGES.items():
        n.tuning.low[place], n.tuning.high[place] = low, high
    n.tuning.n, n.tuning.schedule["cycle"][8:] = len(SCHEDULE), 8000  # no mutant runs past the end
    for i, (cycle, place, value) in enumerate(SCHEDULE):
        n.tuning.schedule[i], n.tuning.value[i] = (cycle, place), value
    for _ in range(count):
        drawn, model = _drawn_steps(draw), TuningModel()
        steps = zip(*(one.tolist() for one in drawn), strict=True)
        told, kept = zip(*(model.step(*step) for step in steps), strict=True)
        episodes.add(drawn, (np.array(told, np.int64), np.array(kept)))
    return episodes.differ
