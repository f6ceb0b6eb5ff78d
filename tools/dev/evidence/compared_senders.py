"""Other senders of a node's frames, and cycles that ran past their end: what mutants are run on.

What is expected stands here a second time, in plain Python, from docs/bus-safety.md and the head of
`executive.loop.strangers`. Ages, counts and windows are drawn on their limits and beside them.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can.e2e_states import FrameState
from pcpc.executive.loop.clock import Time
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.supervisor import Overrun
from pcpc.executive.loop.variables import FALLBACK
from pcpc.tools.dev.evidence.episodes import Episodes

EPISODES, STEPS = 60, 150
IDS, OWN, EVERY = (0x120, 0x121, 0x200), (0x0A0, 0x080), (1, 1, 5)
SILENT, FOREIGN_LIMIT, REPEAT_LIMIT = 3, (3, 10), (10, 100)  # frames within so many cycles
DRIVER = """

@loop_function
def senders(_m, n, about, told):
    for s in range(about.shape[0]):
        a, t = about[s], told[s]
        n.passes, n.wire.source, n.clock.behind = a[0], a[1], a[2]
        row, word = a[3], a[4]
        if a[5] != 0:
            n.guard.faulted = a[6]
            n.v[6] = 0.0
        for i in range(4):
            n.wire.rx[i] = word >> 8 * i & 255
        if row >= 0:
            n.rx.state[row].age_cycles = a[7]
        n.frame_taken[0] = n.frame_ends.head
        n.event_taken[0] = n.event_ends.head
        t[0] = m_is_foreign(_m, n, row, word)
        if t[0] != 0:
            m_note_foreign(_m, n, word)
        elif a[8] != 0:
            m_note_repeat(_m, n, word)
        m_judge_overrun(_m, n)
        t[1] = m_refused(_m, n)
        t[2], t[3], t[4] = n.control.foreign, n.guard.faulted, n.control.culprit
        t[5], t[6], t[7] = n.guard.overruns, n.v[6], n.frame_ends.head
        for i in range(3):
            t[8 + i] = n.rx.source[i]
        last = n.frame[(n.frame_ends.head - 1) % 65536 * 5 + 3]
        event = n.event[(n.event_ends.head - 1) % 1024]
        t[11], t[12] = last if t[7] > 0 else 0, n.event_ends.head
        t[13], t[14], t[15] = event.code, event.argument, event.bits
"""


class Senders:
    """What a node makes of frames from others, and of late cycles."""

    def __init__(self, policy: int, after: int, grace: int, stop_row: int) -> None:
        self.policy, self.after, self.grace, self.stop_row = policy, after, grace, stop_row
        self.source, self.foreign, self.fault, self.culprit = [0, 0, 0], 0, 0, 0
        self.every: Sequence[int] = EVERY
        self.overruns = self.fallback = self.frames = self.frame = self.events = 0
        self.event, self.windows = (0, 0, 0), {FOREIGN_LIMIT: [0, 0], REPEAT_LIMIT: [0, 0]}

    def step(self, given: list[int]) -> list[int]:
        """Return what is told after a step."""
        passes, source, behind, row, word, sets, fault, age, repeated = given
        if sets:
            self.fault, self.fallback = fault, 0
        foreign = self.is_foreign(passes, source, row, word, age)
        if foreign:
            self.frames, self.frame = self.frames + 1, word | 1 << 40 | FrameState.FOREIGN << 48
            self.note_foreign(passes, word)
        elif repeated:
            self.note_repeat(passes, word)
        self.judge(passes, behind)
        refused = passes == 0 and self.fault == Fault.ANOTHER_SENDER
        return [foreign, refused, self.foreign, self.fault, self.culprit, self.overruns,
                self.fallback, self.frames, *self.source, self.frame, self.events,
                *self.event]  # fmt: skip

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


def _drawn_steps(draw: np.random.Generator) -> NDArray[np.int64]:
    """Return the steps of an episode: the pass, source, periods late, row, id, fault, age."""
    about = np.zeros((STEPS, 9), np.int64)
    steps = draw.choice([0, 0, 1, 1, 1, 2, 9, 10, 11, 99, 100], STEPS, p=[0.2, 0.2, *[0.12] * 4,
                        0.04, 0.03, 0.03, 0.01, 0.01])  # fmt: skip
    about[:, 0] = np.cumsum(steps)
    about[:, 1] = draw.choice([11, 11, 11, 22, -1], STEPS)
    about[:, 2] = np.where(draw.random(STEPS) < 0.6, draw.integers(1, 3, STEPS), 0)
    about[:, 3] = draw.integers(-1, 3, STEPS)
    others = np.where(draw.random(STEPS) < 0.3, draw.choice(OWN, STEPS), 0x555)
    about[:, 4] = np.where(about[:, 3] < 0, others, np.array(IDS)[about[:, 3]])
    about[:, 5] = draw.random(STEPS) < 0.08
    about[:, 6] = np.where(draw.random(STEPS) < 0.2, draw.integers(1, 5, STEPS), 0)
    every = np.array(EVERY)[about[:, 3]]
    about[:, 7] = draw.choice([0, 1, 2], STEPS) + np.where(
        draw.random(STEPS) < 0.3, 3 * every - 1, 0
    )
    about[:, 8] = draw.random(STEPS) < 0.8
    return about


def _install(n: Any, policy: int, after: int, grace: int, stop_row: int) -> None:
    n.clock.kind = Time.GIVEN
    n.rx.n, n.tx.n = len(IDS), len(OWN)
    for row, (can_id, every) in enumerate(zip(IDS, EVERY, strict=True)):
        n.rx.frames[row].can_id, n.rx.frames[row].every_n = can_id, every
    n.tx.frames["can_id"][: len(OWN)] = OWN
    n.guard.overrun_policy, n.guard.overrun_after = policy, after
    n.guard.grace_passes, n.guard.stop_row = grace, stop_row


def senders(driver: Any, draw: np.random.Generator, count: int) -> Any:
    """Feed what judges other senders and late cycles with `count` episodes."""
    assert FALLBACK == 6
    episodes = Episodes(driver.senders)
    for number in range(count):
        has = number % 3, int(draw.integers(1, 4)), int(draw.integers(0, 9)), number % 4 - 2
        _install(episodes.new_loop(), *has)
        about, model = _drawn_steps(draw), Senders(*has)
        expected = [model.step(row) for row in about.tolist()]
        episodes.add((about,), (np.array(expected, np.int64),))
    return episodes.differ
