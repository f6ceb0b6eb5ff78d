"""What SCHED_FIFO and /dev/cpu_dma_latency are worth on this machine: wake-ups with and without.

    python -m pcpc.tools.machine.doctor.worth ROUNDS PERIODS

A loop of 1 ms wakes PERIODS times with both, without the one, without the other, in turn and from
round to round in another order: a slow moment of the machine falls on all. Prints a JSON object for
each block: what it went without, what was refused, how late it woke, ns.
"""

import contextlib
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from pcpc.drivers.machine import realtime
from pcpc.tools.machine.jitter.wake import measure

FIFO, AWAKE = "SCHED_FIFO", "cpu_dma_latency"
BLOCKS = ("", FIFO, AWAKE)  # what each goes without
ROUNDS, PERIODS = 5, 400
_INTERVAL_NS, _PRIORITY = 1_000_000, 80
_PROJECT = Path(__file__).resolve().parents[3]


def blocks() -> Iterator[dict[str, Any]]:
    """Measure in a process of its own; yield block by block. OSError if it fails."""
    words = [sys.executable, "-m", __spec__.name, str(ROUNDS), str(PERIODS)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=_PROJECT) as process:
        assert process.stdout is not None
        try:
            yield from map(json.loads, process.stdout)
        finally:
            process.terminate()


def worth(found: Sequence[dict[str, Any]], name: str) -> str:
    """Return in words what a setting changed, by the blocks with and without it."""
    if any(name in block["refused"] for block in found):
        return "not measured: refused here"
    without, both = ([b["late_ns"] for b in found if b["without"] == one] for one in (name, ""))
    if not without or len(without) != len(both):
        return "not measured: the loop that wakes ended early"
    a, b = ([ns for block in every for ns in block] for every in (without, both))
    figures = [
        f"p{100 * share:g} {_late_us(a, share):.0f} -> {_late_us(b, share):.0f} us"
        for share in (0.5, 0.99)
    ]
    ratios = [
        _late_us(a, 0.99) / max(_late_us(b, 0.99), 1e-3) for a, b in zip(without, both, strict=True)
    ]
    low, high = min(ratios), max(ratios)
    told = f"wake-up {', '.join(figures)}; p99 {median(ratios):.2g} times ({low:.2g} to {high:.2g})"
    return told if low > 1.0 or high < 1.0 else f"{told}: no clear difference now"


def _late_us(late_ns: Sequence[int], share: float) -> float:
    return sorted(late_ns)[math.ceil(share * len(late_ns)) - 1] / 1000.0


@contextlib.contextmanager
def _set_up(without: str) -> Iterator[list[str]]:
    """Set this thread up but for one setting; give the names of what is refused."""
    refused: list[str] = []
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    realtime._shorten_timer_slack()  # a kernel may have forgotten it with SCHED_FIFO
    with contextlib.ExitStack() as undone:
        if without != FIFO and not realtime.prepare_thread(_PRIORITY, None).is_realtime:
            refused.append(FIFO)
        if without != AWAKE:
            try:
                undone.callback(
                    os.close, descriptor := os.open("/dev/cpu_dma_latency", os.O_WRONLY)
                )
                os.write(descriptor, bytes(4))
            except OSError:
                refused.append(AWAKE)
        yield refused


def main(words: Sequence[str]) -> int:
    """Measure, print; return 0."""
    rounds, periods = map(int, words)
    for number in range(rounds * len(BLOCKS)):
        turn, place = divmod(number, len(BLOCKS))
        without = BLOCKS[(turn + place) % len(BLOCKS)]
        with _set_up(without) as refused:
            late_ns = measure(_INTERVAL_NS, periods).tolist()
        print(json.dumps({"without": without, "refused": refused, "late_ns": late_ns}), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
