"""What `pcpc bus` prints: a table by priority, and up to where the rig fits its bus."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta, Struct

from pcpc.executive.rig.reading import Rig
from pcpc.tools.start.bus import traffic
from pcpc.tools.start.bus.traffic import FrameBounds, Good, SentFrame, Setup
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.answer import Count, Pacing, Positive, one_of

_TITLES = ("id", "frame", "from", "bytes", "bits", "T", "C", "R", "D", "margin")
ORIGINS = "--bitrate", "of the rig", "assumed, the rig names none"  # of a bit rate


@dataclass(frozen=True)
class BusReport:
    """One bus of a rig with its frames' times; `origin`: where its bit rate comes from."""

    name: str
    origin: str
    setup: Setup
    frames: Sequence[SentFrame]
    rows: Sequence[FrameBounds]

    @property
    def phases_kept(self) -> bool:
        """Whether the nodes keep their phases to each other."""
        return any(sent.phase is not None for sent in self.frames)

    def limits(self, good: Good) -> tuple[int, int | None]:
        """Return the highest rate and the lowest bit rate that are `good`."""
        return (
            traffic.highest_hz(self.frames, self.setup, good),
            traffic.lowest_bitrate(self.frames, self.setup, good),
        )

    def bits(self, row: FrameBounds) -> tuple[int, int]:
        """Return the bits of a frame at the nominal rate and in a data phase."""
        return row.sent.frame.bits(self.setup.all_fd)


class FrameTimes(Struct):
    """A frame."""

    id: Count
    extended: bool
    "29 bits"
    name: str
    sender: str
    "node"
    count: Positive
    "of this form that come together; the response is that of the last"
    bytes: Count
    bits: Count
    "on the wire, at most, at the nominal rate"
    data_bits: Count
    "at the rate of the data phase"
    period_us: float
    "us"
    transmission_us: float
    "us"
    response_us: float | None
    "worst case, us; null: no end"
    deadline_us: float
    "needed after, us"
    margin_us: float | None
    "deadline less response, us; null: no end"
    late: bool
    "it may wait when its next one comes"
    held: bool
    "it may miss the receiver's cycle"


class BusTimes(Struct):
    """A bus."""

    name: Annotated[str, one_of("bus", "local bus", "second bus")]
    bitrate: Positive
    "bit/s"
    bitrate_from: Annotated[str, one_of(*ORIGINS)]
    data_bitrate: int | None
    "of CAN FD, bit/s; null: classic CAN"
    jitter_us: float
    "us"
    error_every_us: float
    "0: no bus errors, us"
    phases_kept: bool
    "the nodes keep their phases to each other"
    in_order: bool
    "frames of a node go out in the order of its loop"
    load: float
    "share of the bit rate, in the worst case"
    fits: bool
    "each frame is sent before its next one"
    fits_to_hz: Count
    "highest such rate, Hz; 0: none"
    fits_from_bitrate: int | None
    "lowest such bit rate, bit/s; null: none"
    in_time: bool
    "no frame misses the receiver's cycle"
    in_time_to_hz: Count
    "highest such rate, Hz; 0: none"
    in_time_from_bitrate: int | None
    "lowest such bit rate, bit/s; null: none"
    frames: list[FrameTimes]
    "by priority"


class Times(Struct):
    """What `--json` prints: pcpc bus RIG."""

    rig: str
    rate_hz: float
    "Hz"
    pacing: Pacing
    buses: Annotated[list[BusTimes], Meta(min_length=1)]


def times(rig: Rig, buses: Sequence[BusReport]) -> Times:
    """Return what `--json` prints; times in us."""
    config = rig.config
    return Times(config.rig, config.rate_hz, config.pacing, [_bus(bus) for bus in buses])


def _bus(bus: BusReport) -> BusTimes:
    fits, in_time = bus.limits(traffic.fits), bus.limits(traffic.in_time)
    return BusTimes(
        name=bus.name, bitrate=bus.setup.bitrate, bitrate_from=bus.origin,
        data_bitrate=bus.setup.data_bitrate, jitter_us=bus.setup.jitter_ns / 1e3,
        error_every_us=bus.setup.error_every_ns / 1e3, phases_kept=bus.phases_kept,
        in_order=bus.setup.in_order, load=traffic.load(bus.rows),
        fits=traffic.fits(bus.rows), fits_to_hz=fits[0], fits_from_bitrate=fits[1],
        in_time=traffic.in_time(bus.rows), in_time_to_hz=in_time[0],
        in_time_from_bitrate=in_time[1], frames=[_frame(row, bus) for row in bus.rows],
    )  # fmt: skip


