"""One pass: a pattern at a rate, each frame followed from its sender to the other end.

    lost         sent, and not there when nothing came for a while
    doubled      there once more
    changed      of an id that was sent, with bytes or a length that were not
    misordered   behind one of its id that was sent later
    late         there, after its receiver needed it
    refused      not taken by the queue of the sender; never lost

Delay is from the call that sends to the kernel's stamp, or where there is none until this program
had the frame. Where this program was held up as it sent, a frame has none.
"""

import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from pcpc.drivers.can import can_id
from pcpc.drivers.can.wire_layout import Flag
from pcpc.tools.machine.doctor.adapter.ends import End, HeardFrame, Origin, wait
from pcpc.tools.machine.doctor.adapter.pattern import Pattern, PatternFrame, by_phase

PATIENCE_S = 0.5  # without a frame, until what is missing is lost
AFTER_S = 0.02  # behind the last one, for those that come twice
HELD_UP_NS = 100_000  # a call that sends takes less; more: another program ran
SPIN_NS = 150_000  # before its time a frame is waited for awake
STAMPS_KEPT = 20_000
SLOWEST = 1.05  # times as long as planned a pass may last
Tell = Callable[[int], None]  # how many were sent


@dataclass(frozen=True)
class Stamped:
    """A frame's time by a clock, and between which it was, CLOCK_REALTIME."""

    sent_ns: int
    stamp_ns: int
    read_ns: int


@dataclass
class Tally:
    """What became of a pass; lists by receiving end."""

    rate_hz: float
    sent: int = 0
    arrived: int = 0
    doubled: int = 0
    changed: int = 0
    misordered: int = 0
    late: int = 0
    refused: int = 0
    strange: int = 0
    "of ids that nobody sent here"
    planned_s: float = 0.0
    held_up: int = 0
    "frames without a delay"
    dropped: int = 0
    "frames for which this program was too slow"
    seconds: float = 0.0
    delays_ns: list[int] = field(default_factory=list)
    unstamped: int = 0
    "frames whose delay is by this program's own look"
    from_end: list[int] = field(default_factory=lambda: [0, 0])
    "arrived, by sender"
    sent_by: list[int] = field(default_factory=lambda: [0, 0])
    given_back: list[int] = field(default_factory=lambda: [0, 0])
    "own frames that came back, by sender"
    strange_words: Counter[int] = field(default_factory=Counter)
    errors: tuple[Counter[int], Counter[int]] = field(
        default_factory=lambda: (Counter(), Counter())
    )
    "classes of error frames, by the end that was given them"
    kernel: list[Stamped] = field(default_factory=list)
    hardware: tuple[list[Stamped], list[Stamped]] = field(default_factory=lambda: ([], []))

    @property
    def lost(self) -> int:
        """Frames that were taken, and never came."""
        return self.sent - self.arrived

    @property
    def offered(self) -> bool:
        """Whether this program kept the rate in the mean; what was late it sent at once."""
        return self.seconds <= SLOWEST * self.planned_s and not self.dropped

    @property
    def wrong(self) -> int:
        """Frames that were not once, whole, in order."""
        return self.lost + self.doubled + self.changed + self.misordered


