"""`pcpc jitter`: how late the executive's own loop wakes, side by side with other loops.

What is measured is the product: plants/probe with emulator, executive, bus and recorder, run as
`pcpc run` does; every cycle's figures come from the log. Options and first line are cyclictest's.
With --against, rounds of equal length, interval and priority follow each other, ABCABC: a slow
moment of the machine falls on all, so ratios mean more than times.
After Ctrl-C it tells what there is.
"""

import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.executive.durations import duration_ns
from pcpc.executive.errors import code_of, did_you_mean
from pcpc.tools.machine.jitter import loops, probe, report
from pcpc.tools.machine.jitter.commands import JitterRequest
from pcpc.tools.machine.jitter.figures import LEAST_CYCLES, JitterResult, figures
from pcpc.tools.machine.jitter.limits import read_limits
from pcpc.tools.machine.jitter.loops import JitterError, Setup
from pcpc.tools.machine.jitter.nines import HELD
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.outfile import whole_file
from pcpc.tools.terminal.picture import check_picture
from pcpc.tools.terminal.progress import Progress

ROUNDS = 5  # with --against
LEAST_INTERVAL_US, MOST_INTERVAL_US = 50, 1_000_000
MOST_HISTOGRAM_US = 1_000_000  # cyclictest's


def command(request: JitterRequest) -> int:
    """Measure."""
    progress = Progress(request.quiet)
    setup, rounds, names = parse(request)
    limits = {} if request.limits is None else read_limits(request.limits)
    with tempfile.TemporaryDirectory(prefix="pcpc-jitter-") as folder:
        result = measure(setup, rounds, names, Path(folder), progress)
    progress.close()
    result.limits, result.limits_of = limits, str(request.limits)
    return conclude(result, request)


def parse(request: JitterRequest) -> tuple[Setup, int, list[str]]:
    """Return what to measure, in how many rounds, against what; JitterError."""
    interval_ns = _ns(request.interval, "-i", "us")
    interval_us = interval_ns / 1000
    if not LEAST_INTERVAL_US <= interval_us <= MOST_INTERVAL_US or interval_us % 1:
        raise JitterError(f"-i {request.interval}: expected whole us from 50us to 1s")
    names = [] if request.against is None else list(dict.fromkeys(request.against.split(",")))
    if unknown := [name for name in names if name not in loops.NAMES]:
        cure = did_you_mean(unknown[0], loops.NAMES)
        raise JitterError(f"--against {unknown[0]}: no such loop{cure}")
    rounds = request.rounds or (ROUNDS if names else 1)
    if request.rounds is not None and request.rounds < 1:
        raise JitterError(f"--rounds {request.rounds}: expected 1 or more")
    periods = round(_ns(request.duration, "-D", "s") / rounds / interval_ns)
    if periods < LEAST_CYCLES:
        raise JitterError(
            f"-D {request.duration}: {periods} cycles a round of {rounds}; expected "
            f"{LEAST_CYCLES} or more, -D {float(LEAST_CYCLES * rounds * interval_us / 1000):g}ms"
        )
    if not 1 <= request.priority <= 99:
        raise JitterError(f"-p {request.priority}: expected a priority of 1 to 99")
    wrong = request.histogram is not None and not 1 <= request.histogram <= MOST_HISTOGRAM_US
    if wrong:
        raise JitterError(f"-h {request.histogram}: expected 1 to {MOST_HISTOGRAM_US} us")
    check_picture("--plot", request.plot)
    cpus = _cpus(request.affinity)
    return Setup(int(interval_ns), periods, request.priority, cpus, request.bus), rounds, names


def _ns(text: str, option: str, unit: str) -> Fraction:
    try:
        return duration_ns(text, unit)
    except ValueError as error:
        raise JitterError(f"{option} {error}") from None


def _cpus(text: str | None) -> tuple[int, ...]:
    """Return the processors of -a; JitterError for one that this process may not use."""
    usable = sorted(os.sched_getaffinity(0))
    words = [] if text is None else text.split(",")
    for word in words:
        if not word.isdecimal() or int(word) not in usable:
            known = ", ".join(map(str, usable))
            raise JitterError(f"-a {word}: no such processor here; expected some of {known}")
    return tuple(map(int, words))


def measure(
    setup: Setup, rounds: int, names: Sequence[str], folder: Path, progress: Progress
) -> JitterResult:
    """Run all rounds; after Ctrl-C what there is. `folder` is empty and holds the logs meanwhile.

    Raises JitterError, RigError, BusError, SharedError. What a loop of `names` lacks is an error
    only if it is the only one, else a line in `absent`.
    """
    missing = loops.prepare(names, setup, folder)
    if missing and len(names) == 1:
        raise missing[names[0]]
    for error in missing.values():
        progress.close()
        print(error, file=sys.stderr)
    result = JitterResult(setup, rounds, absent={name: str(e) for name, e in missing.items()})
    result.yardsticks = {name: [] for name in names if name not in missing}
    try:
        for number in range(rounds):
            if not _round(result, number, folder, progress):
                break
    except KeyboardInterrupt:  # between two loops
        result.interrupted = True
    return result


def _round(result: JitterResult, number: int, folder: Path, progress: Progress) -> bool:
    """Run every loop once, ours first; return False after Ctrl-C."""
    at = f"round {number + 1} of {result.rounds},"
    with tempfile.TemporaryDirectory(dir=folder) as run_folder:
        found = probe.run(result.setup, Path(run_folder), progress, f"{at} pcpc:")
    for number in (signal.SIGINT, signal.SIGTERM):  # the host had them
        signal.signal(number, signal.default_int_handler)
    result.probes.append(found)
    result.interrupted = found.interrupted
    for name, rounds in result.yardsticks.items():
        if result.interrupted:
            break
        loop = loops.run(name, result.setup, folder, progress, f"{at} {name}:")
        rounds.append(loop)
        result.interrupted = loop.interrupted
    return not result.interrupted


def conclude(result: JitterResult, request: JitterRequest) -> int:
    """Print, write and draw the result; return the exit code.

    JitterError: a file cannot be written.
    """
    if result.node("executive") is None:
        return Exit.INTERRUPTED
    print(report.text_of(result, request.histogram))
    path = request.json
    try:
        if request.json is not None:
            with whole_file(request.json) as unfinished:
                unfinished.write_text(screen.json_text(figures(result), 1) + "\n")
        path = request.plot
        if request.plot is not None:
            with whole_file(request.plot) as unfinished:
                report.draw(result, unfinished)
    except OSError as error:
        what = f"{path}: cannot be written: {error.strerror}; choose another file"
        raise JitterError(what, code_of(error)) from None
    if result.interrupted:
        return Exit.INTERRUPTED
    held = all(verdict == HELD for *_, verdict in result.verdicts)
    return Exit.OK if held else Exit.NOT_MET
