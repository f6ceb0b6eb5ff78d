"""What the messages of a log look like to tools that know MCAP but not pcpc."""

import re
from collections.abc import Sequence

from pcpc.executive.loop.events import FRAME, VARIABLE, Event

FRAME_SCHEMA = """int64 stamp_ns  # monotonic
int64 cycle
uint32 id
uint8 dlc
uint8 direction  # 0 sent, 1 received
uint8 e2e  # end-to-end check: receiver state
uint8 reserved
uint8[8] data
"""
FD_FRAME_SCHEMA = FRAME_SCHEMA.replace(
    "reserved", "flags  # 1 bit rate switch, 2 error state indicator, 4 CAN FD"
).replace("[8]", "[64]")
_INTEGER, _NUMBER, _TEXT = {"type": "integer"}, {"type": ["number", "string"]}, {"type": "string"}
_ENTRY = {"cycle": _INTEGER, "stamp_ns": _INTEGER, "name": _TEXT, "value": _NUMBER}
JSON_SCHEMAS = {
    "Event": {"type": "object", "properties": _ENTRY | {"event": _TEXT, "argument": _INTEGER}},
    "Tuning": {"type": "object", "properties": _ENTRY},
    "Keyframe": {
        "type": "object",
        "properties": {
            "cycle": _INTEGER, "stamp_ns": _INTEGER, "passes": _INTEGER,
            "layout": _TEXT, "crc": _INTEGER, "state": _TEXT,
        },
    },
}  # fmt: skip
ENTRY_KINDS = {f"{name.lower()}s": name.lower() for name in JSON_SCHEMAS}  # topics, and one of each

# kinds of events by code: about a variable and its value; about an id; all without a variable
VALUE_EVENTS = {int(kind): kind.says for kind in Event if kind.about == VARIABLE}
OF_A_FRAME = {int(kind): kind.says for kind in Event if kind.about == FRAME}
EVENTS = {int(kind): kind.says for kind in Event if kind.about != VARIABLE and kind != Event.TUNING}


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
