"""Other senders of a node's frames, and cycles that ran past their end: what mutants are run on.

What is expected stands here a second time, in plain Python, from docs/bus-safety.md and the head of
`executive.loop.strangers`. Ages, counts and windows are drawn on their limits and beside them.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pcpc.drivers.can.e2e_states import FrameState
from pcpc.executive.loop.clock import Time
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.strangers import is_foreign, note_foreign, note_repeat
from pcpc.executive.loop.supervisor import Overrun, judge_overrun
from pcpc.executive.loop.variables import FALLBACK
from pcpc.tools.dev.evidence.comparison import LAST_EVENT, Compared, Episodes, frame_word, same

STEPS = 150
IDS, OWN, EVERY = (0x120, 0x121, 0x200), (0x0A0, 0x080), (1, 1, 5)
SILENT, FOREIGN_LIMIT, REPEAT_LIMIT = 3, (3, 10), (10, 100)  # frames within so many cycles


class Step(NamedTuple):
    """A frame and a cycle that may be late."""

    passes: int
    source: int
    behind: int
    row: int
    word: int
    sets: int
    fault: int
    age: int
    repeated: int


def heard(n: Any, given: Step) -> Any:
    """Judge the sender of a frame, then the cycle."""
    n.passes, n.wire.source, n.clock.behind = given.passes, given.source, given.behind
    if given.sets != 0:
        n.guard.faulted = given.fault
        n.v[FALLBACK] = 0.0
    for i in range(4):
        n.wire.rx[i] = given.word >> 8 * i & 255
    if given.row >= 0:
        n.rx.state[given.row].age_cycles = given.age
    n.frame_taken[0] = n.frame_ends.head
    n.event_taken[0] = n.event_ends.head
    foreign = is_foreign(n, given.row, given.word)
    if foreign != 0:
        note_foreign(n, given.word)
    elif given.repeated != 0:
        note_repeat(n, given.word)
    judge_overrun(n)
    return foreign


class Senders:
    """What a node makes of frames from others, and of late cycles."""

    def __init__(self, policy: int, after: int, grace: int, stop_row: int) -> None:
        self.policy, self.after, self.grace, self.stop_row = policy, after, grace, stop_row
        self.source, self.foreign, self.fault, self.culprit = [0, 0, 0], 0, 0, 0
        self.every: Sequence[int] = EVERY
        self.overruns = self.fallback = self.frames = self.frame = self.events = 0
        self.event, self.windows = (0, 0, 0), {FOREIGN_LIMIT: [0, 0], REPEAT_LIMIT: [0, 0]}

    def step(self, given: Step) -> None:
        """Judge a frame, then the cycle."""
        if given.sets:
            self.fault, self.fallback = given.fault, 0
        passes, word = given.passes, given.word
        self.stranger = self.is_foreign(passes, given.source, given.row, word, given.age)
        if self.stranger:
            self.frames, self.frame = self.frames + 1, word | 1 << 40 | FrameState.FOREIGN << 48
            self.note_foreign(passes, word)
        elif given.repeated:
            self.note_repeat(passes, word)
        self.judge(passes, given.behind)
        self.refused = passes == 0 and self.fault == Fault.ANOTHER_SENDER

    def is_foreign(self, passes: int, source: int, row: int, word: int, age: int) -> bool:
        """Return whether a frame is one of this node's, or not from its sender."""
        if row < 0:
            return word in OWN
        if row == self.stop_row or source == self.source[row]:
            return False
        may_replace = self.source[row] == 0 or passes == 0 or age > SILENT * self.every[row]
        if source != -1 and may_replace:
            self.source[row] = source
            return False
        return True

    def note_foreign(self, passes: int, word: int) -> None:
        """Count a frame of another; tell the first of a window, fault after too many."""
        self.foreign += 1
        count = self.counted(FOREIGN_LIMIT, passes)
        if count == 1:
            self.tell(Event.FOREIGN, word & 0x1FFFFFFF, self.foreign)
        if count >= FOREIGN_LIMIT[0] or passes == 0:
            self.blame(Fault.ANOTHER_SENDER, word)

    def note_repeat(self, passes: int, word: int) -> None:
        """Count a repeated frame; fault after too many."""
        if self.counted(REPEAT_LIMIT, passes) >= REPEAT_LIMIT[0]:
            self.blame(Fault.REPEATED_INPUT, word)

    def counted(self, limit: tuple[int, int], passes: int) -> int:
        """Return how many there were in this window."""
        window = self.windows[limit]
        if window[1] == 0 or passes >= window[0] + limit[1]:
            window[:] = passes, 0
        window[1] += 1
        return window[1]

    def tell(self, code: int, argument: int, value: float) -> None:
        """Note an event."""
        bits = int(np.float64(value).view(np.int64))
        self.event, self.events = (code, argument, bits), self.events + 1

    def blame(self, fault: int, word: int) -> None:
        """Fault, if nothing was wrong before."""
        if self.fault == 0:
            self.fault, self.culprit = fault, word

    def judge(self, passes: int, behind: int) -> None:
        """Do what the rig says about late cycles in a row."""
        self.overruns = self.overruns + 1 if behind > 0 and passes > self.grace else 0
        if self.policy == Overrun.SKIP or self.overruns < self.after:
            return
        if self.policy == Overrun.FALL_BACK and not self.fallback:
            self.fallback = 1
            self.tell(Event.FALLBACK, behind, 0.0)
        elif self.policy == Overrun.FAULT_AFTER and self.fault == 0:
            self.fault = Fault.OVERRUN


