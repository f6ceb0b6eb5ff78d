"""The control words of a node: what it tells of its state, and counts; an int64 each, by name.

Each group of names begins on a cache line of its own, since its words have another writer: whoever
wants the end; the loop; the process around it. A further word is a further name here; a counter is
a row of COUNTERS as well, and so a variable.
"""

import numpy as np

from pcpc.drivers.compiled.records import Element, carried, line


class Control(Element):
    """The words."""

    stop: int = line()  # 1: the end is asked for
    state: int = carried(line=True)
    cycle: int = carried()
    done: int = carried()
    fault: int = carried()
    passes: int = carried()
    late: int = carried()
    skipped: int = carried()
    held: int = carried()
    stale: int = carried()
    sent: int = carried()
    received: int = carried()
    lost: int = carried()
    crc_errors: int = carried()
    repeated: int = carried()
    saturated: int = carried()
    send_errors: int = carried()
    bus_errno: int = carried()
    foreign: int = carried()
    wake_max_ns: int = carried()
    lost_on_purpose: int = carried()
    refused: int = carried()
    bus_warnings: int = carried()
    bus_passives: int = carried()
    bus_offs: int = carried()
    bus_restarts: int = carried()
    bus_no_acks: int = carried()
    bus_tx_timeouts: int = carried()
    odd_place: int = carried()  # the first value not finite: variable + 1
    odd_cycle: int = carried()  # and when
    odd_bits: int = carried()  # a float64
    stepping: int = carried()  # the block that is being stepped, + 1
    wrong_sequence: int = carried()
    bus_errors: int = carried()
    culprit: int = carried()  # of the fault: an id, or why a value was not plausible
    implausible: int = carried()
    intrusions: int = carried()
    missed: int = carried()  # see `executive.loop.on_wire`, and the next two
    starved: int = carried()
    signs_on_purpose: int = carried()
    pid: int = line()
    ready: int
    realtime: int
    recorded: int


COUNTERS = (  # counted since the start: control word, variable, meaning
    ("passes", "health.passes", "cycles done before this one"),
    ("late", "health.late_cycles", "cycles that started later than the rig's fraction of a period"),
    ("skipped", "health.skipped_cycles", "periods skipped because a cycle ran past its end"),
    ("held", "health.held_cycles", "cycles that ran on a held input"),
    ("stale", "health.stale_cycles", "cycles whose input was held longer than the rig allows"),
    ("sent", "health.frames_sent", "frames sent"),
    ("received", "health.frames_received", "frames received and used"),
    ("lost", "health.frames_lost", "frames missing by their counters"),
    ("crc_errors", "health.crc_errors", "frames with a wrong CRC or length"),
    ("repeated", "health.frames_repeated", "frames received twice"),
    ("saturated", "health.saturated_values", "values clamped on sending"),
    (
        "lost_on_purpose",
        "health.frames_lost_on_purpose",
        "frames that the rig's losses took from this receiver",
    ),
    ("wrong_sequence", "health.wrong_sequence", "frames whose counter jumped too far"),
    ("foreign", "health.frames_foreign", "frames of this node's from another sender"),
    ("send_errors", "health.send_errors", "frames that the bus did not take"),
    ("bus_errors", "health.bus_errors", "errors that the CAN controller told"),
    ("intrusions", "health.intrusions", "signs of a second sender of a received frame"),
    ("missed", "health.frames_missed", "frames lost, those aside that were taken on purpose"),
    (
        "starved",
        "health.starved_cycles",
        "stale cycles, those aside whose input was taken on purpose",
    ),
    (
        "signs_on_purpose",
        "health.signs_on_purpose",
        "signs of a second sender that a fault on purpose gave",
    ),
)
FROM_FRAMES = (  # those that follow from frames alone, not from clocks
    "held", "stale", "received", "lost", "crc_errors", "repeated", "saturated", "lost_on_purpose",
    "wrong_sequence", "foreign", "missed", "starved",
)  # fmt: skip
BUS_COUNTERS = (  # by `executive.loop.bus_state`: control word, variable, meaning
    (
        "bus_warnings",
        "health.bus_warnings",
        "times an error counter of the CAN controller reached 96",
    ),
    ("bus_passives", "health.bus_passives", "times the CAN controller became error passive"),
    ("bus_offs", "health.bus_offs", "times the CAN controller went bus-off"),
    ("bus_restarts", "health.bus_restarts", "times it came back"),
    (
        "bus_no_acks",
        "health.bus_no_acks",
        "frames that nobody acknowledged, as the controller told",
    ),
    (
        "bus_tx_timeouts",
        "health.bus_tx_timeouts",
        "transmissions that timed out, as the controller told",
    ),
)


def place(name: str) -> int:
    """Return which of the words is that one, for what takes words by number."""
    return Control.offset_of(name) // 8


def blank() -> np.record:
    """Return control words that are all 0."""
    record: np.record = np.zeros(1, Control.dtype)[0]
    return record
