"""`pcpc doctor --bus can0[,can1] [RIG]`: whether an adapter is good enough, by frames on it.

Nothing is sent where others talk. Not judged is not good.
"""

import sys
import threading
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import choice
from pcpc.drivers.errors import BusError, Exit
from pcpc.drivers.machine import realtime
from pcpc.executive.errors import RigError
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.machine.doctor.adapter import judged
from pcpc.tools.machine.doctor.adapter.channel import ChannelFacts, channel_of, is_off
from pcpc.tools.machine.doctor.adapter.ends import End, open_end
from pcpc.tools.machine.doctor.adapter.exam import CONFIDENCE, FEWEST, Exam, examine
from pcpc.tools.machine.doctor.adapter.facts import AdapterFacts, RatePass
from pcpc.tools.machine.doctor.adapter.passes import Tally, named_words, others_on
from pcpc.tools.machine.doctor.adapter.pattern import Pattern, plain_pattern, rig_pattern
from pcpc.tools.machine.doctor.commands import DoctorRequest
from pcpc.tools.machine.jitter import nines
from pcpc.tools.start.interface import named_bus
from pcpc.tools.study.binomial import upper_bound
from pcpc.tools.terminal import document, screen
from pcpc.tools.terminal.document import Bullets, LabelledTexts, Part, Section
from pcpc.tools.terminal.progress import Progress

QUIET_S = 0.5
PRIORITY = 80  # the executive's
DOES_NOT_HOLD = {"good": Exit.OK, "not good": Exit.NOT_MET, "not judged": Exit.NOT_MET}


def command(request: DoctorRequest) -> int:
    """Examine, print; LOSS, NOT_MET. RigError: wrong input; BusError: a bus cannot be used."""
    pattern = (
        plain_pattern()
        if request.rig is None
        else rig_pattern(load_rig(request.rig, resolve=False))
    )
    addresses = _addresses(request.bus or "")
    held = [choice.take_bus(choice.BusRequest(*one, rig="", roles=())) for one in addresses]
    progress = Progress(request.json)
    try:
        for one in held:
            if one.bus.compiled and not one.claims:
                what = "a run or another program of pcpc is on it; end that first"
                raise BusError(f"{one.bus}: {what}, nothing was sent")
        found = examined([one.bus for one in held], pattern, request.frames, progress)
    finally:
        progress.close()
        for one in held:
            one.release()
    screen.answer(
        request.json, found, [line for part in parts(found) for line in document.terminal(part)], 2
    )
    return exit_code(found)


def _addresses(text: str) -> list[tuple[str, str | None]]:
    """Return the one or two buses that are named; RigError."""
    words = text.split(",")
    found = []
    for word in words:
        named = buses.parse(word)
        if named[0] == "auto" or not word:
            raise RigError(
                f"--bus {text}: name one or two channels, as can0,can1 or udp_multicast:GROUP"
            )
        bus = named_bus(named, f"--bus {text}")
        if bus in found:
            raise RigError(f"--bus {text}: {word} is named twice; name another one, or one only")
        found.append(bus)
    if len(found) > 2:
        raise RigError(f"--bus {text}: {len(found)} channels; name one or two")
    return [(bus.interface, bus.channel) for bus in found]


def examined(
    named: Sequence[buses.BusAddress], pattern: Pattern, frames: int, progress: Progress
) -> AdapterFacts:
    """Return what became of one or two buses; BusError."""
    before = [channel_of(bus) for bus in named]
    for channel in before:
        if is_off(channel) and channel.state == "BUS-OFF":
            cure = f"sudo ip link set {channel.bus} type can restart"
            raise BusError(
                f"{channel.bus}: the controller is bus-off; run `{cure}`, see its bit rate"
            )
    opened: list[End] = []
    try:
        for bus in named:
            opened.append(open_end(bus))
        if len(named) == 1:
            opened.append(open_end(named[0]) if named[0].compiled else opened[0])
        for end in opened:
            if pattern.fd and not end.has_fd:
                cure = "use a SocketCAN interface with `fd on`"
                raise BusError(f"{end.name}: {pattern.rig} has frames of CAN FD; {cure}")
        return examined_ends(opened, before, [*named], pattern, frames, progress)
    finally:
        for end in {id(end): end for end in opened}.values():
            end.close()


