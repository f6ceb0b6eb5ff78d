"""Nodes' rings filled by hand, as the loop fills them, and their recorder in this process."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import standing

from pcpc.executive.log import reader as logs
from pcpc.executive.log.recorder import Recorder
from pcpc.executive.loop import shared

MONOTONIC_NS, WALL_NS = 5_000_000_123, 1_760_000_000_000_000_789


STATES = ["rx.FB_A.hub_rate", "barrel.controller.kv", "w.0", "w_0", "Ärger.2__x_", "9lives"]


WIDE = [f"x.{i}" for i in range(3000)]  # a ring of about 350 rows


TIMINGS = ["timing.wake_late_us", "timing.work_us"]


PERIOD_NS = 1_000_000
TESTS = [str(Path(__file__).parent), str(Path(__file__).parents[1])]  # for a process of its own


def absent(node: logs.NodeLog) -> int:
    """Return how many cycles between the first and the last are not in the log."""
    return int(node.cycle[-1] - node.cycle[0]) + 1 - len(node.cycle)


def block_of(
    name: str, node: str = "executive", states: Sequence[str] = STATES, **more: Any
) -> shared.NodeMemory:
    """Make a block as a node does, of `states` and two timing columns; `more`: told besides."""
    variables = [
        [n, "rad/s", "state", "blocks", f"meaning of {n} # [1]\nin two lines"] for n in states
    ]
    variables += [[n, "us", "timing", "loop", ""] for n in TIMINGS]
    description: dict[str, Any] = {
        "node": node,
        "rig": "bench",
        "period_ns": PERIOD_NS,
        "variables": variables,
        "ranges": {},
        "state_columns": list(states),
        "timing_columns": TIMINGS,
        "frames": {"256": "CMD_A", "257": "FB_A"},
        "attachments": {"rig.yaml": "rate_hz: 1000\n", "rig-resolved.yaml": f"# {node}\n"},
        "metadata": {
            "seed": "7",
            "clock_monotonic_ns": str(MONOTONIC_NS),
            "clock_wall_ns": str(WALL_NS),
        },
        "state_names": ["INIT", "READY", "RUN"],
        "fault_names": ["none", "STALE_FB_A"],
    }
    return standing.stand(name, description | more)


def put(block: shared.NodeMemory, ring: str, row: Sequence[int]) -> None:
    """Append a row as the loop does: drop and count it when the ring is full."""
    ends, rows = block.ends(ring), block[ring]
    if ends.head - block[f"{ring}_taken"][0] == len(rows):
        ends.dropped += 1
        return
    rows[ends.head % len(rows)] = row
    ends.head += 1


def values_of(cycle: int, count: int) -> np.ndarray:
    """Return values that differ by cycle and column; one is the canonical NaN."""
    values = np.arange(count) * 0.1 + cycle / 3
    values[0] = np.nan if cycle == 5 else values[0]
    return values


def put_cycle(block: shared.NodeMemory, cycle: int, frames: int = 2) -> None:
    """Append one cycle's record and frames."""
    stamp = MONOTONIC_NS + cycle * PERIOD_NS
    states = len(block.description["state_columns"])
    cells = values_of(cycle, states + len(TIMINGS)).view(np.int64).tolist()
    header = shared.CDR_HEADER
    put(block, "record", [cycle, stamp, header, *cells[:states], header, *cells[states:]])
    for i in range(frames):
        word = (256 + i) | 8 << 32 | (i & 1) << 40 | 3 << 48
        put(block, "frame", [header, stamp + i, cycle, word, 0x0807060504030201 + cycle])


def put_event(block: shared.NodeMemory, cycle: int, code: int, argument: int, value: float) -> None:
    """Append one event."""
    bits = int(np.float64(value).view(np.int64))
    put(block, "event", [MONOTONIC_NS + cycle * PERIOD_NS, cycle, code, argument, bits])


def record(path: Path, block: shared.NodeMemory, cycles: range) -> None:
    """Record cycles in one go, drained every 100."""
    log = Recorder(path, [block])
    for cycle in cycles:
        put_cycle(block, cycle)
        if cycle % 100 == 99:
            log.drain()
    log.finish()
