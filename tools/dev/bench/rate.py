"""The highest closed-loop rate that two processes hold on udp_multicast, against two loops in C.

A rate is held when, in a run of RUN_S from SETTLE_S after the first cycle on, the executive

    - spends no more than a period on wake-up lateness and work in p99.9 of its cycles,
    - skips no period; and neither node loses a frame or faults.

Python is `executive.nodes.process`, as `pcpc run` starts it. C is the same
two processes with the same set-up (SCHED_FIFO, locked memory), memory and frames, whose loop is
`run` of cycle.c: `python -m pcpc.tools.dev.bench.rate ROLE RIG`. This process empties the rings,
which only reads what it needs. Rates that do not divide the plant's 16 kHz integrate at 20 kHz. The
highest held rate is searched upwards, each rate with both in turn, until neither holds; a rate
missed once is tried again.
"""

import signal
import sys

if __name__ == "__main__":  # a node: before numpy is imported, as in executive.process
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})

import ctypes
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcpc.drivers.can import bus as buses
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.loop.faults import FAULT_NAMES, Fault
from pcpc.executive.nodes import process
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.dev.bench.compiler import address
from pcpc.tools.dev.bench.cycle import RIG, in_c, library
from pcpc.tools.dev.bench.ratio import Ratio
from pcpc.tools.machine.jitter.compiler import BenchError
from pcpc.tools.start.children import Child
from pcpc.tools.terminal.progress import Progress

SUITE = "rate"
BUS = "udp_multicast:239.74.163.64:43164"  # of its own
RATES_HZ = (500, 1000, 2000, 4000, 5000, 8000, 10000)
RUN_S, SHORT_S = 10.0, 3.0
FEW_ROUNDS = 5  # below this the runs are short
SETTLE_S = 0.3
TRIES = 2
START_S = 60.0  # compilation included
STAGES = ("receive", "step", "send")
MODULES = {"Python": process.MODULE, "C": "pcpc.tools.dev.bench.rate"}


@dataclass(frozen=True)
class RateResult:
    """What one run at a rate showed; p99.9 of lateness and work in us; `fault` 0 or its number."""

    rate_hz: int
    p999_us: float
    lost: int
    skipped: int
    fault: int

    @property
    def ok(self) -> bool:
        """True if the rate was held."""
        in_time = self.p999_us <= 1e6 / self.rate_hz
        return in_time and not (self.lost or self.skipped or self.fault)

    def __str__(self) -> str:
        if self.fault:
            return f"ended early: {FAULT_NAMES[self.fault]}"
        return f"p99.9 {self.p999_us:.0f} us, {self.lost} lost, {self.skipped} skipped"


def measure(
    progress: Progress,
    rounds: int = 15,
    rates: Sequence[int] = RATES_HZ,
    seconds: float | None = None,
) -> list[Ratio]:
    """Return the highest held rates, Hz, 0 for none; CompilerError, BenchError."""
    library()
    if seconds is None:
        seconds = SHORT_S if rounds < FEW_ROUNDS else RUN_S
    best = dict.fromkeys(MODULES, 0)
    open_sides = list(MODULES)
    for rate in rates:
        for side in list(open_sides):
            for _ in range(TRIES):
                progress.show(f"rate {rate} Hz, {side}, {seconds:g} s")
                held = run(side, rate, seconds)
                progress.say(f"rate {rate} Hz, {side}: {held}{'' if held.ok else '; not held'}")
                if held.ok:
                    best[side] = rate
                    break
            else:
                open_sides.remove(side)
    if not all(best.values()):
        none = " and ".join(side for side, rate in best.items() if not rate)
        raise BenchError(f"{none} did not even hold {rates[0]} Hz: something else is running here")
    own, base = float(best["Python"]), float(best["C"])
    return [Ratio.from_rounds(SUITE, "highest rate", "C -O2, two processes", [own], [base], "Hz")]


