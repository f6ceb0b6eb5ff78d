"""What is tried of a bus, in order: one frame, bursts, rising rates, many frames, CAN FD.

rising     the rate doubles from pass to pass, until a frame is not there, not in time, or not
           taken, or this program sends no faster; then between the last two
long       so many frames that a loss of MOST_LOSS would be seen, at the rate of the rig
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from pcpc.drivers.can.wire_layout import Flag
from pcpc.tools.machine.doctor.adapter.ends import End
from pcpc.tools.machine.doctor.adapter.passes import Pass, Tally
from pcpc.tools.machine.doctor.adapter.pattern import Pattern, burst_pattern, plain_pattern
from pcpc.tools.study.binomial import runs_needed
from pcpc.tools.terminal.progress import Progress

CONFIDENCE = 0.95
MOST_LOSS = 1e-4  # a held input every ten seconds of a rig at 1 kHz
FEWEST = runs_needed(MOST_LOSS, CONFIDENCE)  # frames without loss that show less
HELLO_HZ, HELLO_CYCLES = 50.0, 10
BURST = 32  # frames at once, where no rig says
STEP_S, STEP_CYCLES, BISECTIONS = 0.2, 30, 3
FIRST_HZ, MOST_HZ = 50.0, 50_000.0
SHARE_OF_HIGHEST = 0.8  # of the rate that short passes held, for the long one
LONGEST_S = 60.0  # of the long pass
FD_CYCLES = 100


@dataclass
class Exam:
    """All passes; None and empty: there was no sense in one."""

    hello: Tally
    pattern: Pattern
    burst: Tally | None = None
    steps: list[Tally] = field(default_factory=list)
    long: Tally | None = None
    fd: list[Tally] = field(default_factory=list)
    asked: int = 0

    @property
    def highest_hz(self) -> float:
        """The highest rate below the lowest one that failed; 0: none."""
        failed = min((one.rate_hz for one in self.steps if not is_clean(one)), default=math.inf)
        held = (one.rate_hz for one in self.steps if is_clean(one) and one.rate_hz < failed)
        return max(held, default=0.0)

    @property
    def first_failed(self) -> Tally | None:
        """The pass of the lowest rate that failed."""
        failed = (one for one in self.steps if not is_clean(one))
        return min(failed, key=lambda one: one.rate_hz, default=None)

    @property
    def judged(self) -> Tally:
        """The pass that speaks for all: the long one, or the last there was."""
        return self.long or (self.first_failed or self.hello)

    @property
    def tallies(self) -> list[Tally]:
        """All passes."""
        more = [one for one in (self.burst, self.long) if one is not None]
        return [self.hello, *self.steps, *more, *self.fd]


def is_clean(tally: Tally) -> bool:
    """Return whether all frames were there once, whole, in order and in time."""
    faults = tally.wrong + tally.strange + tally.refused + tally.late
    return not faults and tally.offered


def examine(ends: Sequence[End], pattern: Pattern, frames: int, progress: Progress) -> Exam:
    """Try all; BusError: a bus failed. `ends` as `Pass` has them."""
    hello = Pass(ends, plain_pattern(), HELLO_HZ).run(HELLO_CYCLES)
    exam = Exam(hello, pattern, asked=frames)
    alone = ends[0] is ends[1]
    if not all(hello.from_end[:1] if alone else hello.from_end):
        return exam
    exam.burst = Pass(ends, burst_pattern(max(BURST, pattern.burst)), 100.0).run(1)
    _rise(exam, ends, progress)
    hz = long_hz(exam)
    if hz and not _is_hopeless(exam):
        most = max(int(LONGEST_S * hz * pattern.per_cycle), 1)
        cycles = math.ceil(min(frames, most) / pattern.per_cycle)
        of = f"of {min(frames, most):,} frames at {hz:.4g} Hz"
        exam.long = Pass(ends, pattern, hz).run(cycles, lambda n: progress.show(f"{n:,} {of}"))
    if all(end.has_fd for end in ends):
        slow_hz = min(exam.highest_hz or HELLO_HZ, 200.0)
        for length in (12, 64):
            fd = plain_pattern(length, Flag.FD | Flag.BRS)
            exam.fd.append(Pass(ends, fd, slow_hz).run(FD_CYCLES // 2))
    return exam


def _is_hopeless(exam: Exam) -> bool:
    """Return whether frames were wrong even at low rates: a minute more would say no more."""
    failed, least_hz = exam.first_failed, exam.pattern.rate_hz / 4.0 or 4.0 * FIRST_HZ
    return failed is not None and failed.wrong > 0 and exam.highest_hz < least_hz


def _rise(exam: Exam, ends: Sequence[End], progress: Progress) -> None:
    def held(hz: float) -> bool:
        progress.show(f"{hz:.4g} Hz, {hz * exam.pattern.per_cycle:,.0f} frames/s")
        cycles = max(STEP_CYCLES, math.ceil(STEP_S * hz))
        for _ in range(2):
            tally = Pass(ends, exam.pattern, hz).run(cycles)
            if is_clean(tally) or tally.wrong or tally.refused or tally.strange:
                break  # what is only late may be the machine's: once more
        exam.steps.append(tally)
        return is_clean(tally)

    hz = exam.pattern.rate_hz or FIRST_HZ
    while not held(hz) and hz > FIRST_HZ / 2.0:
        hz /= 2.0
    while hz < MOST_HZ and exam.highest_hz == hz and held(2.0 * hz):
        hz *= 2.0
    for _ in range(BISECTIONS):
        failed = exam.first_failed
        if failed is None or not exam.highest_hz:
            return
        held(math.sqrt(exam.highest_hz * failed.rate_hz))


def long_hz(exam: Exam) -> float:
    """Return the rate of the long pass: the rig's where short passes held it; 0: none."""
    highest_hz, pattern = exam.highest_hz, exam.pattern
    if not pattern.rig:
        return 0.5 * highest_hz
    in_time_hz = exam.asked / (0.5 * LONGEST_S * pattern.per_cycle)
    if pattern.rate_hz <= highest_hz:
        return max(pattern.rate_hz, min(in_time_hz, SHARE_OF_HIGHEST * highest_hz))
    return SHARE_OF_HIGHEST * highest_hz
