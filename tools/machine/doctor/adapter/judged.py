"""A row for each thing that an examination shows; three values: held, violated, not judged."""

from collections.abc import Iterator, Sequence

from pcpc.drivers.can.can_id import EXTENDED
from pcpc.drivers.can.frame_bits import frame_bits
from pcpc.tools.machine.doctor.adapter.channel import ChannelFacts, is_off
from pcpc.tools.machine.doctor.adapter.exam import CONFIDENCE, FEWEST, Exam, is_clean
from pcpc.tools.machine.doctor.adapter.facts import AdapterRow, Limiting, State, Word
from pcpc.tools.machine.doctor.adapter.passes import Tally, named_words
from pcpc.tools.machine.doctor.adapter.stamps import FEWEST as FEWEST_STAMPS
from pcpc.tools.machine.doctor.adapter.stamps import hardware_fault, kernel_fault
from pcpc.tools.study.binomial import upper_bound

_ACK, _OFF = 0x20, 0x40  # classes of linux/can/error.h
_CHECK = "compare `ip -details link show` of both ends; 120 ohm at each end; no node besides"
_TUNE = "pcpc doctor --tune"
_ANOTHER = "another cable, USB port, driver or adapter"


def rows_of(exam: Exam, channels: Sequence[ChannelFacts]) -> Iterator[AdapterRow]:
    """Yield all rows; `channels`: one or two, with what their counters gained."""
    yield _wiring(exam, channels)
    yield from _frames(exam)
    yield _delay(exam.judged)
    yield _load(exam, channels)
    yield _queue(exam, channels)
    yield _echo(exam, channels)
    yield _stamps(exam, channels)
    yield _fd(exam, channels)
    yield _counters(exam, channels)
    if exam.pattern.rig:
        yield _rig(exam)
    yield _adapter(channels)


def _wiring(exam: Exam, channels: Sequence[ChannelFacts]) -> AdapterRow:
    hello, name = exam.hello, "wiring"
    first, second = channels[0].bus, channels[-1].bus
    by_end = [{bit for tally in exam.tallies for bit in tally.errors[end]} for end in (0, 1)]
    errors = by_end[0] | by_end[1]
    both = [channels[0], channels[-1]]
    off = [one.bus for one, bits in zip(both, by_end, strict=True) if is_off(one) or _OFF in bits]
    if off:
        cure = f"sudo ip link set {off[0]} type can restart; {_CHECK}"
        return AdapterRow(name, "violated", f"{off[0]} went bus-off", cure)
    rates = {(one.bitrate, one.data_bitrate) for one in both if one.bitrate}
    if len(rates) > 1:
        found = f"{first} and {second} have other bit rates: {_rates(both)}"
        cure = f"sudo ip link set {second} down && sudo ip link set {second} up type can bitrate"
        return AdapterRow(name, "violated", found, f"{cure} {channels[0].bitrate}")
    came = hello.from_end
    if len(channels) == 1:
        if sum(came) == hello.sent > 0:
            return AdapterRow(name, "held", f"{first} gives its own frames back")
        return _nothing_back(first, hello, errors, channels[0])
    if all(came):
        return AdapterRow(name, "held", f"{first} and {second} hear each other")
    deaf = [(second, first, 0), (first, second, 1)]
    hears = [(ear, mouth, end) for ear, mouth, end in deaf if not came[end]]
    ear, mouth, end = hears[0]
    if errors & {_ACK} or (not hello.given_back[end] and channels[end].counters is not None):
        found = f"{mouth} gets no acknowledgement: another bit rate, no second node, no terminator"
        return AdapterRow(name, "violated", found, _CHECK)
    what = f"{ear} hears nothing of {mouth}" + (", nor the other way" if len(hears) == 2 else "")
    return AdapterRow(name, "violated", f"{what}: not one line", f"wire {mouth} to {ear}; {_CHECK}")


def _rates(channels: Sequence[ChannelFacts]) -> str:
    return ", ".join(
        f"{one.bitrate}" + (f"/{one.data_bitrate}" if one.data_bitrate else "") for one in channels
    )


