"""Whether this machine holds a rig's rate on a clock, and what is done where it does not.

A cycle of a rig with its frames takes about 20 us on a present PC, half of it in system calls. How
much slower this machine is tells a short sum in Python, in time of the processor and the fastest of
several, so that other programs do not count. An emulated processor (QEMU without KVM) is 50 to 90
times slower and stands still for 10 ms and more, whatever the average.

    pacing of the rig       lockstep instead, in a line
    --pacing real or sync   as asked, with a warning
    exec, plant, local      as the rig says, with a warning: the other node must do the same

After a fault for missing frames the longest stall that was seen is held against the limit. Where
input was stale the latest cycle is named.
"""

import math
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.ring_layout import OfRecord
from pcpc.executive.loop.timing_layout import Stage
from pcpc.executive.rig.reading import Rig

CYCLE_S = 20e-6
SUM_S = 0.6e-3  # of the sum below, on the machine of CYCLE_S
_SUM, _TIMES = 20_000, 7
EMULATED = 12.0  # times slower than that: nothing but an emulated processor
_ALLOWED_S = 0.1  # of a stall at least: on two busy processors without SCHED_FIFO 0.03 were seen
EMULATED_HZ = 25.0  # three of its periods are longer than its stalls
_CPU = Path("/proc/cpuinfo")


def slowness() -> float:
    """Return how many times slower this machine computes than a present PC, 1 at least."""
    best_s = math.inf
    for _ in range(_TIMES):
        begin_s, total = time.thread_time(), 0
        for i in range(_SUM):
            total += i
        best_s = min(best_s, time.thread_time() - begin_s)
    return max(1.0, best_s / SUM_S)


def is_emulated(slower: float, cpu: str) -> bool:
    """Return whether the processor is emulated, by its speed or by what it says of itself."""
    return slower >= EMULATED or "QEMU TCG" in cpu


def highest_rate_hz(slower: float, cpu: str) -> float:
    """Return the rate that a machine holds on a clock."""
    rate_hz = 1.0 / (CYCLE_S * slower)
    return min(rate_hz, EMULATED_HZ) if is_emulated(slower, cpu) else rate_hz


def settle(
    asked: str | None,
    rig: Rig,
    alone: bool,
    slower: float | None = None,
    cpu: str | None = None,
) -> tuple[str | None, str]:
    """Return the pacing that this machine holds, None for the rig's, and what there is to say."""
    pacing, rate_hz = asked or rig.config.pacing, rig.config.rate_hz
    if pacing == "lockstep":
        return asked, ""
    if cpu is None:
        cpu = _CPU.read_text(errors="replace") if _CPU.is_file() else ""
    slower = slowness() if slower is None else slower
    highest_hz = highest_rate_hz(slower, cpu)
    if rate_hz <= highest_hz:
        return asked, ""
    kind = "emulated" if is_emulated(slower, cpu) else f"{slower:.0f} times slower than a PC"
    why = f"this processor is {kind} and holds {_round(highest_hz):g} Hz, not {rate_hz:g}"
    rate = f"--set rate_hz={_round(highest_hz):g}"
    if asked or alone:
        other = " on all nodes" if alone else ""
        return asked, f"{why}: use --pacing lockstep{other}, or {rate}; pacing {pacing} as asked"
    return "lockstep", f"{why}: pacing lockstep; on a clock with {rate} --pacing {pacing}"


def _round(rate_hz: float) -> float:
    """Return a rate of one digit that is not above `rate_hz`, or 25."""
    if rate_hz <= EMULATED_HZ:
        return rate_hz
    unit = 10.0 ** math.floor(math.log10(rate_hz))
    return math.floor(rate_hz / unit) * unit


def silence(blocks: Mapping[str, sh.NodeMemory], rig: Rig) -> str:
    """Return what a fault for missing frames is about in time, and the cure if the machine stood.

    "" where no node has this fault.
    """
    faulted = [b for b in blocks.values() if int(b.control.fault) == Fault.INPUT_MISSING]
    if not faulted:
        return ""
    limit, period_ns = rig.config.supervisor.fault_after_cycles, rig.config.period_ns
    stall_ns = max(map(_longest_pause_ns, blocks.values())) - period_ns
    said = f"{limit} cycles are {1e-6 * limit * period_ns:g} ms"
    if stall_ns < (limit - 1) * period_ns:
        return said
    cure = _cure(stall_ns, blocks, rig)
    return f"{said}, and here a cycle began {1e-6 * stall_ns:.1f} ms late{cure}"


def stall(blocks: Mapping[str, sh.NodeMemory], rig: Rig) -> str:
    """Return how late a cycle woke that cost another node its input, and the cure; "" if none."""
    worst = {name: _latest_ns(block) for name, block in blocks.items()}
    late_ns = max(worst.values(), default=0)
    if late_ns < rig.config.period_ns:
        return ""
    name = max(worst, key=lambda one: worst[one])
    return f"{name}: a cycle woke {1e-6 * late_ns:.1f} ms late{_cure(late_ns, blocks, rig)}"


def _cure(stall_ns: int, blocks: Mapping[str, sh.NodeMemory], rig: Rig) -> str:
    """Return what to do about stalls like this one: others are three times as long."""
    low = not all(block.control.realtime for block in blocks.values())
    without = ", without SCHED_FIFO (see `pcpc doctor`)" * low
    cycles = math.ceil(max(3.0 * stall_ns, 1e9 * _ALLOWED_S) / rig.config.period_ns)
    allowed = (
        f"--set supervisor.hold_cycles={cycles} --set supervisor.fault_after_cycles={2 * cycles}"
    )
    return f"{without}; run it with --pacing lockstep, or allow for stalls: {allowed}"


def _latest_ns(block: sh.NodeMemory) -> int:
    """Return how late the latest cycle of a node woke."""
    return max((int(row.stage_ns[Stage.WAKE_LATE]) for row in np.array(block["latest"])), default=0)


def _longest_pause_ns(block: sh.NodeMemory) -> int:
    """Return the longest time between two of the newest cycles of a node."""
    put, rows = int(block.ends("record").head), block["record"]
    newest = np.arange(max(0, put - len(rows)), put) % len(rows)
    return int(np.diff(rows[newest, OfRecord.STAMP_NS]).max()) if len(newest) > 1 else 0
