"""The two kinds of frames on a line, for its tests: classic ones, and CAN FD at 1 and 5 Mbit/s."""

import itertools
import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from second_encoder import FD_LENGTHS, Bytes, fd_frame, frame, stream

from pcpc.drivers.compiled.rows import CLASSIC_BYTES, FRAME_BYTES, Flag
from pcpc.drivers.line import line as lines
from pcpc.drivers.line.line import Outcome

A, B, C = range(3)
BIT, FAST = 5, 1  # ticks of CAN FD
RATES = {"bitrate": 1_000_000, "data_bitrate": 5_000_000}
Arrival = tuple[int, int, Bytes]  # tick, sender, frame


def sent_by(one: Bytes, passive: bool) -> Bytes:
    """Return a frame as it is on the line: one of CAN FD says that its sender is error passive."""
    made = one.copy()
    made[5] |= Flag.ESI if passive and one[5] else 0
    return made


def new(senders: int = 2, room: int = 64, **options: Any) -> Any:
    line: Any = np.zeros(1, lines.Line.dtype).view(np.recarray)[0]
    lines.prepare(line, senders, room, **options)
    return line


def events(line: Any, until: int) -> list[tuple[int, int, int]]:
    """Return what happens up to tick `until`: what, when, to whom."""
    found = []
    while (what := lines.advance(line, until)) != Outcome.NOTHING:
        found.append((int(what), int(line.at), int(line.who)))
    return found


def sent(line: Any, arrivals: Iterable[Arrival], until: int) -> list[tuple[bytes, int]]:
    """Return the frames that come through, in order, each with the ticks that it took."""
    found = []
    for at, group in itertools.groupby(
        [*sorted(arrivals, key=lambda a: a[:2]), (until, -1, frame(0))], key=lambda a: a[0]
    ):
        while (what := lines.advance(line, at)) != Outcome.NOTHING:
            if what == Outcome.SENT:
                n = FRAME_BYTES if line.frame[5] & Flag.FD else CLASSIC_BYTES
                found.append((line.frame[:n].tobytes(), int(line.waited)))
        for _, s, one in group:
            if s >= 0:
                assert lines.put(line, s, one, at)
    return found


@dataclass(frozen=True)
class Kind:
    """A kind of frames and its line; on that of CAN FD classic ones are frames too."""

    frame: Callable[..., Bytes]  # of id and data
    bit: int  # ticks
    slot: int  # ticks, longer than any frame with an error
    longest: bytes
    rates: dict[str, int] = field(default_factory=dict)

    def new(self, senders: int = 2, room: int = 64, **options: Any) -> Any:
        return new(senders, room, **self.rates, **options)

    def lasting(self, one: Bytes) -> list[int]:
        """Return the ticks of each bit of a frame, of the second encoder."""
        return stream(one).ticks(self.bit, FAST)

    def ticks(self, one: Bytes) -> int:
        """Return how long a frame and its intermission take."""
        return sum(self.lasting(one)) + 3 * self.bit

    def mixed(self, draw: random.Random, can_id: int | None = None) -> Bytes:
        """Return a frame that is drawn, of any kind that the line has."""
        extended = can_id is None and draw.random() < 0.3
        number = draw.getrandbits(29 if extended else 11) if can_id is None else can_id
        if not self.rates or draw.random() < 0.4:
            return frame(number, draw.randbytes(draw.randrange(9)), extended)
        data = bytes(draw.choices([0, 255, 0x5A, draw.getrandbits(8)], k=draw.choice(FD_LENGTHS)))
        return fd_frame(number, data, extended, draw.choice([0, Flag.BRS, Flag.BRS]))

    def failing(self, line: Any, s: int, times: int) -> list[tuple[int, int, int]]:
        """Let a frame of `s` fail so often; return the events."""
        lines.put(line, s, self.frame(s, b""), int(line.free_at))
        line.p, found = 1.0, list[tuple[int, int, int]]()
        while len(found) < times:
            found += events(line, lines.next_due(line))
        line.p = 0.0
        return found


CLASSIC = Kind(frame, 1, 200, bytes(range(8)))
FD = Kind(fd_frame, BIT, 4000, bytes(range(64)), RATES)
both = pytest.mark.parametrize("kind", [CLASSIC, FD], ids=["classic", "fd"])