class Pass:
    """Sends and listens; `ends`: two, or one that hears itself, twice."""

    def __init__(self, ends: Sequence[End], pattern: Pattern, rate_hz: float) -> None:
        self.ends, self.rate_hz, self.pattern = ends, rate_hz, pattern
        self.tally = Tally(rate_hz)
        self.alone = ends[0] is ends[1]
        self._listening = ends[:1] if self.alone else ends
        self._within_ns = {one.word: one.within_ns(rate_hz) for one in pattern.frames}
        self._sender = {one.word: one.end for one in pattern.frames}
        self._open: dict[tuple[int, int, bytes], deque[tuple[int, int, bool]]] = {}
        self._before: dict[tuple[int, int, bytes], int] = {}
        self._latest: dict[int, int] = {}
        self._waiting = 0
        self._last_s = time.monotonic()

    def run(self, cycles: int, tell: Tell = lambda sent: None) -> Tally:
        """Send the pattern so many cycles long; BusError."""
        moments = by_phase(self.pattern.frames)
        period_ns = 1e9 / self.rate_hz
        dropped = sum(end.dropped for end in self._listening)
        begin_ns = time.monotonic_ns() + 1_000_000
        for cycle in range(cycles):
            for phase, frames in moments:
                self._listen_until(begin_ns + round((cycle + phase) * period_ns))
                for frame in frames:
                    if cycle % frame.every_n == 0:
                        self._send(frame)
            tell(self.tally.sent)
        self.tally.seconds = 1e-9 * (time.monotonic_ns() - begin_ns)
        self.tally.planned_s = cycles / self.rate_hz
        self._listen_to_the_end()
        self.tally.dropped = sum(end.dropped for end in self._listening) - dropped
        return self.tally

    def _send(self, frame: PatternFrame) -> None:
        tally, number = self.tally, self.tally.sent + self.tally.refused
        data = frame.data(number)
        key = frame.word, frame.flags, data
        sent_ns = time.time_ns()
        taken = self.ends[frame.end].offer(frame.word, data, frame.flags)
        held_up = time.time_ns() - sent_ns > HELD_UP_NS
        if not taken:
            tally.refused += 1
            return
        tally.sent += 1
        tally.sent_by[frame.end] += 1
        self._waiting += 1
        self._last_s = time.monotonic()
        self._open.setdefault(key, deque()).append((number, sent_ns, held_up))

    def _listen_until(self, due_ns: int) -> None:
        while True:
            self._take()
            left_ns = due_ns - time.monotonic_ns()
            if left_ns <= 0:
                return
            if left_ns > SPIN_NS:
                wait(self._listening, 1e-9 * (left_ns - SPIN_NS))

    def _listen_to_the_end(self) -> None:
        while self._waiting and time.monotonic() < self._last_s + PATIENCE_S:
            wait(self._listening, 0.01)
            self._take()
        end_s = time.monotonic() + AFTER_S
        while time.monotonic() < end_s:
            wait(self._listening, 0.005)
            self._take()

    def _take(self) -> None:
        for number, end in enumerate(self._listening):
            for heard in end.frames():
                self._judge(number, heard)

    def _judge(self, end: int, heard: HeardFrame) -> None:
        tally, sender = self.tally, self._sender.get(heard.word)
        if heard.origin is Origin.ERROR:
            tally.errors[end].update(1 << bit for bit in range(29) if heard.word >> bit & 1)
        elif heard.origin is Origin.OWN and not self.alone:
            tally.given_back[end] += sender == end
        elif sender is None or (sender == end and not self.alone):
            tally.strange += 1
            tally.strange_words[heard.word] += 1
        else:
            self._match(sender, heard)

    def _match(self, sender: int, heard: HeardFrame) -> None:
        tally, key = self.tally, (heard.word, heard.flags & ~Flag.ESI, heard.data)
        sent = self._open.get(key)
        if not sent:
            if key in self._before:
                tally.doubled += 1
            else:
                tally.changed += 1
            return
        number, sent_ns, held_up = sent.popleft()
        if not sent:
            del self._open[key]
        self._before[key] = number
        self._waiting -= 1
        self._last_s = time.monotonic()
        tally.arrived += 1
        tally.from_end[sender] += 1
        tally.given_back[sender] += heard.origin is Origin.OWN
        tally.misordered += number < self._latest.get(heard.word, -1)
        self._latest[heard.word] = max(number, self._latest.get(heard.word, -1))
        self._time(sender, heard, sent_ns, held_up)

    def _time(self, sender: int, heard: HeardFrame, sent_ns: int, held_up: bool) -> None:
        tally, stamp_ns = self.tally, heard.stamp_ns
        kept = len(tally.kernel) < STAMPS_KEPT
        if stamp_ns is not None and kept:
            tally.kernel.append(Stamped(sent_ns, stamp_ns, heard.read_ns))
        if heard.hardware_ns is not None and len(tally.hardware[sender]) < STAMPS_KEPT:
            times = Stamped(sent_ns, heard.hardware_ns, heard.read_ns)
            tally.hardware[sender].append(times)
        if stamp_ns is None or not sent_ns <= stamp_ns <= heard.read_ns:
            stamp_ns = heard.read_ns
            tally.unstamped += 1
        if held_up:
            tally.held_up += 1
            return
        tally.delays_ns.append(stamp_ns - sent_ns)
        tally.late += stamp_ns - sent_ns > self._within_ns[heard.word]


def others_on(ends: Sequence[End], seconds: float) -> Counter[int]:
    """Return the ids of frames that come while nothing is sent; error frames are none."""
    found: Counter[int] = Counter()
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        wait(ends, 0.02)
        for end in ends:
            found.update(one.word for one in end.frames() if one.origin is Origin.OTHER)
    return found


def named_words(words: Counter[int]) -> str:
    """Return the ids of frames, the most frequent first; -1: of what is no frame."""
    ids = ["no frame" if word < 0 else can_id.text_of(word) for word, _ in words.most_common(4)]
    return ", ".join(ids) + (" ..." if len(words) > 4 else "")
