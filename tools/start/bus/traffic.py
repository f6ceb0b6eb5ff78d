"""The frames of a rig as traffic: who sends what, how often, and by when it is needed.

    late   a frame may still wait when its next one comes: the bus does not carry the rig
    held   a frame of every cycle may come after its receiver's next cycle, which then runs on the
           frame before: one sample of delay more

In pacing real the nodes of one machine keep the phases of the rig (`realtime.*.phase`) to each
other. Then a frame of every cycle is needed before its receiver's next cycle, and what another
node sends half a period later does not delay it. In pacing sync the phases may be any, and command
and feedback get half a period each; in lockstep nobody waits for a clock. All other frames are
needed within their period, also between machines, whose phases drift. Times count from the
sender's cycle.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from pcpc.drivers.can import dbc
from pcpc.drivers.can.frame_bits import duration_ns
from pcpc.executive.rig import messages
from pcpc.executive.rig.bus_keys import Xcp
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.xcp import xcp_frames
from pcpc.tools.start.bus.drive_frames import own_frames
from pcpc.tools.start.bus.phase_bounds import QueuedFrame, Wire, bounds_ns
from pcpc.tools.start.bus.response import responses_ns

MOST_HZ, MOST_CLASSIC = 20_000, 1_000_000  # of a rig's rate; bit/s of classic CAN


@dataclass(frozen=True)
class SentFrame:
    """A frame with its sender, and the share of a cycle after which its receiver wants it.

    `phase`: of the sender, as a share of a cycle; None for any. `cycles`: not 0 for one that is
    sent at any time, at most `count` of them in so many.
    """

    frame: dbc.Frame
    sender: str
    wanted: float = 1.0
    phase: float | None = None
    cycles: int = 0
    count: int = 1

    @property
    def priority(self) -> tuple[int, bool, int]:
        """What arbitration compares: 11 bits, then the shorter id wins, then the other 18 bits."""
        number, long = self.frame.can_id, self.frame.extended
        return (number >> 18, True, number & 0x3FFFF) if long else (number, False, 0)


@dataclass(frozen=True)
class Setup:
    """What the frames meet: rates, and what makes them late. `all_fd`: as if all were FD frames.

    `in_order`: a node sends its frames in the order of its loop, not by priority.
    """

    rate_hz: float
    bitrate: int
    data_bitrate: int | None = None
    jitter_ns: int = 0
    error_every_ns: int = 0
    in_order: bool = False
    all_fd: bool = False


@dataclass(frozen=True)
class FrameBounds:
    """A frame's times in ns; `response_ns` None: not bounded."""

    sent: SentFrame
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
        """Whether, sent every cycle, it may miss its receiver's next one."""
        return not self.sent.frame.cycle_ms and (self.margin_ns is None or self.margin_ns < 0)


def buses(rig: Rig, any_phase: bool = False) -> list[list[SentFrame]]:
    """Return the frames on each of a rig's buses by priority, the executive's bus first."""
    database = messages.database_of(rig)
    role_of = {node.node: role for role, node in rig.config.sections.items()}
    phases = {node: rig.config.realtime.of_node(role).phase for node, role in role_of.items()}
    kept = rig.config.pacing == "real" and not any_phase

    def sent_frame(message: dbc.Message) -> SentFrame:
        frame, sender = dbc.frame(message), next(iter(message.senders), "")
        phase = phases.get(sender) if kept else None
        heard = [phases[name] for name in message.receivers if name in phases]
        if frame.cycle_ms or sender not in phases or not heard:
            return SentFrame(frame, sender, 1.0, phase)
        if phase is not None:
            return SentFrame(frame, sender, min((p - phase) % 1.0 or 1.0 for p in heard), phase)
        return SentFrame(frame, sender, 0.5 if rig.config.pacing == "sync" else 1.0)

    with messages.errors_named(rig):
        found = [
            [sent_frame(message) for message in database.messages if message.name in names]
            for names in messages.frames_by_bus(rig, database)
        ]
        for role, frame in own_frames(rig, database):
            node = rig.config.plants[role]
            phase = phases[node.node] if kept else None
            found[node.bus is not None].append(SentFrame(frame, node.node, 1.0, phase))
    for sender, frame, count in xcp_frames(rig):
        found[0].append(SentFrame(frame, sender, cycles=Xcp.CYCLES, count=count))
    return [sorted(frames, key=lambda entry: entry.priority) for frames in found]


