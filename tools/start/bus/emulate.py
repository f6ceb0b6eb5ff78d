"""`pcpc bus emulate A B`: one CAN line with a bit rate, of two channels that have none.

What is sent on A is there on B when its last bit would be, and the other way round; in between
stands the model of `drivers.line.line`. At the end: what each side sent and lost, error counters,
load, and how far behind its time the gateway handed the frames over.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct, to_builtins

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import choice
from pcpc.drivers.errors import BusError, Exit
from pcpc.drivers.line import line
from pcpc.drivers.machine import realtime
from pcpc.executive.errors import RigError
from pcpc.executive.nodes.gateway import Gateway
from pcpc.executive.rig.buses import line_options, master_side, odd_rates, on_line, side_of
from pcpc.executive.rig.messages import fd_frames, has_fd_drive
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.xcp import xcp_ids
from pcpc.tools.start.bus import line_report
from pcpc.tools.start.bus.commands import EmulateRequest
from pcpc.tools.start.bus.report import rate_of
from pcpc.tools.start.bus.traffic import MOST_CLASSIC
from pcpc.tools.start.interface import named_bus
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.answer import Count, Positive, one_of
from pcpc.tools.terminal.progress import Progress

PRIORITY = 85  # above the executive's 80: a wire waits for nobody
_POLL_S = 0.1
_Late = Annotated[str, one_of("p50", "p99", "max")]


@dataclass(frozen=True)
class BusErrors:
    """How often a bit is hit, how many transmissions in a row, and by which chance."""

    p: float = 0.0
    burst: float = 1.0
    seed: int = 1

    @classmethod
    def from_text(cls, text: str | None) -> "BusErrors":
        """Return what `p=1e-5,burst=2,seed=7` says; RigError."""
        given: dict[str, Any] = {}
        for part in [] if text is None else text.replace(" ", "").split(","):
            name, _, value = part.partition("=")
            if name in given:
                raise RigError(f"--errors {text}: {name}: given twice")
            try:
                given[name] = {"p": float, "burst": float, "seed": int}[name](value)
            except (KeyError, ValueError):
                what = "expected p=1e-5,burst=2,seed=7, each of them or not"
                raise RigError(f"--errors {text}: {part}: {what}") from None
        found = cls(**given)
        if not (found.p == 0.0 or 1e-9 <= found.p <= 1.0):
            raise RigError(f"--errors p={found.p:g}: expected 0, or 1e-9 to 1 of all bits")
        if not 1.0 <= found.burst <= 1e9:
            raise RigError(f"--errors burst={found.burst:g}: expected 1 to 1e9 transmissions")
        if not 0 <= found.seed < 2**63:
            raise RigError(f"--errors seed={found.seed}: expected 0 to 2^63 - 1")
        return found


def command(request: EmulateRequest) -> int:
    """Carry frames until the end is asked for; INTERRUPTED then, LOSS if one was lost.

    RigError: wrong input.
    """
    errors = BusErrors.from_text(request.errors)
    if request.queue > line.MOST_ROOM:
        raise RigError(f"--queue {request.queue}: at most {line.MOST_ROOM}")
    if request.bitrate and request.bitrate > MOST_CLASSIC:
        raise RigError(f"--bitrate {rate_of(request.bitrate)}: classic CAN ends at 1 Mbit/s")
    bitrate, fast = request.bitrate or MOST_CLASSIC, request.data_bitrate
    others = {1: request.bitrate_b} if request.bitrate_b else {}
    if any(rate > MOST_CLASSIC for rate in others.values()):
        raise RigError(f"--bitrate-b {rate_of(others[1])}: classic CAN ends at 1 Mbit/s")
    if what := odd_rates(bitrate, fast or bitrate, others.values()):
        raise RigError(f"{'--bitrate-b' if fast is None else '--data-bitrate'}: {what}")
    sides = _sides([request.a, request.b])
    held = [choice.take_bus(choice.BusRequest(*one, rig="", roles=())) for one in sides]
    gateway = Gateway(
        request.queue,
        fast is not None,
        others=others,
        bitrate=bitrate,
        data_bitrate=fast,
        in_order=request.in_order,
        p=errors.p,
        burst=errors.burst,
        seed=errors.seed,
    )
    gateway.open([one.bus for one in held])
    names = [str(one.bus) for one in held]
    interrupted = _run(gateway, names, request.quiet, request.for_s)
    found = result(gateway, names)
    screen.answer(request.json, found, lines_of(found), 2)
    lost = any(side.refused or side.lost_off for side in found.sides)
    if interrupted:
        return Exit.INTERRUPTED
    lost = lost or any(side.errors and side.bitrate != found.bitrate for side in found.sides)
    return Exit.LOSS if lost or found.not_taken else Exit.OK


def _sides(words: list[str]) -> list[tuple[str, str | None]]:
    """Return the two buses that are named; RigError, BusError."""
    found = []
    for word in words:
        named = buses.parse(word)
        if named[0] == "auto":
            raise RigError(f"emulate {word}: name the bus: vcan0 or udp_multicast:GROUP:PORT")
        bus = named_bus(named, f"emulate {word}")
        if not bus.compiled:
            raise RigError(f"emulate {word}: expected socketcan or udp_multicast")
        if bus in found:
            raise RigError(f"emulate {' '.join(words)}: both are one bus; name another one")
        found.append(bus)
    return [(bus.interface, bus.channel) for bus in found]


def _run(gateway: Gateway, names: list[str], quiet: bool, for_s: float | None) -> bool:
    """Carry until the end; return whether it was asked for."""
    progress = Progress(quiet)
    report, failed, interrupted = realtime.prepare_process(), [], False

    def work() -> None:
        nonlocal report
        report += realtime.prepare_thread(PRIORITY, None)
        try:
            gateway.carry()
        except BusError as error:
            failed.append(error)

    thread = threading.Thread(target=work, daemon=True)
    end_s = time.monotonic() + (for_s or float("inf"))
    try:
        thread.start()
        begun = line_report.numbers(gateway.n.line, names)
        rates = line_report.rates_of(begun["bitrate"], begun["data_bitrate"])
        progress.say(f"{' and '.join(names)} are one line of {rates}")
        before = 0, 0.0
        while thread.is_alive() and (left_s := end_s - time.monotonic()) > 0.0:
            thread.join(min(left_s, _POLL_S))
            if progress.due():
                now = int(gateway.n.line.busy), gateway.passed_s
                progress.show(_state(gateway, now[0] - before[0], now[1] - before[1]))
                before = now
    except KeyboardInterrupt:
        interrupted = True
    finally:
        gateway.stop()
        thread.join()
        progress.close()
    if failed:
        raise failed[0]
    if warning := report.warning():
        progress.say(f"gateway: {warning}")
    return interrupted


def serve(rig: Rig, bus: buses.BusAddress, report: Path, ready: int) -> int:
    """Be the line of a run, in a process of its own, until SIGTERM; tell `ready`, a file, at once.

    Writes `result` to `report`. BusError goes to stderr.
    """
    config, sides = rig.config.bus, [side_of(rig, bus, role) for role in on_line(rig)]
    names = [f"{side}" for side in sides]
    if ids := xcp_ids(rig):
        sides.append(master_side(rig, bus))
        names.append(f"{sides[-1]}, XCP " + ", ".join(f"0x{down:X}" for down, _ in ids.values()))
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    fd = bool(fd_frames(rig)) or has_fd_drive(rig)
    gateway = Gateway(config.queue, fd, len(sides), **line_options(rig))
    try:
        gateway.open(sides)
        os.close(ready)
        _run(gateway, names, quiet=True, for_s=None)
    except BusError as error:
        print(f"line: {error}", file=sys.stderr)
        return error.code
    line_report.write(to_builtins(result(gateway, names)), report)
    return Exit.OK


def _state(gateway: Gateway, busy: int, passed_s: float) -> str:
    """Return a line of progress, with the load since the last one."""
    n = gateway.n.line
    load = busy / max(passed_s * int(n.per_s), 1.0)
    sides = range(int(n.senders))
    states = " ".join(line_report.STATES[line.state_of(n, s)] for s in sides)
    waiting = "+".join(str(int(n.waiting[s])) for s in sides)
    return (
        f"{int(n.sent.sum())} frames, load {load:.0%}, {int(n.errors.sum())} errors"
        f", {states}, waiting {waiting}, lost {int((n.refused + n.lost_off).sum())}"
    )


class LineSide(Struct):
    """What was sent on a channel."""

    bus: str
    bitrate: Positive
    "bit/s"
    sent: Count
    "frames"
    waiting: Count
    "frames"
    errors: Count
    refused: Count
    "frames: the queue was full"
    lost_off: Count
    "frames: bus-off"
    times_off: Count
    "bus-off"
    most_waiting: Count
    "frames at once"
    state: Annotated[str, one_of(*line_report.STATES)]
    tec: Count
    "transmit error counter"
    rec: Count
    "receive error counter"
    worst_tec: Count
    longest_us: float
    "from queue to end of frame, us"
    not_carried: Count
    "FD and remote frames"


class EmulatedLine(Struct):
    """What `--json` prints: pcpc bus emulate."""

    bitrate: Positive
    "bit/s"
    data_bitrate: int | None
    "bit/s; null: all at the one bit rate"
    load: float
    "share of the time from the first frame to the last"
    sides: Annotated[list[LineSide], Meta(min_length=2, max_length=2)]
    duration_s: float
    "s"
    not_taken: Count
    "frames that the other side's bus did not take"
    handed_over_late_us: Annotated[dict[_Late, float], Meta(min_length=3)]
    "us"


def result(gateway: Gateway, names: list[str]) -> EmulatedLine:
    """Return what `--json` prints."""
    found = line_report.numbers(gateway.n.line, names)
    counts = zip(found.pop("sides"), gateway.n.foreign, strict=False)
    return EmulatedLine(
        **found,
        sides=[LineSide(**side, not_carried=int(count)) for side, count in counts],
        duration_s=gateway.passed_s,
        not_taken=gateway.not_taken,
        handed_over_late_us=gateway.late_us(),
    )


def lines_of(found: EmulatedLine) -> Iterator[str]:
    """Yield the result in lines to read."""
    rates = line_report.rates_of(found.bitrate, found.data_bitrate)
    yield f"line     {rates}, {found.duration_s:.3f} s, load {found.load:.1%}"
    yield from line_report.mismatches(to_builtins(found))
    for side in found.sides:
        yield side.bus
        yield (
            f"  sent     {side.sent} frames, at most {side.longest_us:.0f} us "
            f"from queue to end, {side.most_waiting} waiting"
        )
        yield (
            f"  errors   {side.errors}; {side.state}, TEC {side.tec} (worst "
            f"{side.worst_tec}), REC {side.rec}, {side.times_off} times bus-off"
        )
        lost = {"queue full": side.refused, "bus-off": side.lost_off}
        told = ", ".join(f"{count} {why}" for why, count in lost.items() if count)
        yield f"  lost     {told or 'none'}"
        if side.not_carried:
            yield f"  left out {side.not_carried} FD or remote frames"
    late = found.handed_over_late_us
    yield (
        f"gateway  late p50 {late['p50']:.0f} us, p99 {late['p99']:.0f} us, max "
        f"{late['max']:.0f} us"
    )
    if found.not_taken:
        yield f"         {found.not_taken} frames not taken by the other side's bus"
