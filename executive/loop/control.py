"""The control words of a node: what it tells of its state, and counts; an int64 each, by name.

Each group of names begins on a cache line of its own, since its words have another writer: whoever
wants the end; the loop; the process around it. A further word is a further name here.
"""

from typing import Any

import numpy as np

from pcpc.drivers.compiled.rows import lines_of

OF_THE_LOOP = (
    "state", "cycle", "done", "fault",
    "passes", "late", "skipped", "held", "stale",
    "sent", "received", "lost", "crc_errors", "repeated",
    "saturated", "send_errors", "bus_errno", "foreign", "wake_max_ns",
    "lost_on_purpose", "refused",
    "bus_warnings", "bus_passives", "bus_offs",
    "bus_restarts", "bus_no_acks", "bus_tx_timeouts",
    "odd_place", "odd_cycle", "odd_bits",  # the first value not finite: variable + 1, when
    "stepping",  # the block that is being stepped, + 1
    "wrong_sequence", "bus_errors",
    "culprit",  # of the fault: an id, or why a value was not plausible
    "implausible", "intrusions",
    "missed", "starved", "signs_on_purpose",  # see `executive.loop.on_wire`
)  # fmt: skip
CONTROL = lines_of(
    ("stop",),  # 1: the end is asked for
    OF_THE_LOOP,
    ("pid", "ready", "realtime", "recorded"),
)


def place(name: str) -> int:
    """Return which of the words is that one, for what takes words by number."""
    fields: Any = CONTROL.fields
    return int(fields[name][1]) // 8


def blank() -> np.record:
    """Return control words that are all 0."""
    record: np.record = np.zeros(1, CONTROL)[0]
    return record
