"""What the messages of a log look like to tools that know MCAP but not pcpc."""

import re
from collections.abc import Sequence

from pcpc.executive.loop import shared

FRAME_SCHEMA = """int64 stamp_ns  # monotonic
int64 cycle
uint32 id
uint8 dlc
uint8 direction  # 0 sent, 1 received
uint8 e2e  # end-to-end check: receiver state
uint8 reserved
uint8[8] data
"""
_INTEGER, _NUMBER, _TEXT = {"type": "integer"}, {"type": ["number", "string"]}, {"type": "string"}
_ENTRY = {"cycle": _INTEGER, "stamp_ns": _INTEGER, "name": _TEXT, "value": _NUMBER}
JSON_SCHEMAS = {
    "Event": {"type": "object", "properties": _ENTRY | {"event": _TEXT, "argument": _INTEGER}},
    "Tuning": {"type": "object", "properties": _ENTRY},
}

VALUE_EVENTS = {  # kinds of events about a variable and its value, by code
    shared.CHANGE_EVENT: "change",
    shared.NOT_FINITE_EVENT: "not finite",
    shared.IMPLAUSIBLE_EVENT: "implausible",
}
OF_A_FRAME = {  # kinds of events about an id, by code
    shared.FOREIGN_EVENT: "foreign",
    shared.TWO_SENDERS_EVENT: "two senders",
    shared.AHEAD_EVENT: "counter ahead",
    shared.TWO_PLACES_EVENT: "heartbeat from two places",
}
EVENTS = {  # kinds of events without a variable, by code
    shared.FAULT_EVENT: "fault",
    shared.STATE_EVENT: "state",
    shared.SKIP_EVENT: "skip",
    shared.LATE_EVENT: "late",
    shared.FALLBACK_EVENT: "fallback",
    shared.REFUSED_EVENT: "refused",
    **OF_A_FRAME,
}


def field_names(names: Sequence[str]) -> list[str]:
    """Return a unique ROS 2 field name for each dotted name: rx.FB_A.rate -> rx_fb_a_rate."""
    fields: dict[str, None] = {}
    for name in names:
        plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
        plain = plain if plain[:1].isalpha() else f"v_{plain}".rstrip("_")
        unique, number = plain, 2
        while unique in fields:
            unique, number = f"{plain}_{number}", number + 1
        fields[unique] = None
    return list(fields)
