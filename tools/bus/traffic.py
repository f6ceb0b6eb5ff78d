"""The frames of a rig as traffic: who sends what, how often, and by when it is needed.

    late   a frame may still wait when the next of its kind comes: the bus does not carry the rig
    held   a frame of every cycle may come after its receiver's next cycle, which then runs on the
           frame before: one sample of delay more

A frame is needed within its period; one of every cycle before the receiver's next cycle. In pacing
real that is given by the phases of the nodes (`realtime.*.phase`), in pacing sync command and
feedback get half a period each, in lockstep nobody waits for a clock. Times count from the sender's
cycle.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from pcpc.drivers import dbc
from pcpc.drivers.frame_bits import transmission_ns
from pcpc.executive.rig import messages
from pcpc.executive.rig.reading import Rig
from pcpc.tools.bus.response import Message, responses_ns

MOST_HZ, MOST_CLASSIC = 20_000, 1_000_000  # of a rig's rate; bit/s of classic CAN


@dataclass(frozen=True)
class Sent:
    """A frame with its sender, and the share of a period after which its receiver wants it."""

    frame: dbc.Frame
    sender: str
    wanted: float = 1.0

    @property
    def priority(self) -> tuple[int, bool, int]:
        """What arbitration compares: 11 bits, then the shorter id wins, then the other 18 bits."""
        number, long = self.frame.can_id, self.frame.extended
        return (number >> 18, True, number & 0x3FFFF) if long else (number, False, 0)


@dataclass(frozen=True)
class Setup:
    """What the frames meet: rates, and what makes them late. `data_bitrate`: all are FD frames."""

    rate_hz: float
    bitrate: int
    data_bitrate: int | None = None
    jitter_ns: int = 0
    error_every_ns: int = 0


@dataclass(frozen=True)
class Row:
    """A frame's times in ns; `response_ns` None: not bounded."""

    sent: Sent
    transmission_ns: int
    period_ns: int
    deadline_ns: int
    response_ns: int | None

    @property
    def margin_ns(self) -> int | None:
        """What is left of the time in which it is needed."""
        return None if self.response_ns is None else self.deadline_ns - self.response_ns

    @property
    def late(self) -> bool:
        """Whether it may wait when the next of its kind comes."""
        return self.response_ns is None or self.response_ns > self.period_ns

    @property
    def held(self) -> bool:
        """Whether it may only miss its receiver's next cycle."""
        return not self.late and self.margin_ns is not None and self.margin_ns < 0


def buses(rig: Rig) -> list[list[Sent]]:
    """Return the frames on each of a rig's buses by priority, the executive's bus first."""
    database = messages.database_of(rig)
    role_of = {node.node: role for role, node in rig.config.sections.items()}
    phase = {node: rig.config.realtime.of(role).phase for node, role in role_of.items()}

    def sent(message: dbc.Message) -> Sent:
        frame, sender = dbc.frame(message), next(iter(message.senders), "")
        heard = [phase[n] for n in message.receivers if n in phase and not frame.cycle_ms]
        if sender not in phase or not heard or rig.config.pacing == "lockstep":
            return Sent(frame, sender)
        if rig.config.pacing == "sync":
            return Sent(frame, sender, 0.5)
        return Sent(frame, sender, min((p - phase[sender]) % 1.0 or 1.0 for p in heard))

    with messages.errors_named(rig):
        return [
            sorted(
                (sent(message) for message in database.messages if message.name in names),
                key=lambda entry: entry.priority,
            )
            for names in messages.on_buses(rig, database)
        ]


def analysed(frames: Sequence[Sent], setup: Setup) -> list[Row]:
    """Return the times of the frames of a bus, by priority."""
    rows = []
    for sent in frames:
        frame, cycle_ns = sent.frame, 1e9 / setup.rate_hz
        period_ns = math.floor(frame.every_n(setup.rate_hz) * cycle_ns)
        takes_ns = transmission_ns(frame.dlc, frame.extended, setup.bitrate, setup.data_bitrate)
        wanted_ns = period_ns if sent.wanted == 1.0 else math.floor(sent.wanted * cycle_ns)
        rows.append(Row(sent, takes_ns, period_ns, wanted_ns, None))
    queued = [Message(row.transmission_ns, row.period_ns, setup.jitter_ns) for row in rows]
    found = responses_ns(queued, math.ceil(1e9 / setup.bitrate), setup.error_every_ns)
    return [replace(row, response_ns=ns) for row, ns in zip(rows, found, strict=True)]


def load(rows: Sequence[Row]) -> float:
    """Return the share of the time for which the frames occupy the bus, in the worst case."""
    return math.fsum(row.transmission_ns / row.period_ns for row in rows)


def fits(rows: Sequence[Row]) -> bool:
    """Return whether every frame is gone before the next of its kind."""
    return not any(row.late for row in rows)


def in_time(rows: Sequence[Row]) -> bool:
    """Return whether no cycle has to run on the frame before."""
    return not any(row.late or row.held for row in rows)


Good = Callable[[Sequence[Row]], bool]


def highest_hz(frames: Sequence[Sent], setup: Setup, good: Good) -> int:
    """Return the highest rate of whole Hz that is `good`; 0 for none, MOST_HZ for any."""
    return _boundary(MOST_HZ, lambda hz: good(analysed(frames, replace(setup, rate_hz=float(hz)))))


def lowest_bitrate(frames: Sequence[Sent], setup: Setup, good: Good) -> int | None:
    """Return the lowest bit rate of whole kbit/s that is `good`; None if no CAN is."""
    most = min(setup.data_bitrate or MOST_CLASSIC, MOST_CLASSIC) // 1000

    def bad(kbit_s: int) -> bool:
        return not good(analysed(frames, replace(setup, bitrate=1000 * kbit_s)))

    found = _boundary(most, bad)
    return None if found == most else 1000 * (found + 1)


def _boundary(most: int, yes: Callable[[int], bool]) -> int:
    """Return the last of 1 to `most` that is `yes`, if those before are; 0 if none is."""
    low, high = 0, most + 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if yes(middle) else (low, middle)
    return low


def warning(rig: Rig, pacing: str) -> str:
    """Return in a line which frame a bus of the rig's own bit rate cannot take in time, or ""."""
    config = rig.config
    if config.bus.bitrate is None or pacing == "lockstep":
        return ""
    setup = Setup(config.rate_hz, config.bus.bitrate)
    for frames in buses(rig):
        rows = analysed(frames, setup)
        for row in rows:
            if row.late:
                us = "without bound" if row.response_ns is None else f"{row.response_ns / 1e3:g} us"
                return (
                    f"{rig.where('rate_hz')}: {row.sent.frame.name} may take {us} on a bus of "
                    f"{setup.bitrate} bit/s, its period is {row.period_ns / 1e3:g} us, the load "
                    f"{load(rows):.0%}; all frames fit up to {highest_hz(frames, setup, fits)} Hz, "
                    "see `pcpc bus`"
                )
    return ""