def _nothing_back(name: str, hello: Tally, errors: set[int], channel: ChannelFacts) -> AdapterRow:
    if errors & {_ACK} or hello.refused:
        found = f"{name} gets no acknowledgement: another bit rate, no second node, no terminator"
        return AdapterRow("wiring", "violated", found, _CHECK)
    found = f"{name} gives {sum(hello.from_end)} of {hello.sent} own frames back: no echo"
    return AdapterRow("wiring", "not judged", found, f"name a second channel: --bus {name},can1")


def _frames(exam: Exam) -> Iterator[AdapterRow]:
    """Yield what became of the frames: loss, and each other way to be wrong."""
    tally = exam.judged
    if exam.burst is None:
        for name in ("loss", "once", "whole", "in order"):
            yield AdapterRow(name, "not judged", "no frame made its way")
        return
    yield _loss(exam, tally)
    every = [exam.burst, *exam.fd, *([exam.long] if exam.long else []), *exam.steps, exam.hello]
    for name, count, what in (
        ("once", sum(one.doubled for one in every), "came twice"),
        ("whole", sum(one.changed for one in every), "came with other bytes"),
        ("in order", sum(one.misordered for one in every), "came behind a later one of their id"),
    ):
        sent = sum(one.sent for one in every)
        state: State = "violated" if count else "held"
        yield AdapterRow(
            name, state, f"{count:,} of {sent:,} frames {what}", _ANOTHER * bool(count)
        )
    words = sum((one.strange_words for one in every), start=exam.hello.strange_words.copy())
    if words:
        found = f"{words.total():,} frames that nobody sent here: {named_words(words)}"
        yield AdapterRow("strangers", "violated", found, f"end others on the bus, else {_ANOTHER}")


def _loss(exam: Exam, tally: Tally) -> AdapterRow:
    others = [one for one in (exam.hello, exam.burst) if one is not None and one is not tally]
    lost, sent = tally.lost, tally.sent
    before = sum(one.lost for one in others)
    bound = upper_bound(lost, sent, CONFIDENCE) if sent else 1.0
    shown = (
        f"{lost:,} of {sent:,} lost at {tally.rate_hz:.4g} Hz: below {bound:.2g} ({CONFIDENCE:.0%})"
    )
    if tally.dropped:
        return AdapterRow("loss", "not judged", f"{shown}, {tally.dropped} by this program", _TUNE)
    if before:
        shown += f", {before} of {sum(one.sent for one in others)} before"
    if lost or before:
        return AdapterRow("loss", "violated", shown, _ANOTHER)
    if sent < FEWEST:
        cure = f"--frames {FEWEST}" if exam.asked < FEWEST else "a faster bus, or adapter"
        return AdapterRow("loss", "not judged", f"{shown}; {FEWEST:,} are needed", cure)
    return AdapterRow("loss", "held", shown)


def _delay(tally: Tally) -> AdapterRow:
    if not tally.delays_ns:
        return AdapterRow("delay", "not judged", "no frame made its way in time of this program")
    longest = f"longest {max(tally.delays_ns) / 1e3:,.0f} us"
    found = f"{tally.late:,} of {len(tally.delays_ns):,} late, {longest}"
    if tally.held_up:
        found += f"; {tally.held_up:,} not measured, this program was held up"
    if tally.late and tally.unstamped * 2 > tally.arrived:
        found += "; no stamps: this program may have looked late"
        return AdapterRow("delay", "not judged", found, "use a SocketCAN driver, which has stamps")
    if tally.late:
        return AdapterRow("delay", "violated", found, f"{_TUNE}; then {_ANOTHER}")
    if 2 * tally.held_up > tally.arrived:
        return AdapterRow("delay", "not judged", found, _TUNE)
    return AdapterRow("delay", "held", found)


def limited_by(exam: Exam) -> Limiting:
    """Return what came at a rate that was not held."""
    failed = exam.first_failed
    if failed is None:
        return ""
    if failed.dropped or (not failed.offered and not failed.wrong):
        return "this program"
    return "loss" if failed.wrong or failed.strange else "queue" if failed.refused else "delay"


def load_of(exam: Exam, channels: Sequence[ChannelFacts], hz: float) -> float | None:
    """Return the share of the bit rate that the pattern takes at a rate, at most; None: unknown."""
    bitrate = channels[0].bitrate
    if bitrate is None:
        return None
    fast, seconds = channels[0].data_bitrate or bitrate, 0.0
    for one in exam.pattern.frames:
        nominal, data = frame_bits(one.length, bool(one.word & EXTENDED), one.flags)
        seconds += (nominal / bitrate + data / fast) / one.every_n
    return seconds * hz


