"""What `pcpc bus` prints: a table by priority, and up to where the rig fits its bus."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from pcpc.executive.rig.reading import Rig
from pcpc.tools.start.bus import traffic
from pcpc.tools.start.bus.traffic import Good, Row, SentFrame, Setup
from pcpc.tools.terminal import screen

_TITLES = ("id", "frame", "from", "bytes", "bits", "T", "C", "R", "D", "margin")


@dataclass(frozen=True)
class Bus:
    """One bus of a rig with its frames' times; `origin`: where its bit rate comes from."""

    name: str
    origin: str
    setup: Setup
    frames: Sequence[SentFrame]
    rows: Sequence[Row]

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

    def bits(self, row: Row) -> tuple[int, int]:
        """Return the bits of a frame at the nominal rate and in a data phase."""
        return row.sent.frame.bits(self.setup.all_fd)


def as_json(rig: Rig, buses: Sequence[Bus]) -> dict[str, Any]:
    """Return what `--json` prints; times in us."""
    return {
        "rig": rig.config.rig, "rate_hz": rig.config.rate_hz, "pacing": rig.config.pacing,
        "buses": [_bus(bus) for bus in buses],
    }  # fmt: skip


def _bus(bus: Bus) -> dict[str, Any]:
    fits, in_time = bus.limits(traffic.fits), bus.limits(traffic.in_time)
    return {
        "name": bus.name, "bitrate": bus.setup.bitrate, "bitrate_from": bus.origin,
        "data_bitrate": bus.setup.data_bitrate, "jitter_us": bus.setup.jitter_ns / 1e3,
        "error_every_us": bus.setup.error_every_ns / 1e3, "phases_kept": bus.phases_kept,
        "in_order": bus.setup.in_order, "load": traffic.load(bus.rows),
        "fits": traffic.fits(bus.rows), "fits_to_hz": fits[0], "fits_from_bitrate": fits[1],
        "in_time": traffic.in_time(bus.rows), "in_time_to_hz": in_time[0],
        "in_time_from_bitrate": in_time[1], "frames": [_frame(row, bus) for row in bus.rows],
    }  # fmt: skip


def _frame(row: Row, bus: Bus) -> dict[str, Any]:
    frame, (nominal, data) = row.sent.frame, bus.bits(row)
    return {
        "id": frame.can_id, "extended": frame.extended, "name": frame.name,
        "sender": row.sent.sender, "count": row.sent.count, "bytes": frame.dlc,
        "bits": nominal, "data_bits": data,
        "period_us": row.period_ns / 1e3, "transmission_us": row.transmission_ns / 1e3,
        "response_us": None if row.response_ns is None else row.response_ns / 1e3,
        "deadline_us": row.deadline_ns / 1e3,
        "margin_us": None if row.margin_ns is None else row.margin_ns / 1e3,
        "late": row.late, "held": row.held,
    }  # fmt: skip


def text_of(rig: Rig, bus: Bus) -> Iterator[str]:
    """Yield the table of a bus, and what it says."""
    setup, kind = bus.setup, "classic CAN"
    if setup.data_bitrate:
        kind = f"CAN FD, data at {rate_of(setup.data_bitrate)}"
    of_what = f"{bus.name} at {rate_of(setup.bitrate)} ({bus.origin}), {kind}"
    yield from screen.wrapped_lines(
        of_what, f"{rig.config.rig} at {rig.config.rate_hz:g} Hz, ", "  "
    )
    yield ""
    cells = [_cells(row, bus) for row in bus.rows]
    yield from screen.table([_TITLES, *cells], right=range(3, 9))
    yield "us: T period, C transmission, R worst-case response, D needed after"
    yield ""
    yield from screen.rows(_verdicts(bus))


def _cells(row: Row, bus: Bus) -> tuple[str, ...]:
    frame, (nominal, data) = row.sent.frame, bus.bits(row)
    response_ns, margin_ns = row.response_ns, row.margin_ns
    return (
        f"0x{frame.can_id:0{8 if frame.extended else 3}X}", frame.name, row.sent.sender,
        f"{frame.dlc}", f"{nominal}+{data}" if data else f"{nominal}",
        _us(row.period_ns), _us(row.transmission_ns),
        "inf" if response_ns is None else _us(response_ns), _us(row.deadline_ns),
        f"{'-inf' if margin_ns is None else _us(margin_ns):>{len(_TITLES[-1])}}",
    )  # fmt: skip


def _us(ns: int) -> str:
    return f"{round(ns / 1e3)}"


def _verdicts(bus: Bus) -> Iterator[tuple[str, str]]:
    setup, rows = bus.setup, bus.rows
    given = ["phases of the nodes as in the rig" if bus.phases_kept else "any phases of the nodes"]
    if setup.in_order:
        given.append("frames of a node in the order of its loop")
    if setup.jitter_ns:
        given.append(f"jitter {setup.jitter_ns / 1e3:g} us each")
    if setup.error_every_ns:
        given.append(f"a bus error every {setup.error_every_ns / 1e6:g} ms")
    yield "with", ", ".join(given)
    yield "load", f"{traffic.load(rows):.1%} in the worst case"
    late = [row.sent.frame.name for row in rows if row.late]
    what = "each frame is sent before its next one"
    if late:
        what = f"not: {_name_list(late)} may still wait when its next one comes"
    yield "fits", f"{what} ({_limits(bus, traffic.fits, not late)})"
    held = [row.sent.frame.name for row in rows if row.held]
    what = "no frame misses the receiver's cycle"
    if held:
        what = (
            f"{_name_list(held)} may miss the receiver's cycle, which then uses the previous frame"
        )
    yield "held", f"{what} ({_limits(bus, traffic.in_time, not held)})"


def _name_list(names: Sequence[str], most: int = 6) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _limits(bus: Bus, good: Good, is_good: bool) -> str:
    """Return up to which rate the frames of a bus are `good`, and from which bit rate on."""
    hz, bitrate = bus.limits(good)
    rates = f"{'' if is_good else 'none '}up to {hz} Hz" if hz else "at any rate"
    needed = f"from {rate_of(bitrate)} on" if bitrate else "at no CAN bit rate"
    return f"{rates}; at {bus.setup.rate_hz:g} Hz {needed}"


def rate_of(bits_per_s: float) -> str:
    """Return a bit rate as people say it."""
    scale, unit = (1e6, "Mbit/s") if bits_per_s >= 1e6 else (1e3, "kbit/s")
    return f"{bits_per_s / scale:g} {unit}"