def run(side: str, rate_hz: int, seconds: float) -> RateResult:
    """Run both nodes at a rate and return what came of it; BenchError if they did not start."""
    settings = [f"rate_hz={rate_hz}", f"duration_s={seconds + SETTLE_S}", "bus.bitrate=null"]
    if 16000 % rate_hz:
        settings.append("barrel.integrator_hz=20000")
    words = [RIG, "--bus", BUS, "--pacing", "real"]
    words += [word for setting in settings for word in ("--set", setting)]
    rig = load_rig(RIG, settings=settings, resolve=False)
    bus = str(buses.bus_named(*buses.parse(BUS)))
    children = {}
    for role in ("plant", "executive"):
        children[role] = Child.started(role, MODULES[side], [role, *words])
    blocks: dict[str, sh.NodeMemory] = {}
    names = {role: sh.block_name(rig.config.rig, bus, role) for role in children}
    try:
        rows = _watch(children, blocks, names)
    finally:
        for block in blocks.values():
            block.tell(sharing.LEAVE)
        for child in children.values():
            child.end(1.0)
    if len(blocks) < 2 or not rows:
        said = [line for child in children.values() for line in child.complaint()]
        raise BenchError(f"{side} at {rate_hz} Hz did not start: {said[-1] if said else 'no word'}")
    return _judge(blocks, np.concatenate(rows), rate_hz)


def _watch(
    children: dict[str, Child], blocks: dict[str, sh.NodeMemory], names: dict[str, str]
) -> list[Any]:
    """Empty the rings until a node ends; return the executive's records."""
    rows: list[Any] = []
    until = time.monotonic() + START_S
    while not any(map(_is_over, children.values(), map(blocks.get, children))):
        for role, child in children.items():
            if role not in blocks:
                _attach(role, child, blocks, names)
            else:
                _take(blocks[role], rows if role == "executive" else None)
        if not rows and time.monotonic() > until:
            break
        time.sleep(0.01)
    if "executive" in blocks:
        _take(blocks["executive"], rows)
    return rows


def _is_over(child: Child, block: sh.NodeMemory | None) -> bool:
    return child.ended or (block is not None and bool(block.control.done))


def _attach(
    role: str, child: Child, blocks: dict[str, sh.NodeMemory], names: dict[str, str]
) -> None:
    try:
        block = sharing.attach(names[role], sharing.HOST)
    except sh.SharedError:
        return
    if int(block.control.pid) == child.process.pid:
        blocks[role] = block


def _take(block: sh.NodeMemory, rows: list[Any] | None) -> None:
    ring = block["record_values"]
    put, taken = int(block.ends("record").head), int(block["record_taken"][0])
    if rows is not None and put > taken:
        rows.append(ring[np.arange(taken, put) % len(ring)])
    block["record_taken"][0] = put
    for name in ("frame", "event"):
        block[f"{name}_taken"][0] = block.ends(name).head


def _judge(blocks: dict[str, sh.NodeMemory], records: Any, rate_hz: int) -> RateResult:
    names = blocks["executive"].description["timing_columns"]
    columns = dict(zip(names, records[:, records.shape[1] - len(names) :].T, strict=True))
    settled = round(SETTLE_S * rate_hz)
    busy = columns["timing.wake_late_us"] + sum(columns[f"timing.{s}_us"] for s in STAGES)
    busy[:-1] += columns["timing.publish_us"][1:]  # each row holds that of the cycle before
    skipped = columns["health.skipped_cycles"]
    lost = sum(int(block.control.lost) for block in blocks.values())
    fault = int(blocks["executive"].control.fault)
    if len(busy) <= settled:  # it ended before that
        return RateResult(
            rate_hz, float(busy.max()), lost, int(skipped[-1]), fault or Fault.PEER_SILENT
        )
    p999 = float(np.percentile(busy[settled:], 99.9))
    return RateResult(rate_hz, p999, lost, int(skipped[-1] - skipped[settled]), fault)


def run_in_c(n: Any, steps: Sequence[Any]) -> int:
    """Be `executive.loop.cycle.run` in C, without the GIL."""
    c = library()
    c.run.restype = ctypes.c_int64
    return int(c.run(address(n[0]), in_c(steps, c)))


def main(argv: Sequence[str]) -> int:
    """Be one node, `executive.nodes.process` with the loop in C."""
    vars(process)["run"] = run_in_c
    return process.main(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
