"""What a log says of an event in a node's ring, by its code."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log.description import NodeDescription
from pcpc.executive.log.schemas import EVENTS, OF_A_FRAME, VALUE_EVENTS
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.ring_layout import OfEvent


def entry_of(row: NDArray[np.int64], description: NodeDescription) -> tuple[str, dict[str, Any]]:
    """Return the topic of an event in a node's ring, and what the log says of it.

    `row`: (columns,).
    """
    code, argument = int(row[OfEvent.CODE]), int(row[OfEvent.ARGUMENT])
    number = float(row[OfEvent.BITS :].view(np.float64)[0])
    value = number if math.isfinite(number) else repr(number)  # JSON has no nan, inf
    variables = description["variables"]
    if code == Event.TUNING:
        return "tunings", {"name": variables[argument][0], "value": value}
    if code in VALUE_EVENTS:
        name = variables[argument][0]
        return "events", {"event": VALUE_EVENTS[code], "name": name, "value": value}
    kind = EVENTS.get(code, f"code_{code}")
    entry = {"event": kind, "argument": argument, "value": value}
    names = {
        "fault": description.get("fault_names", []),
        "state": description.get("state_names", []),
        "refused": [variable[0] for variable in variables],
    }.get(kind, [])
    if 0 <= argument < len(names):
        entry["name"] = names[argument]
    if code in OF_A_FRAME:
        entry["name"] = description["frames"].get(str(argument), "")
    return "events", entry