SENDERS = Compared(
    Step, heard,
    whole={
        "came": lambda m: m.stranger, "refused(n)": lambda m: m.refused,
        **same("control.foreign", "control.culprit", "guard.overruns"),
        "guard.faulted": lambda m: m.fault,
        "frame_ends.head": lambda m: m.frames, frame_word(0, 3): lambda m: m.frame,
        "rx.source[0:3]": lambda m: m.source, **LAST_EVENT,
    },
    real={"v[FALLBACK]": lambda m: m.fallback},
)  # fmt: skip


def _draw_steps(given: Any, draw: np.random.Generator) -> None:
    """Draw the steps of an episode."""
    steps = draw.choice([0, 0, 1, 1, 1, 2, 9, 10, 11, 99, 100], STEPS, p=[0.2, 0.2, *[0.12] * 4,
                        0.04, 0.03, 0.03, 0.01, 0.01])  # fmt: skip
    given.passes = np.cumsum(steps)
    given.source = draw.choice([11, 11, 11, 22, -1], STEPS)
    given.behind = np.where(draw.random(STEPS) < 0.6, draw.integers(1, 3, STEPS), 0)
    given.row = draw.integers(-1, 3, STEPS)
    others = np.where(draw.random(STEPS) < 0.3, draw.choice(OWN, STEPS), 0x555)
    given.word = np.where(given.row < 0, others, np.array(IDS)[given.row])
    given.sets = draw.random(STEPS) < 0.08
    given.fault = np.where(draw.random(STEPS) < 0.2, draw.integers(1, 5, STEPS), 0)
    every = np.array(EVERY)[given.row]
    given.age = draw.choice([0, 1, 2], STEPS) + np.where(draw.random(STEPS) < 0.3, 3 * every - 1, 0)
    given.repeated = draw.random(STEPS) < 0.8


def _install(n: Any, policy: int, after: int, grace: int, stop_row: int) -> None:
    n.clock.kind = Time.GIVEN
    n.rx.n, n.tx.n = len(IDS), len(OWN)
    for row, (can_id, every) in enumerate(zip(IDS, EVERY, strict=True)):
        n.rx.frames[row].can_id, n.rx.frames[row].every_n = can_id, every
    n.tx.frames["can_id"][: len(OWN)] = OWN
    n.guard.overrun_policy, n.guard.overrun_after = policy, after
    n.guard.grace_passes, n.guard.stop_row = grace, stop_row


def senders(feed: Any, draw: np.random.Generator, count: int) -> Episodes:
    """Feed what judges other senders and late cycles with `count` episodes."""
    episodes = Episodes(SENDERS, feed)
    for number in range(count):
        has = number % 3, int(draw.integers(1, 4)), int(draw.integers(0, 9)), number % 4 - 2
        _install(episodes.new_loop(), *has)
        rows = episodes.new_rows(STEPS)
        _draw_steps(rows, draw)
        episodes.add(rows, Senders(*has))
    return episodes
