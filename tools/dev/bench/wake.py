"""How late the executive wakes, beside cyclictest and a bare C loop: `pcpc jitter`, as a suite.

A round is ROUND_S of each loop in turn, at 1 kHz and SCHED_FIFO 80 where that is granted; a ratio
is that of the percentiles of one round. `pcpc jitter --against` shows more of the same measurement.
"""

import sys
import tempfile
from pathlib import Path

from pcpc.drivers.errors import UserError
from pcpc.tools.dev.bench.ratio import Ratio
from pcpc.tools.machine.jitter import cli as jitter
from pcpc.tools.machine.jitter.compiler import BenchError
from pcpc.tools.machine.jitter.figures import PCPC, percentiles
from pcpc.tools.machine.jitter.loops import Setup
from pcpc.tools.terminal.progress import Progress

SUITE = "wake"
YARDSTICKS = ("cyclictest", "c")
PERIOD_NS, PRIORITY = 1_000_000, 80
ROUND_S = 2.0
FIGURES = ("p50", "p99")
BUS = "udp_multicast:239.74.163.2:43159"


def measure(progress: Progress, rounds: int = 5) -> list[Ratio]:
    """Measure `rounds` rounds, 5 at the most; BenchError if not one yardstick is there."""
    setup = Setup(PERIOD_NS, round(1e9 * ROUND_S / PERIOD_NS), PRIORITY, bus=BUS)
    with tempfile.TemporaryDirectory(prefix="pcpc-wake-") as folder:
        try:
            result = jitter.measure(setup, min(rounds, 5), YARDSTICKS, Path(folder), progress)
        except UserError as error:
            raise BenchError(str(error)) from None
    if result.interrupted:
        raise KeyboardInterrupt
    if not any(result.yardsticks.values()):
        raise BenchError("; ".join(result.absent.values()))
    if not all(result.fifo.values()):
        print("wake: without SCHED_FIFO for all loops; see `pcpc doctor`", file=sys.stderr)
    own = [percentiles(late) for late in result.late_us(PCPC)]
    found = []
    for name in result.loops[1:]:
        base = [percentiles(late) for late in result.late_us(name)]
        for figure in FIGURES:
            ours, theirs = ([p[figure] for p in points] for points in (own, base))
            found.append(Ratio.from_rounds(SUITE, f"wake-up {figure}", name, ours, theirs, "us"))
    return found
