"""Tunings of the rig and of clients: what mutants are run on.

What is expected stands here a second time, in plain Python, from the head of
`executive.loop.tuning`, docs/rig.md and docs/bus-safety.md. Values are drawn on the ends of their
ranges, counts and indices beside theirs.
"""

import math
from types import ModuleType
from typing import Annotated, Any, NamedTuple

import numpy as np

from pcpc.executive.loop.clock import Time
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.requests import SLOTS, Refusal
from pcpc.executive.loop.rings import push_event
from pcpc.executive.loop.states import State
from pcpc.executive.loop.tuning import tune
from pcpc.executive.loop.variables import RESET_ASKED, STATE, STOP_ASKED
from pcpc.tools.dev.evidence.comparison import LAST_EVENT, Compared, Episodes

STEPS, VARIABLES, FAULT_AT = 120, 200, 190
RANGES = {150: (-1.0, 1.0), 0: (0.0, 4.0), 151: (-math.inf, math.inf), 199: (2.0, 2.0),
          200: (0.0, 1.0), STOP_ASKED: (0.0, 2.0), RESET_ASKED: (0.0, 1.0)}  # fmt: skip
SCHEDULE = ((3, 150, 0.5), (3, 151, 7.0), (9, 150, -4.0), (60, 199, 0.0))  # the rig may do all


def _load(record: Any, word: str) -> Any:
    return record.request


def _store(record: Any, word: str, value: int) -> None:
    record.request = value


def _limited(n: Any, code: int, argument: int, value: float) -> None:
    push_event(n, code, argument, value)
    if n.event_ends.dropped > 0:  # no mutant may go on for ever
        n.k = -(1 << 62)


def put_beside(copy: Any) -> None:
    """Replace what a copy of the module calls."""
    copy.libc = ModuleType("libc")
    copy.libc.load_acquire, copy.libc.store_release = map(copy.loop_function, (_load, _store))
    copy.push_event = copy.loop_function(_limited)


class Step(NamedTuple):
    """A cycle, and what stands in the mailbox."""

    k: int
    clock: int
    behind: int
    stalled: int
    request: int
    entries: int
    lock: int
    state: int
    waits: int
    n_places: int
    gain: float
    places: Annotated[list[int], "<i8", SLOTS]
    values: Annotated[list[float], "<f8", SLOTS]


def tuned(n: Any, given: Step) -> None:
    """Take what stands in the mailbox and in the rig."""
    n.k, n.clock.kind, n.clock.behind = given.k, given.clock, given.behind
    n.mail.request, n.mail.count, n.mail.lock = given.request, given.entries, given.lock
    n.v[STATE], n.guard.waits, n.guard.gain = given.state, given.waits, given.gain
    n.faults.stalled, n.faults.n_places = given.stalled, given.n_places
    for i in range(SLOTS):
        n.mail_index[i], n.mail_value[i] = given.places[i], given.values[i]
    n.event_taken[0] = n.event_ends.head
    tune(n)


def _bits(x: float) -> int:
    return int(np.float64(math.nan if x != x else x).view(np.int64))


class TuningModel:
    """What a node makes of tunings."""

    def __init__(self) -> None:
        self.v, self.done, self.refused, self.events = [0.0] * 201, 0, 0, 0
        self.answer, self.event = [0, 0, 0, 0], (0, 0, 0)
        self.v[FAULT_AT] = 100.0

    def step(self, given: Step) -> None:
        """Do a cycle."""
        self.v[STATE] = given.state
        if given.n_places and given.clock != Time.GIVEN:
            left = self.v[FAULT_AT] - (1 + given.behind - given.stalled)
            self.v[FAULT_AT] = max(left, 0.0)
        while self.done < len(SCHEDULE) and SCHEDULE[self.done][0] <= given.k:
            self.set(*SCHEDULE[self.done][1:])
            self.done += 1
        if given.request != self.answer[0]:
            may_reset = given.state == State.FAULT and given.waits and given.gain <= 0.0
            asked = list(zip(given.places, given.values, strict=True))
            why, entry = self.refusal(asked, given.entries, given.lock, bool(may_reset))
            if why == Refusal.ACCEPTED:
                for one in asked[: given.entries]:
                    self.set(*one)
            else:
                self.refused += 1
                self.tell(Event.REFUSED, *asked[entry])
            self.answer = [given.request, given.k, why, entry]

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


TUNING = Compared(
    Step, tuned,
    whole={
        "words(answer)[0:4]": lambda m: m.answer, **LAST_EVENT,
        "control.refused": lambda m: m.refused, "tuning.done": lambda m: m.done,
    },
    real={f"v[0:{VARIABLES + 1}]": lambda m: m.v},
)  # fmt: skip


def _draw_steps(given: Any, draw: np.random.Generator) -> None:
    """Draw steps, and what stands in the mailbox: indices and values."""
    given.gain = draw.choice([0.0, 0.0, 0.5, -0.5], STEPS)
    given.k = np.cumsum(draw.integers(0, 3, STEPS))
    given.clock = draw.choice([Time.REAL, Time.GIVEN], STEPS)
    given.behind = draw.choice([0, 0, 3], STEPS)
    given.stalled = np.minimum(draw.choice([0, 1], STEPS), given.behind)
    given.request = np.cumsum(draw.random(STEPS) < 0.8)
    counts, weights = [-1, 0, 1, 2, 63, 64, 65], [0.1, 0.1, 0.3, 0.3, 0.05, 0.1, 0.05]
    given.entries = draw.choice(counts, STEPS, p=weights)
    given.lock = draw.choice([0, 0, 1, 2], STEPS)
    given.state = np.where(draw.random(STEPS) < 0.7, State.FAULT, draw.integers(0, 6, STEPS))
    given.waits, given.n_places = draw.random(STEPS) < 0.7, draw.random(STEPS) < 0.5
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
    value[given.entries > 64, 0] = 0.0  # these bits are the index behind the last one
    given.places, given.values = index, value


def tuning(feed: Any, draw: np.random.Generator, count: int) -> Episodes:
    """Feed tune with `count` episodes."""
    episodes = Episodes(TUNING, feed)
    n = episodes.new_loop()
    n.n_variables, n.faults.every_place[0], n.v[FAULT_AT] = VARIABLES, FAULT_AT, 100.0
    n.tuning.low[:] = n.tuning.high[:] = math.nan
    for place, (low, high) in RANGES.items():
        n.tuning.low[place], n.tuning.high[place] = low, high
    n.tuning.n, n.tuning.schedule["cycle"][8:] = len(SCHEDULE), 8000  # no mutant runs past the end
    for i, (cycle, place, value) in enumerate(SCHEDULE):
        n.tuning.schedule[i], n.tuning.value[i] = (cycle, place), value
    for _ in range(count):
        rows = episodes.new_rows(STEPS)
        _draw_steps(rows, draw)
        episodes.add(rows, TuningModel())
    return episodes