def _load(exam: Exam, channels: Sequence[ChannelFacts]) -> AdapterRow:
    hz, failed, why = exam.highest_hz, exam.first_failed, limited_by(exam)
    if not exam.steps:
        return AdapterRow("load", "not judged", "no frame made its way")
    share = load_of(exam, channels, hz)
    per_s = f"{hz * exam.pattern.per_cycle:,.0f} frames/s"
    found = f"{per_s} all there and in time" + (
        "" if share is None else f", {share:.0%} of the bit rate"
    )
    if exam.long is not None and not exam.long.offered:
        slow = f"{found}; in the long pass this program was too slow"
        return AdapterRow("load", "not judged", slow, _TUNE)
    if failed is None:
        return AdapterRow("load", "held", found)
    above = f"at {failed.rate_hz * exam.pattern.per_cycle:,.0f} frames/s"
    if why == "this program":
        return AdapterRow(
            "load", "held" if hz else "not judged", f"{found}; {above} this program was too slow"
        )
    if why == "loss":
        gone = f"{found}; {above} {failed.wrong:,} of {failed.sent:,} were not"
        cure = f"keep the load below, or {_ANOTHER}"
        enough = exam.pattern.rig and hz >= exam.pattern.rate_hz
        return AdapterRow("load", "held" if enough else "violated", gone, cure)
    what = "its queue was full" if why == "queue" else f"{failed.late:,} were late"
    return AdapterRow(
        "load", "held" if hz else "violated", f"{found}; {above} {what}", _TUNE * (not hz)
    )


def _queue(exam: Exam, channels: Sequence[ChannelFacts]) -> AdapterRow:
    burst, name = exam.burst, "queue"
    known = [one for one in channels if one.queue is not None]
    told = ", ".join(f"{one.bus} {one.queue}" for one in known)
    if burst is None:
        return AdapterRow(name, "not judged", told or "no frame made its way", needed=False)
    size = burst.sent + burst.refused
    found = f"{burst.sent} of {size} frames at once taken" + (f"; room for {told}" if told else "")
    refused = exam.judged.refused
    if refused:
        found += f"; {refused:,} refused at {exam.judged.rate_hz:.4g} Hz"
    if (
        refused
        or burst.refused
        or any(one.kind == "can" and one.queue is not None and one.queue < size for one in known)
    ):
        short = min(known, key=lambda one: one.queue or 0, default=channels[0]).bus
        return AdapterRow(name, "violated", found, f"sudo ip link set {short} txqueuelen 1000")
    if any(one.software for one in channels):
        return AdapterRow(name, "not judged", f"{found}; no controller waits", needed=False)
    return AdapterRow(name, "held", found)


def _echo(exam: Exam, channels: Sequence[ChannelFacts]) -> AdapterRow:
    tally, name = exam.judged, "echo"
    if len(channels) == 1:
        return AdapterRow(name, "not judged", "it is what was heard", needed=False)
    found = f"{sum(tally.given_back):,} of {tally.sent:,} own frames came back when sent"
    if channels[0].kind == "can" and sum(tally.given_back) < tally.sent - tally.lost:
        return AdapterRow(name, "violated", found, "run candump on the other channel; newer driver")
    if channels[0].software or channels[0].kind != "can":
        return AdapterRow(name, "not judged", f"{found}; no controller says so", needed=False)
    return AdapterRow(name, "held", found, needed=False)


def _stamps(exam: Exam, channels: Sequence[ChannelFacts]) -> AdapterRow:
    tally, name = exam.judged, "stamps"
    if fault := kernel_fault(tally.kernel):
        found = f"{fault.count:,} {fault.why}, by up to {fault.worst_ns / 1e3:,.0f} us"
        return AdapterRow(name, "violated", found, "newer driver; use no stamps of this channel")
    for stamps in tally.hardware:
        if fault := hardware_fault(stamps):
            found = (
                f"{fault.count:,} of hardware {fault.why}, by up to {fault.worst_ns / 1e3:,.0f} us"
            )
            return AdapterRow(
                name, "violated", found, "newer driver; use no stamps of this channel"
            )
    count = sum(map(len, tally.hardware))
    if count >= FEWEST_STAMPS:
        return AdapterRow(name, "held", f"{count:,} of hardware, between sending and reading")
    kernel = f"{len(tally.kernel):,} of the kernel or driver, between sending and reading; "
    return AdapterRow(
        name, "not judged", f"{kernel * bool(tally.kernel)}none of hardware", needed=False
    )


