"""What reception has to do with frames from the wire, written a second time, in plain Python.

From docs/bus-safety.md and the heads of `executive.loop` (reception, on_wire, losses, intrusion,
injected_frames, meeting). `compared_reception` feeds it and the mutants with the same frames.
"""

import struct
from dataclasses import dataclass
from typing import Annotated, NamedTuple

from pcpc.drivers.can import e2e_states
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.supervisor import Overrun
from pcpc.tools.dev.evidence import compared_plausible, expected
from pcpc.tools.dev.evidence.compared_senders import Senders

FB, BEAT, SYNC, SLOW, STOP, WIDE = range(6)
ROWS = (
    expected.Protection(0x123, 8, 1, byte=6, shift=4, mask=15),
    expected.Protection(0x702, 1, 4),
    expected.Protection(0x090, 2, 1, byte=0, shift=0, mask=255),
    expected.Protection(0x345, 8, 15, byte=5, shift=2, mask=15),
    expected.Protection(0x00F, 1, 1),
    expected.Protection(0x456, 8, 2, byte=3, mask=255, wide=True, data_id=0xA5C3),
)
STARTS, AWAITED = (1, 0, 1, 0, 0, 1), (1, 0, 0, 0, 0, 1)
CARE, SPOILED = (FB, BEAT, SLOW), (SLOW, WIDE)
SIGNALS = (
    (FB, 0, 20),
    (FB, 1, 21),
    (BEAT, 0, 22),
    (SLOW, 0, 23),
    (WIDE, 5, 24),
)  # row, byte, place
SCALE = 0.125
LOSS = {SLOW: (0.1, 0.5), WIDE: (0.2, 0.6)}
MEETS = (4, 2, 1, 0, 0, 3)  # AFTER, FROM_BELOW, FROM_ABOVE, no part, no part, BEFORE
IS_BELOW = tuple(int(part > 1) for part in MEETS)  # of a node below, the only ones that meet it
GONE, CHANGED, ANOTHER = 1, 2, 4
COUNT, HOLD = 0, 1
STALLED = 51  # a place that is above 0; the one before is not
GREETING = sh.GREETING | 1 << 31
COUNTED = (
    "missed", "lost", "crc_errors", "repeated", "wrong_sequence", "received", "foreign",
    "lost_on_purpose", "intrusions", "signs_on_purpose", "culprit", "implausible",
    "bus_errors",
)  # fmt: skip


@dataclass
class Settings:
    """Of an episode."""

    reaction: int
    greets: int
    ordered: int
    peer: int  # which node below sends, 1 or 2
    faults: int
    turn: int  # of the heartbeat
    signals: list[compared_plausible.LimitedSignal]


class Step(NamedTuple):
    """A frame, behind so many cycles, and what else has happened."""

    cycles: int
    k: int
    behind: int
    row: int
    source: int
    done: int  # by a fault on purpose
    acts: int
    sets: int
    fault: int
    second: int
    stall: int  # the place of a stall of the node above
    replays: int  # what is noted of it counts, `stood`, not what is so now
    stood: int
    bias: float  # of the first value, by a fault on purpose
    error: int
    frame: Annotated[list[int], "u1", 16]
    other: Annotated[list[int], "u1", 16]