def _frame(row: FrameBounds, bus: BusReport) -> FrameTimes:
    frame, (nominal, data) = row.sent.frame, bus.bits(row)
    return FrameTimes(
        id=frame.can_id, extended=frame.extended, name=frame.name,
        sender=row.sent.sender, count=row.sent.count, bytes=frame.dlc,
        bits=nominal, data_bits=data,
        period_us=row.period_ns / 1e3, transmission_us=row.transmission_ns / 1e3,
        response_us=None if row.response_ns is None else row.response_ns / 1e3,
        deadline_us=row.deadline_ns / 1e3,
        margin_us=None if row.margin_ns is None else row.margin_ns / 1e3,
        late=row.late, held=row.held,
    )  # fmt: skip


def lines(rig: Rig, bus: BusReport) -> Iterator[str]:
    """Yield the table of a bus, and what it says."""
    setup, kind = bus.setup, "classic CAN"
    if setup.data_bitrate:
        kind = f"CAN FD, data at {rate_of(setup.data_bitrate)}"
    of_what = f"{bus.name} at {rate_of(setup.bitrate)} ({bus.origin}), {kind}"
    yield f"{rig.config.rig} at {rig.config.rate_hz:g} Hz, {of_what}"
    yield ""
    cells = [_cells(row, bus) for row in bus.rows]
    yield from screen.table([_TITLES, *cells], right=range(3, 10))
    yield "us: T period, C transmission, R worst-case response, D needed after"
    yield ""
    yield from _verdicts(bus)


def _cells(row: FrameBounds, bus: BusReport) -> tuple[str, ...]:
    frame, (nominal, data) = row.sent.frame, bus.bits(row)
    response_ns, margin_ns = row.response_ns, row.margin_ns
    return (
        f"0x{frame.can_id:0{8 if frame.extended else 3}X}", frame.name, row.sent.sender,
        f"{frame.dlc}", f"{nominal}+{data}" if data else f"{nominal}",
        _us(row.period_ns), _us(row.transmission_ns),
        "inf" if response_ns is None else _us(response_ns), _us(row.deadline_ns),
        "-inf" if margin_ns is None else _us(margin_ns),
    )  # fmt: skip


def _us(ns: int) -> str:
    return f"{round(ns / 1e3)}"


def _verdicts(bus: BusReport) -> Iterator[str]:
    setup, rows = bus.setup, bus.rows
    given = ["phases of the nodes as in the rig" if bus.phases_kept else "any phases of the nodes"]
    if setup.in_order:
        given.append("frames of a node in the order of its loop")
    if setup.jitter_ns:
        given.append(f"jitter {setup.jitter_ns / 1e3:g} us each")
    if setup.error_every_ns:
        given.append(f"a bus error every {setup.error_every_ns / 1e6:g} ms")
    yield f"with  {', '.join(given)}"
    yield f"load  {traffic.load(rows):.1%} in the worst case"
    late = [row.sent.frame.name for row in rows if row.late]
    what = "each frame is sent before its next one"
    if late:
        what = f"not: {_name_list(late)} may still wait when its next one comes"
    yield f"fits  {what} ({_limits(bus, traffic.fits, not late)})"
    held = [row.sent.frame.name for row in rows if row.held]
    what = "no frame misses the receiver's cycle"
    if held:
        what = (
            f"{_name_list(held)} may miss the receiver's cycle, which then uses the previous frame"
        )
    yield f"held  {what} ({_limits(bus, traffic.in_time, not held)})"


def _name_list(names: Sequence[str], most: int = 6) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _limits(bus: BusReport, good: Good, is_good: bool) -> str:
    """Return up to which rate the frames of a bus are `good`, and from which bit rate on."""
    hz, bitrate = bus.limits(good)
    rates = f"{'' if is_good else 'none '}up to {hz} Hz" if hz else "at any rate"
    needed = f"from {rate_of(bitrate)} on" if bitrate else "at no CAN bit rate"
    return f"{rates}; at {bus.setup.rate_hz:g} Hz {needed}"


def rate_of(bits_per_s: float) -> str:
    """Return a bit rate as people say it."""
    scale, unit = (1e6, "Mbit/s") if bits_per_s >= 1e6 else (1e3, "kbit/s")
    return f"{bits_per_s / scale:g} {unit}"