def examined_ends(
    ends: Sequence[End], before: Sequence[ChannelFacts], named: Sequence[buses.BusAddress],
    pattern: Pattern, frames: int, progress: Progress,
) -> AdapterFacts:  # fmt: skip
    """Return what became of the buses of two open ends; BusError where others talk."""
    others = others_on([*{id(end): end for end in ends}.values()], QUIET_S)
    if others:
        talk = f"{others.total()} frames in {QUIET_S:g} s, ids {named_words(others)}"
        names = ",".join(one.bus for one in before)
        raise BusError(f"{names}: others talk: {talk}; end them first; nothing was sent")
    if not all(one.software for one in before):
        names = ", ".join(one.bus for one in before)
        what = f"sends {frames:,} frames and more on {names}: nothing that moves may listen"
        print(what, file=sys.stderr, flush=True)
    exam = _undisturbed(lambda: examine(ends, pattern, frames, progress))
    channels = [channel_of(bus).since(one) for bus, one in zip(named, before, strict=True)]
    return facts(exam, channels)


def _undisturbed(work: Callable[[], Exam]) -> Exam:
    """Return what `work` does in a thread that is scheduled as the executive's, where allowed."""
    done: list[Exam] = []
    failed: list[Exception] = []

    def run() -> None:
        realtime.prepare_thread(PRIORITY, None)
        try:
            done.append(work())
        except Exception as error:  # raised below, in the thread of the command
            failed.append(error)

    thread = threading.Thread(target=run, name="adapter", daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(0.1)
    if failed:
        raise failed[0]
    return done[0]


def facts(exam: Exam, channels: Sequence[ChannelFacts]) -> AdapterFacts:
    """Return what `--json` prints."""
    rows = [*judged.rows_of(exam, channels)]
    verdict = judged.verdict_of(rows)
    tally, hz = exam.judged, exam.highest_hz
    delays_us = np.sort(np.array(tally.delays_ns, float)) / 1e3
    good = verdict == "good" and exam.pattern.rig and exam.long is not None
    return AdapterFacts(
        channels=[*channels],
        way="two channels" if len(channels) == 2 else "one channel",
        software=all(one.software for one in channels),
        rig=exam.pattern.rig or None,
        verdict=verdict,
        good_for_hz=exam.long.rate_hz if good and exam.long else None,
        long=_pass(exam, exam.long) if exam.long else None,
        loss_below=upper_bound(tally.lost, tally.sent, CONFIDENCE) if tally.arrived else None,
        frames_needed=FEWEST,
        delay_us=nines.quantiles({"delay": delays_us})["delay"] if len(delays_us) else None,
        highest_hz=hz or None,
        highest_frames_per_s=hz * exam.pattern.per_cycle or None,
        highest_load=judged.load_of(exam, channels, hz) if hz else None,
        limited_by=judged.limited_by(exam),
        steps=[_pass(exam, one) for one in exam.steps],
        rows=rows,
    )


def _pass(exam: Exam, tally: Tally) -> RatePass:
    return RatePass(
        tally.rate_hz, tally.rate_hz * exam.pattern.per_cycle, tally.sent, max(tally.lost, 0),
        tally.doubled, tally.changed, tally.misordered, tally.late, tally.refused, tally.offered,
    )  # fmt: skip


def parts(found: AdapterFacts) -> Iterator[Part]:
    """Yield what is printed."""
    yield LabelledTexts({f"{row.state:12}{row.name}": row.found for row in found.rows}, 28)
    yield ""
    yield f"verdict     {conclusion(found)}"
    cures = [f"{row.name}: {row.cure}" for row in found.rows if row.cure and row.state != "held"]
    yield Section("to mend, or to judge more:", [Bullets(cures)])


def conclusion(found: AdapterFacts) -> str:
    """Return the verdict in a line."""
    open_rows = [row.name for row in found.rows if row.state == "not judged"]
    but = f"; not judged: {', '.join(open_rows)}" if open_rows else ""
    for_what = ""
    if found.good_for_hz is not None:
        for_what = f" for {found.good_for_hz:.4g} Hz with the frames of {found.rig}"
    elif found.verdict == "good" and found.long is not None:
        for_what = f" for {found.long.frames_per_s:,.0f} frames/s, a frame each way"
    where = ", on a bus of software" if found.software and found.verdict == "good" else ""
    return f"{found.verdict}{for_what}{where}{but}"


def exit_code(found: AdapterFacts) -> Exit:
    """Return OK for good, LOSS where frames were lost, doubled or changed, else NOT_MET."""
    lossy = {"loss", "once", "whole"}
    if any(row.name in lossy and row.state == "violated" for row in found.rows):
        return Exit.LOSS
    return DOES_NOT_HOLD[found.verdict]
