"""What a device did on the bus, from what its plant recorded, and what was wrong with it.

    wrong CRC, twice, jump, gap   as the receiver judged CRC and counter of each frame
    late                          cycles of the plant without a valid frame of every cycle
    silent                        MAX_DELTA of them in a row, or more: no gap of a counter
    rate                          of SYNC, on a clock: more than RATE_ERROR from the rig's
    restarted                     it greets again after it was operational

Single late cycles on a clock are what holding is for: they are told, and a fault of the device only
from LATE_SHARE of all on. In lockstep there is no clock that could excuse one.

On a clock with pacing sync each frame is stamped as it comes; with pacing real when the plant's
next cycle takes it, so that jitter and reaction are those that a witness counted.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can.e2e import MAX_DELTA
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.canopen.layout import Heartbeat
from pcpc.executive.log.reader import Log
from pcpc.executive.rig import messages
from pcpc.executive.rig.reading import Rig
from pcpc.tools.make.device.below import NodesBelow
from pcpc.tools.make.device.witness import Counts, share

LATE_SHARE = 0.01  # of the cycles: a PC without SCHED_FIFO is late in some, and holds
RATE_ERROR = 0.01  # a quartz is 100 times better
FEWEST = 50  # frames that tell a rate
LONGEST = 500  # frames of a stretch, in which a stamp that is a cycle off is a fifth of RATE_ERROR
SHOWN = 3  # silences by name, of one frame
GREETINGS = Heartbeat.BOOT_UP, Heartbeat.PRE_OPERATIONAL
_WRONG = {
    FrameState.ERROR: "with a wrong CRC or length",
    FrameState.REPEATED: "sent twice: the counter stood still",
    FrameState.WRONG_SEQUENCE: "with a jump of the counter",
    FrameState.OK_SOME_LOST: "behind a gap of the counter",
    FrameState.FOREIGN: "from another sender",
}
Frames = NDArray[Any]


@dataclass
class Behaviour:
    """What a device did. `frames`: counts by name; `timing`: us and Hz, on a clock.

    `ages`: cycles, of the frames of every cycle, where known; see `age`.
    """

    frames: dict[str, dict[str, int]] = field(default_factory=dict)
    timing: dict[str, float] = field(default_factory=dict)
    late_cycles: int = 0
    ages: dict[str, int] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    warned: list[str] = field(default_factory=list)

    def json(self) -> dict[str, Any]:
        """Return it as summary.json has it."""
        return {
            "frames": self.frames,
            "timing": self.timing,
            "late_cycles": self.late_cycles,
            "age_cycles": self.ages,
            "problems": self.problems,
        }


def behaviour(rig: Rig, log: Log, pacing: str, counts: Counts | None = None) -> Behaviour:
    """Return what the device did in the run of what is below it; BusError without the DBC file.

    `counts`: what a witness of the bus has told.
    """
    found, below = Behaviour(), NodesBelow(rig)
    heard = below.record(log)
    came = heard.frames[heard.frames["direction"] == 1]
    for role, frame in below.heard:
        own = came[came["id"] == frame.word]
        if frame.on_event and not len(own):
            continue
        found.frames[frame.name] = _counts(own)
        if not len(own):
            found.problems.append(f"device: {frame.name} never came")
        for state, what in _WRONG.items():
            wrong = own["cycle"][own["e2e"] == state]
            if len(wrong):
                first = int(wrong[0])
                found.problems.append(
                    f"device: {frame.name}: {_frames(len(wrong))} {what}, first in "
                    + _cycle(rig, first)
                )
        if frame.has_sequence:
            found.problems += _rate(found, rig, own, pacing)
        elif messages.is_awaited(frame):
            found.problems += _lateness(found, rig, frame.name, own, log.node[role].cycle, pacing)
            _reaction(found, own, heard.frames, pacing)
    found.problems += _restarts(rig, came)
    for name, of in (counts or {}).items():
        if of.total() >= FEWEST:
            _note_quantiles(found, name, partial(share, of))
    return found


def _note_quantiles(found: Behaviour, name: str, value_at: Callable[[float], float]) -> None:
    """Note the median, the 99th percentile and the largest of a time, us."""
    for word, percent in (("p50", 50.0), ("p99", 99.0), ("max", 100.0)):
        found.timing[f"{name}_{word}_us"] = round(value_at(percent), 1)


def _cycle(rig: Rig, cycle: int) -> str:
    return f"cycle {cycle} ({cycle / rig.config.rate_hz:.4g} s)"


def _frames(count: int) -> str:
    return "1 frame" if count == 1 else f"{count:,} frames"


def _counts(own: Frames) -> dict[str, int]:
    names = {
        FrameState.OK: "ok",
        FrameState.OK_SOME_LOST: "gaps",
        FrameState.WRONG_SEQUENCE: "jumps",
        FrameState.REPEATED: "twice",
    }
    names |= {FrameState.ERROR: "wrong_crc", FrameState.FOREIGN: "foreign"}
    counts = {name: int((own["e2e"] == state).sum()) for state, name in names.items()}
    return {"received": len(own), **{name: n for name, n in counts.items() if n}}


def _used_frames(own: Frames) -> Frames:
    return own[(own["e2e"] == FrameState.OK) | (own["e2e"] == FrameState.OK_SOME_LOST)]


def _lateness(
    found: Behaviour, rig: Rig, name: str, own: Frames, cycle: NDArray[np.int64], pacing: str
) -> Iterator[str]:
    """Yield what is wrong with the cycles that had no valid frame `name`; cycle 0 has none ever."""
    ran = cycle[cycle > 0]
    without = ~np.isin(ran, _used_frames(own)["cycle"])
    edge = np.flatnonzero(np.diff(np.concatenate([[0], without.astype(np.int8), [0]])))
    late, silent = 0, list[str]()
    for first, past in edge.reshape(-1, 2).tolist():
        if past - first < MAX_DELTA:
            late += past - first
            continue
        begin_s, cycles = ran[first] / rig.config.rate_hz, past - first
        end = ", to the end" if past == len(ran) else ""
        for_s = cycles / rig.config.rate_hz
        silent.append(
            f"device: {name}: silent for {cycles:,} cycles ({for_s:.4g} s) from {begin_s:.4g} s on"
            + end
        )
    found.late_cycles = max(found.late_cycles, late)
    if late > LATE_SHARE * len(ran) or (late and pacing == "lockstep"):
        first_cycle = _cycle(rig, int(ran[np.flatnonzero(without)[0]]))
        yield f"device: {name}: late in {late:,} of {len(ran):,} cycles, first in {first_cycle}"
    yield from silent[:SHOWN]
    if len(silent) > SHOWN:
        yield f"device: {name}: silent {len(silent) - SHOWN} times more"


def _rate(found: Behaviour, rig: Rig, own: Frames, pacing: str) -> Iterator[str]:
    """Note the rate and jitter of SYNC; yield what is wrong with the rate."""
    if pacing == "lockstep" or len(own) < FEWEST:
        return
    rate_hz = rate_of(own["stamp_ns"])
    found.timing["rate_hz"] = round(rate_hz, 3)
    if pacing == "sync":
        off_us = 1e-3 * np.abs(np.diff(own["stamp_ns"]) - 1e9 / rig.config.rate_hz)
        _note_quantiles(found, "jitter", lambda percent: float(np.percentile(off_us, percent)))
    if abs(rate_hz / rig.config.rate_hz - 1.0) > RATE_ERROR:
        yield f"device: its cycle is {rate_hz:.4g} Hz, the rig's is {rig.config.rate_hz:g} Hz"


def rate_of(stamp_ns: NDArray[np.int64]) -> float:
    """Return the rate, Hz, of frames that came at these times, (n,) ns, n at least 4.

    The median over stretches of a quarter of them: neither a silence nor what is caught up after
    a stall changes it, and it matters little that stamps are those of another clock's cycles.
    """
    frames = min(len(stamp_ns) // 4, LONGEST)
    took_ns = float(np.median(stamp_ns[frames:] - stamp_ns[:-frames]))
    return 1e9 * frames / took_ns if took_ns > 0.0 else float("inf")


def _reaction(found: Behaviour, own: Frames, frames: Frames, pacing: str) -> None:
    """Note the time from the plant's last frame to the device's answer."""
    sent = np.sort(frames["stamp_ns"][frames["direction"] == 0])
    if pacing != "sync" or not len(sent) or len(own) < FEWEST:
        return
    before = np.searchsorted(sent, own["stamp_ns"]) - 1
    took_us = 1e-3 * (own["stamp_ns"] - sent[np.maximum(before, 0)])[before >= 0]
    _note_quantiles(found, "reaction", lambda percent: float(np.percentile(took_us, percent)))


def _restarts(rig: Rig, came: Frames) -> Iterator[str]:
    """Yield where the device began anew: it greets after it was operational, or asks again."""
    beats = (came["id"] & 0x780 == 0x700) & (came["id"] < 0x780)
    state = np.where(beats, came["data"][:, 0], 255)
    running = np.maximum.accumulate(state == Heartbeat.OPERATIONAL) if len(came) else state > 0
    again = came["cycle"][running & np.isin(state, GREETINGS) & beats]
    if len(again):
        yield f"device: restarted, its heartbeat begins again in {_cycle(rig, int(again[0]))}"