class ExpectedNode(Senders):
    """What a node makes of the frames that come."""

    def __init__(self, has: Settings) -> None:
        super().__init__(Overrun.SKIP, 1, 0, STOP)
        self.has, self.reaction = has, has.reaction
        self.receivers = [expected.ExpectedReceiver(one) for one in ROWS]
        self.came = [expected.ExpectedReceiver(one) for one in ROWS]  # spoiled ones, off the wire
        self.judge_of = compared_plausible.LimitedReceiver(has.signals)
        self.source, self.every = [0] * len(ROWS), [one.every for one in ROWS]
        self.counted_frame = [bytes(16) for _ in ROWS]
        self.hints = [[0, 0] for _ in ROWS]  # since, how many
        self.told_until, self.doubted, self.kept = [0] * 6, [0] * 6, [0] * 6
        self.added, self.acted = [0] * 6, [0] * 6
        self.loss = {row: [7 + row, 0] for row in LOSS}
        self.off, self.bus = 0, [0] * 6
        self.beat_at = self.early_at = self.sampled = 0
        self.met: set[int] = set()
        self.held = b""
        self.v, self.before = [0.0] * len(SIGNALS), [0.0] * len(SIGNALS)
        self.peers = [int(node == has.peer) for node in (1, 2)]
        self.n = dict.fromkeys(COUNTED, 0)
        self.passes = self.k = self.behind = self.second = self.done = self.shown = 0
        self.started = self.fresh = self.muted = self.quick = 0
        self.log: list[tuple[int, int]] = []

    def step(self, given: Step) -> None:  # type: ignore[override]
        """Let cycles begin, then take a frame or what the controller told."""
        self.k, self.behind, self.row = given.k, given.behind, max(given.row, 0)
        self.done, self.second = given.done, given.second
        self.v[0] += given.bias
        frame, self.other = bytes(given.frame), bytes(given.other)
        for _ in range(given.cycles):
            self.passes += 1
            for one in (*self.receivers, *(self.came[row] for row in SPOILED)):
                one.begin()
            self.started = self.fresh = self.muted = 0
        if given.row >= 0 and given.acts:
            self.acted[given.row] = self.passes + 1
        if given.sets:
            self.fault = given.fault
        self.taken = (
            self.bus_error(frame) if given.error else self.take(given.row, given.source, frame)
        )
        short = sum(AWAITED[i] for i in SPOILED if self.came[i].fresh and self.unused(i))
        stood = given.stood != 0 if given.replays else given.stall == STALLED
        self.on_purpose = stood or 2 - self.fresh - short <= 0

    def last_frame(self, back: int) -> tuple[int, int]:
        """Return the last recorded frame but so many."""
        return self.log[-1 - back] if back < len(self.log) else (0, 0)

    def count_of(self, word: str) -> int:
        """Return a counter of the node."""
        others = {"foreign": self.foreign, "culprit": self.culprit,
                  "implausible": self.judge_of.count}  # fmt: skip
        return others.get(word, self.n[word])

    def bus_error(self, frame: bytes) -> int:
        """Count what the controller told; bus-off is a fault until it is restarted."""
        kind, detail = int.from_bytes(frame[:2], "little"), frame[9]
        self.push(frame, FrameState.BUS_ERROR)
        state, restarted = kind & 0x4, kind & 0x100
        self.n["bus_errors"] += not (restarted or (state and detail & 0x40))
        happened = (state and detail & 0x0C, state and detail & 0x30, kind & 0x40, restarted,
                    kind & 0x20, kind & 0x1)  # fmt: skip
        self.bus = [count + bool(one) for count, one in zip(self.bus, happened, strict=True)]
        self.off = 1 if kind & 0x40 else 0 if restarted else self.off
        self.fault = self.fault or Fault.BUS_OFF * self.off
        return 0

    def unused(self, row: int) -> bool:
        """Return whether a row gave no input in this cycle."""
        return not self.receivers[row].fresh or self.doubted[row] == self.passes + 1

    def push(self, frame: bytes, state: int) -> None:
        """Record a frame."""
        head, length, data = struct.unpack("<IB3xq", frame)
        self.log.append((head | length << 32 | 1 << 40 | state << 48, data))

    def word(self, frame: bytes) -> int:
        """Return id and flags."""
        return int.from_bytes(frame[:4], "little")

    def take(self, row: int, source: int, frame: bytes) -> int:
        """Return the row of a frame that is ours."""
        word, age = self.word(frame), self.receivers[max(row, 0)].age
        if self.is_foreign(self.passes, source, row, word, age):
            self.push(frame, FrameState.FOREIGN)
            self.note_foreign(self.passes, word)
            return -1
        if row < 0:
            greets = word | 31 == GREETING | 31 and word != GREETING
            differs = greets and frame[4:] != b"\1" + bytes(11)
            if differs and self.has.greets and self.passes == 0:
                self.blame(Fault.ANOTHER_SENDER, word)
            return -1
        if self.has.ordered and self.passes == 0:
            if not self.sort(row, frame):
                return -1
            if MEETS[row] == 4 and self.held:
                held, self.held = self.held, b""
                self.use(BEAT, held)
        return self.use(row, frame)

    def sort(self, row: int, frame: bytes) -> bool:
        """Return whether a frame before the first cycle is taken now; hold what may be later."""
        if MEETS[row] in (1, 2):
            if row not in self.met or (MEETS[row] == 2 and self.sampled):
                self.met.add(row)
                return True
            self.held = frame if MEETS[row] == 2 else self.held
            return False
        self.held = b"" if MEETS[row] == 3 else self.held
        self.sampled = 1 if MEETS[row] in (3, 4) else self.sampled
        return True

    def use(self, row: int, frame: bytes) -> int:
        """Lose, change or accept a frame."""
        after_loss = self.loss.get(row, (0, 0))[1]
        self.shown, new = 0, not self.receivers[row].fresh
        if row in SPOILED:
            state, lost = self.came[row].check(frame[8:], frame[4])
            self.count(state, lost)
            lasts = max(20, 2 * ROWS[row].every)
            since = self.passes + 1 - self.acted[row]
            self.shown = int(state < 2 and self.acted[row] > 0 and since <= lasts)
        if self.is_lost(row):
            self.n["lost_on_purpose"] += 1
            self.came[row].fresh = self.receivers[row].fresh
            self.started += STARTS[row]
            self.push(frame, FrameState.LOST_ON_PURPOSE)
            return -1
        if self.done and self.has.faults:
            self.put_in_place(row, frame, new)
            return row
        state, lost = self.receivers[row].check(frame[8:], frame[4])
        self.push(frame, state)
        self.n["lost"] += lost
        if row not in SPOILED:
            self.count(state, lost)
        if state < 2:
            self.decode(row, frame, new)
        else:
            self.suspect(row, frame, state, lost)
            self.refuse(row, frame, state, after_loss)
        return row

    def count(self, state: int, lost: int) -> None:
        """Count what the wire did."""
        self.n["missed"] += lost
        for its, word in ((4, "crc_errors"), (2, "repeated"), (3, "wrong_sequence")):
            self.n[word] += state == its

    def is_lost(self, row: int) -> bool:
        """Draw whether a frame is lost."""
        if row not in LOSS:
            return False
        its = self.loss[row]
        its[0] = its[0] * 48271 % (2**31 - 1)
        its[1] ^= its[0] / (2**31 - 1) < LOSS[row][its[1]]
        return bool(its[1])

    def put_in_place(self, row: int, frame: bytes, new: bool) -> None:
        """Accept what faults on purpose made of a frame."""
        self.shown, used = 1, False
        if not self.done & GONE:
            used = self.injected(row, frame)
            if used:
                self.decode(row, frame, new)
                self.n["lost_on_purpose"] -= 1
        if self.done & ANOTHER and self.injected(row, self.other):
            self.decode(row, self.other, new and not used)
            used = True
        self.started += 0 if used else STARTS[row]

    def injected(self, row: int, frame: bytes) -> bool:
        """Return whether an injected frame is accepted."""
        state, lost = self.receivers[row].check(frame[8:], frame[4])
        self.push(frame, e2e_states.INJECTED + state)
        self.n["lost"] += lost
        if state >= 2:
            self.suspect(row, frame, state, lost)
        if state == 2 and STARTS[row] + AWAITED[row]:
            self.note_repeat(self.passes, self.word(frame))
        return state < 2

    def decode(self, row: int, frame: bytes, new: bool) -> None:
        """Take a frame's values; `new`: the first of its row in this cycle."""
        values = {place - 20: SCALE * frame[8 + byte] for its, byte, place in SIGNALS if its == row}
        gives = AWAITED[row] if new else 0
        if row == BEAT:
            self.beat(frame)
        if row in CARE and self.doubted[row] == self.passes + 1:
            gives = 0
        else:
            if row in CARE and new and self.reaction != COUNT:
                self.kept[row] = self.passes + 1
                for at in values:
                    self.before[at] = self.v[at]
            for at, value in values.items():
                self.v[at] = value
            if row in CARE:
                gives *= self.plausible(row)
                self.added[row] = gives if new else self.added[row]
        self.counted_frame[row] = frame
        self.n["received"] += 1
        if row == STOP:
            self.fault, self.quick = self.fault or Fault.STOP_FRAME, 1
        if new:
            self.started += STARTS[row]
            self.fresh += gives
            if self.second and STARTS[row] > AWAITED[row]:
                self.muted = 1

    def plausible(self, row: int) -> bool:
        """Judge the values of a row; what is not taken stays as it was."""
        judge = self.judge_of
        judge.events, judge.event = self.events, self.event
        judge.step(compared_plausible.Step(self.k, row, 1, self.fault, self.v[:3]))
        self.culprit = judge.why if judge.fault != self.fault else self.culprit
        self.fault, self.events, self.event = judge.fault, judge.events, judge.event
        for i, its in enumerate(compared_plausible.ROWS):
            if its == row:
                self.v[i] = judge.signals[i].taken
        return judge.known

    def refuse(self, row: int, frame: bytes, state: int, after_loss: int) -> None:
        """Do what follows from a frame that is not used."""
        since, awaited = self.passes + 1 - self.acted[row], STARTS[row] + AWAITED[row] > 0
        if self.acted[row] > 0 and since <= 20:
            self.started += STARTS[row]
            if state == 2 and awaited:
                self.note_repeat(self.passes, self.word(frame))
        elif state == 2:
            self.started += STARTS[row] * after_loss
            if not after_loss and awaited:
                self.note_repeat(self.passes, self.word(frame))
        elif state == 3:
            self.muted = 1 if STARTS[row] > AWAITED[row] else self.muted
            self.started += STARTS[row]

    def suspect(self, row: int, frame: bytes, state: int, lost: int) -> None:
        """Look for a second sender in a frame that is not used."""
        its, before, has = self.receivers[row], self.counted_frame[row], ROWS[row]
        if state == 4:
            if its.fresh:
                self.sign(row, frame, Event.TWO_SENDERS, 1)
        elif state == 2:
            if its.still <= has.every and frame[8 : 8 + has.dlc] != before[8 : 8 + has.dlc]:
                self.sign(row, frame, Event.TWO_SENDERS, 3)
        else:
            self.counted_frame[row] = frame
            ahead = (its.last - (before[8 + has.byte] >> has.shift)) & has.mask
            if ahead > has.mask // 2:
                if lost == 0:
                    self.sign(row, frame, Event.TWO_SENDERS, 1)
            elif ahead >= lost + 1 + self.behind // has.every + 4:
                self.sign(row, frame, Event.AHEAD, 3)

    def beat(self, frame: bytes) -> None:
        """Look at the time between two heartbeats."""
        before, self.beat_at = self.beat_at, self.k
        if before > 0 and self.behind == 0 and self.k - before < 0.75 * self.has.turn:
            if self.k - self.early_at <= 10 * self.has.turn:
                self.sign(BEAT, frame, Event.TWO_PLACES, 1)
            self.early_at = self.k

    def sign(self, row: int, frame: bytes, event: int, weight: int) -> None:
        """Count a sign; do what the rig chose where it is believed."""
        self.n["intrusions"] += 1
        self.n["signs_on_purpose"] += self.shown
        hints = self.hints[row]
        if self.passes - hints[0] >= 10 * ROWS[row].every:
            hints[:] = self.passes, 0
        hints[1] += weight
        if self.k >= self.told_until[row]:
            self.told_until[row] = self.k + 100
            self.tell(event, self.word(frame) & 0x1FFFFFFF, self.n["intrusions"])
        if hints[1] < 3 or self.reaction == COUNT:
            return
        self.doubted[row] = self.passes + 1
        if self.kept[row] == self.passes + 1:
            self.kept[row] = 0
            self.fresh -= self.added[row]
            for i, (its, _, _) in enumerate(SIGNALS):
                if its == row:
                    self.v[i] = self.before[i]
                    if i < len(compared_plausible.ROWS):
                        self.judge_of.signals[i].taken = self.v[i]
        if self.reaction != HOLD:
            self.blame(Fault.INTRUSION, self.word(frame))
