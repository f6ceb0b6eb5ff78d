"""The loops that `pcpc jitter` runs beside ours: C, Python, cyclictest; and how they are ended."""

import contextlib
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from copies import program
from logcommand import Done, run_here
from places import PATIENCE_S
from processes import ROOT, blocks_left, own_bus, until

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.tools.machine.jitter import cli as jitter
from pcpc.tools.machine.jitter import figures as jitter_figures
from pcpc.tools.machine.jitter import loops as jitter_loops
from pcpc.tools.machine.jitter.figures import PCPC
from pcpc.tools.machine.jitter.loops import JitterError, Setup
from pcpc.tools.terminal.progress import Progress

QUIET = Progress(quiet=True)
WIDE = 3.0  # of a ratio of p50 on a shared machine


def run(*words: str | Path) -> Done:
    """Run the command in this process, without progress."""
    return run_here("jitter", "-q", *words)


@pytest.fixture
def compiler(request: pytest.FixtureRequest) -> None:
    if shutil.which("cc") is None:
        request.applymarker(pytest.mark.xfail(reason="no C compiler", raises=JitterError))


def test_the_loop_wakes_as_early_as_c(compiler: None, tmp_path: Path) -> None:
    found = []
    for attempt in ("first", "retry"):
        folder = tmp_path / attempt
        folder.mkdir()
        both = jitter.measure(Setup(1_000_000, 400, 80, bus=own_bus()), 3, ["c"], folder, QUIET)
        found.append(jitter_figures.ratios(both.late_us(PCPC), both.late_us("c"))["p50"])
        if found[-1].median < WIDE:
            return
    raise AssertionError(f"p50 over that of C, twice: {found}")


# The yardsticks


@pytest.mark.parametrize("name", ["c", "python"])
def test_a_plain_loop_wakes_after_each_deadline(name: str, tmp_path: Path, compiler: None) -> None:
    setup = Setup(500_000, 400, 80)
    for error in jitter_loops.prepare([name], setup, tmp_path).values():
        raise error
    loop = jitter_loops.run(name, setup, tmp_path, QUIET, "")
    late = loop.late_ns
    stalled = int((late // setup.interval_ns).sum())
    assert (late >= 0).all() and not loop.interrupted, late.min()
    assert setup.periods - stalled - 1 <= len(late) <= setup.periods, f"{len(late)}, {stalled}"


@pytest.fixture
def sigint() -> Iterator[None]:
    """Let processes that are started here have Ctrl-C; pytest's workers ignore it for them."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


class _CtrlC(Progress):
    """A progress line that is interrupted when it is shown for the fifth time."""

    shown = 0

    def show(self, text: str) -> None:
        self.shown += 1
        if self.shown == 5:
            raise KeyboardInterrupt


@pytest.mark.parametrize("name", ["c", "python"])
def test_an_interrupted_loop_hands_over_what_it_has(
    name: str, tmp_path: Path, compiler: None, sigint: None
) -> None:
    setup = Setup(1_000_000, 100_000, 80)
    for error in jitter_loops.prepare([name], setup, tmp_path).values():
        raise error
    loop = jitter_loops.run(name, setup, tmp_path, _CtrlC(), "")
    assert loop.interrupted and 0 < len(loop.late_ns) < 100_000, len(loop.late_ns)


def test_cyclictests_values_are_read_exactly() -> None:
    text = (
        "Max CPUs = 2\nOnline CPUs = 2\n# /dev/cpu_dma_latency set to 0us\n"
        "Thread 0 Interval: 1500\n       0:       0:   12239\n       0:       1:   18318\n"
    )
    assert jitter_loops.cyclictest_values(text).tolist() == [12239, 18318]


@pytest.mark.parametrize(
    ("name", "cure"), [("cyclictest", "apt-get install rt-tests"), ("c", "apt-get install gcc")]
)
def test_a_yardstick_that_is_not_installed_names_its_cure(
    name: str, cure: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    done = run("--against", name)
    assert (done.code, done.out) == (4, "") and cure in done.err, done
    assert done.err.count("\n") == 1, done.err


# Ctrl-C


def test_ctrl_c_ends_with_the_statistics_so_far(sigint: None) -> None:
    bus = own_bus()
    words = [program(), "jitter", "-D", "100s", "--bus", bus]
    with subprocess.Popen(
        words,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        block = until(lambda: _block(bus) or process.poll(), "the executive's block")
        until(lambda: block.control.passes > 50 or process.poll(), "fifty cycles")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    found = re.search(r"^T: ?0 .* C: *(\d+) ", out, re.MULTILINE)
    assert process.returncode == 130 and "Traceback" not in err, f"{out}\n{err}"
    assert found and 50 <= int(found[1]) < 100_000, out
    assert blocks_left(bus) == []


def _block(bus: str) -> sh.NodeMemory | None:
    with contextlib.suppress(sh.SharedError):
        return sharing.attach(sh.block_name("probe", bus, "executive"))
    return None


# The rig
