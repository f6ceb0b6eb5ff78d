"""The yardsticks of `pcpc jitter`: loops that only wake, each in a process of its own.

    cyclictest   of rt-tests; -v -N gives each latency in ns, its loop is the usual one
    c            wake.c, compiled with cc
    python       tools/machine/jitter/wake.py, CPython without numba

All wait for absolute deadlines of CLOCK_MONOTONIC, under SCHED_FIFO where that is allowed.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import Exit, UserError
from pcpc.tools.machine.jitter.compiler import CompilerError, compile_to
from pcpc.tools.start.children import end_with
from pcpc.tools.terminal.progress import Progress

SOURCE = Path(__file__).with_name("wake.c")
NAMES = ("cyclictest", "c", "python")

_POLL_S = 0.1
_END_S = 5.0


class JitterError(UserError):
    """A loop cannot be measured; "" if it was said already."""


@dataclass(frozen=True)
class Setup:
    """What all loops have in common: `periods` of a round, `cpus` in turn for the threads."""

    interval_ns: int
    periods: int
    priority: int
    cpus: tuple[int, ...] = ()
    bus: str | None = None

    @property
    def round_s(self) -> float:
        """Length of a round."""
        return 1e-9 * self.interval_ns * self.periods

    def cpu(self, thread: int) -> int | None:
        """Return the processor of a thread, None for any."""
        return self.cpus[thread % len(self.cpus)] if self.cpus else None


@dataclass(frozen=True)
class TimedLoop:
    """One round of a loop: how late each cycle woke, (n,) ns."""

    late_ns: NDArray[np.int64]
    fifo: bool
    interrupted: bool = False


def prepare(names: Sequence[str], setup: Setup, folder: Path) -> dict[str, JitterError]:
    """Try cyclictest for a cycle, compile wake.c into `folder`; return what is missing, by loop."""
    missing = {}
    for name, check in (("cyclictest", lambda: _try(setup)), ("c", lambda: _compile(folder))):
        try:
            if name in names:
                check()
        except JitterError as error:
            missing[name] = error
    return missing


def _try(setup: Setup) -> None:
    """Raise JitterError if there is no cyclictest, or if it refuses to run: without SCHED_FIFO."""
    if shutil.which("cyclictest") is None:
        text = "no cyclictest; run: sudo apt-get install rt-tests"
        raise JitterError(text, Exit.ENVIRONMENT)
    done = subprocess.run(_cyclictest_words(setup, 1), capture_output=True, text=True)
    if done.returncode:
        why = "".join(done.stderr.strip().splitlines()[-1:]) or f"exit code {done.returncode}"
        text = f"cyclictest refuses to run: {why.removesuffix('.')}; see `pcpc doctor`"
        raise JitterError(text, Exit.ENVIRONMENT)


def _compile(folder: Path) -> None:
    try:
        compile_to(folder / "wake", [SOURCE], ["-O2"])
    except CompilerError as error:
        raise JitterError(str(error), Exit.ENVIRONMENT) from None


def run(name: str, setup: Setup, folder: Path, progress: Progress, label: str) -> TimedLoop:
    """Run one round of a loop that `prepare` found; JitterError if it fails."""

    def show(spent_s: float) -> None:
        progress.show(f"{label} {spent_s:.0f} s")

    if name == "cyclictest":
        return _cyclictest(setup, folder, show)
    python = [sys.executable, "-P", str(SOURCE.with_suffix(".py"))]
    return _wake(python if name == "python" else [str(folder / "wake")], setup, folder, show)


def _wake(
    words: Sequence[str], setup: Setup, folder: Path, show: Callable[[float], None]
) -> TimedLoop:
    """Run `words`, wake.c or its twin, and read the file that it writes."""
    out, cpu = folder / "late", setup.cpu(0)
    out.unlink(missing_ok=True)
    numbers = (setup.interval_ns, setup.periods, setup.priority, -1 if cpu is None else cpu)
    done = _outcome([*words, *(str(n) for n in numbers), str(out)], folder, show)
    if done.code or not out.exists():
        if not done.interrupted:
            raise JitterError(f"{words[-1]}: {done.why}", Exit.ENVIRONMENT)
        return TimedLoop(np.empty(0, np.int64), False, True)
    return TimedLoop(
        np.fromfile(out, "<i8"), done.output.read_text().strip() == "1", done.interrupted
    )


def _cyclictest_words(setup: Setup, loops: int) -> list[str]:
    words = f"-i {setup.interval_ns // 1000} -l {loops} -p {setup.priority}"
    cpu = "" if setup.cpu(0) is None else f" -a {setup.cpu(0)}"
    return f"cyclictest -v -N -m {words}{cpu}".split()


def _cyclictest(setup: Setup, folder: Path, show: Callable[[float], None]) -> TimedLoop:
    done = _outcome(_cyclictest_words(setup, setup.periods), folder, show)
    late_ns = cyclictest_values(done.output.read_text())
    if not len(late_ns) and not done.interrupted:
        raise JitterError(f"cyclictest: {done.why}", Exit.ENVIRONMENT)
    return TimedLoop(late_ns, True, done.interrupted)


def cyclictest_values(text: str) -> NDArray[np.int64]:
    """Return the latencies of `cyclictest -v`: lines `thread: cycle: latency`. Shape (n,)."""
    rows = (line.split(":") for line in text.splitlines())
    values = [int(row[2]) for row in rows if len(row) == 3 and row[0].strip().isdigit()]
    return np.array(values, np.int64)


@dataclass(frozen=True)
class _Outcome:
    code: int
    output: Path
    why: str  # it failed
    interrupted: bool


def _outcome(words: Sequence[str], folder: Path, show: Callable[[float], None]) -> _Outcome:
    """Run a command to its end, or to Ctrl-C, which is passed on; it dies with this process."""
    output, complaint = folder / "output", folder / "complaint"
    begin_s, interrupted = time.monotonic(), False
    with output.open("wb") as out, complaint.open("wb") as err:
        process = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            start_new_session=True,
            preexec_fn=partial(end_with, os.getpid(), signal.SIGTERM),
        )
        try:
            while process.poll() is None:
                show(time.monotonic() - begin_s)
                _wait(process, _POLL_S)
        except KeyboardInterrupt:
            interrupted = True
            process.send_signal(signal.SIGINT)
            _wait(process, _END_S)
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
    last = complaint.read_text(errors="replace").strip().splitlines()[-1:]
    why = "".join(last) or f"exit code {process.returncode}"
    return _Outcome(process.returncode, output, why, interrupted)


def _wait(process: "subprocess.Popen[bytes]", seconds: float) -> None:
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        return