def queue_of(frames: Sequence[SentFrame], setup: Setup) -> tuple[list[QueuedFrame], Wire]:
    """Return the frames of a bus, by priority, and the bus, as the analysis takes them."""
    cycle_ns = 1e9 / setup.rate_hz
    in_cycle = sorted(
        frames, key=lambda entry: (not entry.cycles, *messages.sending_order(entry.frame))
    )
    found = []
    for sent in frames:
        frame = sent.frame
        fast = setup.data_bitrate or setup.bitrate
        takes_ns = duration_ns(frame.bits(setup.all_fd), setup.bitrate, fast)
        period_ns = math.floor((sent.cycles or frame.every_n(setup.rate_hz)) * cycle_ns)
        phase_ns = None if sent.phase is None else math.floor(sent.phase * cycle_ns)
        place = in_cycle.index(sent)
        who = sent.sender, phase_ns, place
        found.append(QueuedFrame(takes_ns, period_ns, setup.jitter_ns, *who, count=sent.count))
    bit_ns = math.ceil(1e9 / setup.bitrate)
    return found, Wire(bit_ns, math.floor(cycle_ns), setup.error_every_ns, setup.in_order)


def response_rows(frames: Sequence[SentFrame], setup: Setup) -> list[FrameBounds]:
    """Return the times of the frames of a bus, by priority."""
    queue, wire = queue_of(frames, setup)
    rows = []
    for sent, k, response_ns in zip(frames, queue, _responses_ns(queue, wire), strict=True):
        share = math.floor(sent.wanted * 1e9 / setup.rate_hz)
        deadline_ns = k.period_ns if sent.wanted == 1.0 else share
        rows.append(FrameBounds(sent, k.transmission_ns, k.period_ns, deadline_ns, response_ns))
    return rows


def _responses_ns(queue: Sequence[QueuedFrame], wire: Wire) -> list[int | None]:
    """Return the lower of the bounds that hold."""
    bounds = bounds_ns(queue, wire)
    if wire.in_order:
        return bounds
    exact = responses_ns(queue, wire.bit_ns, wire.error_every_ns)
    both = zip(bounds, exact, strict=True)
    return [min((ns for ns in pair if ns is not None), default=None) for pair in both]


def load(rows: Sequence[FrameBounds]) -> float:
    """Return the share of the time for which the frames occupy the bus, in the worst case."""
    return math.fsum(row.sent.count * row.transmission_ns / row.period_ns for row in rows)


def fits(rows: Sequence[FrameBounds]) -> bool:
    """Return whether each frame is sent before its next one."""
    return not any(row.late for row in rows)


def in_time(rows: Sequence[FrameBounds]) -> bool:
    """Return whether no cycle has to run on the frame before."""
    return not any(row.late or row.held for row in rows)


Good = Callable[[Sequence[FrameBounds]], bool]


def highest_hz(frames: Sequence[SentFrame], setup: Setup, good: Good) -> int:
    """Return the highest rate of whole Hz that is `good`; 0 for none, MOST_HZ for any."""
    return _boundary(
        MOST_HZ, lambda hz: good(response_rows(frames, replace(setup, rate_hz=float(hz))))
    )


def lowest_bitrate(frames: Sequence[SentFrame], setup: Setup, good: Good) -> int | None:
    """Return the lowest bit rate of whole kbit/s that is `good`; None if no CAN is."""
    most = min(setup.data_bitrate or MOST_CLASSIC, MOST_CLASSIC) // 1000

    def bad(kbit_s: int) -> bool:
        return not good(response_rows(frames, replace(setup, bitrate=1000 * kbit_s)))

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
    """Return in a line which frame a bus of the rig's own bit rate cannot take in time, or "".

    A load of more than 100 % needs no warning: `bus_load.check_rate` refuses it.
    """
    config = rig.config
    if config.bus.bits_per_s is None or pacing == "lockstep":
        return ""
    setup = Setup(config.rate_hz, config.bus.bits_per_s, config.bus.data_bitrate)
    sent = buses(rig)
    found = [response_rows(frames, setup) for frames in sent]
    late = [(i, row) for i, rows in enumerate(found) for row in rows if row.late]
    if not late or max(map(load, found)) > 1.0:
        return ""
    i, row = late[0]
    us = "without bound" if row.response_ns is None else f"{row.response_ns / 1e3:g} us"
    return (
        f"{rig.where('rate_hz')}: {row.sent.frame.name} may take {us} on a bus of {setup.bitrate} "
        f"bit/s, its period is {row.period_ns / 1e3:g} us, the load {load(found[i]):.0%}; all "
        f"frames fit up to {highest_hz(sent[i], setup, fits)} Hz, see `pcpc bus`"
    )