def _fd(exam: Exam, channels: Sequence[ChannelFacts]) -> AdapterRow:
    needed = exam.pattern.fd
    if not exam.fd:
        up = (
            f"sudo ip link set {channels[0].bus} up type can bitrate 1000000 dbitrate 5000000 fd on"
        )
        cure = up if channels[0].kind == "can" else ""
        return AdapterRow("CAN FD", "not judged", "not tried: no FD here", cure, needed)
    sent, wrong = (sum(getattr(one, what) for one in exam.fd) for what in ("sent", "wrong"))
    lengths = f"{wrong:,} of {sent:,} frames of 12 and 64 bytes lost or wrong"
    if wrong or not sent:
        cure = "same dbitrate and sample point at both ends; short cable"
        return AdapterRow("CAN FD", "violated", lengths, cure, needed)
    return AdapterRow("CAN FD", "held", lengths, needed=needed)


def _counters(exam: Exam, channels: Sequence[ChannelFacts]) -> AdapterRow:
    name = "error counters"
    errors = sum(sum(one.values()) for tally in exam.tallies for one in tally.errors)
    gained = [
        f"{one.bus} {k} +{n}" for one in channels for k, n in (one.counters or {}).items() if n
    ]
    if errors:
        gained.append(f"{errors} error frames")
    if gained:
        return AdapterRow(name, "violated", ", ".join(gained), _CHECK)
    if any(one.counters is None for one in channels):
        without = ", ".join(one.bus for one in channels if one.counters is None)
        kind = (
            "a bus of software" if any(one.software for one in channels) else "no counters to read"
        )
        cure = "" if any(one.software for one in channels) else "use a SocketCAN driver"
        return AdapterRow(name, "not judged", f"{without}: {kind}", cure, needed=False)
    return AdapterRow(name, "held", "none gained")


def _rig(exam: Exam) -> AdapterRow:
    pattern, long = exam.pattern, exam.long
    name = f"{pattern.rig} at {pattern.rate_hz:g} Hz"
    if long is None:
        failed = exam.first_failed
        state: State = "violated" if failed is not None else "not judged"
        found = f"not all there and in time at {failed.rate_hz:.4g} Hz" if failed else "not tried"
        return AdapterRow(name, state, found, _ANOTHER)
    more = f"; {pattern.left_out}" if pattern.left_out else ""
    if not is_clean(long):
        what = "this program was too slow" if not long.offered else "not all there and in time"
        wrong = long.wrong + long.strange + long.late + long.refused
        return AdapterRow(
            name,
            "violated" if wrong else "not judged",
            f"at {long.rate_hz:.4g} Hz {what}{more}",
            _ANOTHER if wrong else _TUNE,
        )
    found = f"{long.sent:,} of its frames at {long.rate_hz:.4g} Hz there and in time{more}"
    if long.rate_hz < pattern.rate_hz:
        by = limited_by(exam)
        state = "not judged" if by == "this program" else "violated"
        return AdapterRow(
            name, state, f"{found}; faster: {by}", f"--set rate_hz={long.rate_hz:.0f}"
        )
    return AdapterRow(name, "held", found)


def _adapter(channels: Sequence[ChannelFacts]) -> AdapterRow:
    if all(one.software for one in channels):
        return AdapterRow(
            "adapter", "not judged", "a bus of software: no adapter took part", needed=False
        )
    if len(channels) == 1:
        found = "what this channel sent was heard from itself; what it receives was not tried"
        return AdapterRow("reception", "not judged", found, f"--bus {channels[0].bus},can1")
    return AdapterRow("adapter", "held", "two channels of hardware", needed=False)


def verdict_of(rows: Sequence[AdapterRow]) -> Word:
    """Return good only where all that is needed is held and nothing is violated."""
    if any(row.state == "violated" for row in rows):
        return "not good"
    return "not judged" if any(row.needed and row.state != "held" for row in rows) else "good"
