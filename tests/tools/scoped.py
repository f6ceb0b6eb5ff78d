"""A standing node whose variable a.x steps while it is captured, and whose ring may come round."""

from collections.abc import Callable

import numpy as np
import standing

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.faults import FAULT_NAMES
from pcpc.executive.loop.states import STATE_NAMES

FACTS = {"clock_wall_ns": "9000", "clock_monotonic_ns": "0", "pacing": "real", "bus": "none",
         "controller": "none", "rate_hz": "1000"}  # fmt: skip
HEAD = {
    "variables": [["a.x", "rad", "state", "a", ""], ["time.t_s", "s", "time", "loop", ""],
                  ["supervisor.state", "", "supervisor", "loop", ""]],
    "ranges": {}, "state_columns": ["a.x"], "name": "stand", "alarms": {}, "laws": [],
    "record_columns": 5, "faults": {}, "keep_ns": 0, "keep_on": [],
    "timing_columns": [], "period_ns": 1_000_000, "rig": "stand", "node": "executive",
    "metadata": FACTS, "sources": {}, "attachments": {}, "files": [], "blocks": ["a"],
    "frames": {}, "state_names": [*STATE_NAMES], "fault_names": [*FAULT_NAMES],
    "watch": "", "cycles": 0,
}  # fmt: skip
ROWS = 50  # that are put at a time
WORDS = ("scope", "a.*", "--trigger", "a.x > 0.5 rad", "--pre", "3ms", "--post", "4ms", "--quiet")
CAPTURED = [*range(73, 81)]  # the second step and the cycles around it


def stepping(
    name: str, jump: int = 0, first: int = 0
) -> tuple[sh.NodeMemory, Callable[[float], None]]:
    """Stand it up with 50 rows; return its memory, and what puts 50 more instead of a wait.

    With the second 50 the ring goes on by `jump` rows more, so that it may come round. `first`:
    the cycle of row 0.
    """
    block = standing.stand(name, HEAD)
    ring = block["record"]

    def go_on(seconds: float) -> None:
        """Put the rows, a step in their middle."""
        put = int(block.ends("record").head)
        for k in range(put, put + ROWS):
            x = np.float64(k % ROWS > 25).view(np.int64)
            ring[k % len(ring)] = first + k, 1000 * k, sh.CDR_HEADER, x, sh.CDR_HEADER
        block.control.cycle = first + put + ROWS - 1
        block.ends("record").head = put + ROWS + (jump if put == ROWS else 0)

    go_on(0.0)
    return block, go_on
