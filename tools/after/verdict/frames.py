"""Where the frames of a run went: what was sent to each node, and what became of it.

    sent = used + lost + lost_on_purpose + repeated + crc_errors + wrong_sequence + unread

`sent` are the frames that the other nodes here put on the bus and that the DBC, or its drive, has
this node listen to; `unread` are those that it never took: sent before it listened, or on the way
when it ended. A stop frame comes from elsewhere and is none of them. The recorder counts them, also
where the log keeps only a part.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

import numpy as np

from pcpc.drivers.can import dbc
from pcpc.drivers.can.e2e_states import are_of_wire
from pcpc.drivers.errors import BusError
from pcpc.executive.log.long_logs import LongLog
from pcpc.executive.log.reader import Log
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.schema import Limit

STATES = {  # of drivers.can.e2e, which imports numba; lost frames are those between two that came
    0: "used", 1: "used", 2: "repeated", 3: "wrong_sequence", 4: "crc_errors", 6: "lost_on_purpose",
}  # fmt: skip

AWAY = 3  # turns
_COUNTED = re.compile(  # a key of what the recorder counted
    r"(?P<role>\w+)\.(sent\.|received\.(?=\w+\.))(?P<id>[0-9A-F]{1,8})(\.(?P<state>[0-9]{1,3}))?"
)

LIMITS = {  # key of the summary's frames -> of the rig's errors, what it counts
    "crc_errors": ("crc", "frames with a wrong CRC or length"),
    "repeated": ("repeated", "repeated frames"),
    "wrong_sequence": ("wrong_sequence", "frames with a jump of the counter"),
    "implausible": ("implausible", "received values that were not plausible"),
    "send_errors": ("send", "frames that the bus did not take"),
    "bus_errors": ("bus", "errors reported by the CAN controller"),
}
CONTROLLER = {  # of these errors: key of the summary's frames without `bus_`, what it counts
    "warnings": "warning", "passives": "passive", "offs": "bus-off", "restarts": "restarted",
    "no_acks": "not acknowledged", "tx_timeouts": "timed out",
}  # fmt: skip


def too_many(rig: Rig, counts: Mapping[str, int]) -> list[str]:
    """Return a line for each kind of wrong frames of which there were more than the rig allows."""
    limits = rig.config.errors
    told = {what: counts.get(f"bus_{name}", 0) for name, what in CONTROLLER.items()}
    parts = ", ".join(f"{count} {what}" for what, count in told.items() if count)
    details = {"bus": f" ({parts})" if parts else ""}
    lines = [
        f"{counts[name]:,} {what}{details.get(key, '')}; "
        f"errors.{key} allows {getattr(limits, key):,}"
        for name, (key, what) in LIMITS.items()
        if counts[name] > getattr(limits, key)
    ]
    signs = counts["intrusions"] - counts.get("signs_on_purpose", 0)
    if rig.config.supervisor.intrusion != "count" and signs:
        lines.insert(0, f"{signs:,} signs of a second sender of a frame")
    if counts["foreign"]:
        lines.insert(0, f"{counts['foreign']:,} frames of this rig from another sender")
    return lines


def absence_lines(rig: Rig, log: Log) -> list[str]:
    """Return a line for each slow frame that a node missed for more than `AWAY` of its turns.

    Of cycles that the node ran. [] of a log that does not tell.
    """
    away, ran = log.metadata.get("away"), log.metadata.get("run", {})
    if away is None:
        return []
    rate_hz, lines = rig.config.rate_hz, dict[str, None]()
    for role, frames in _listens(rig).items():
        if role in log.node:
            whole = ran.get(f"written.{role}.record", "0")
            for frame in (frame for frame in frames if frame.cycle_ms):
                cycles = int(away.get(f"{role}.{frame.word:X}", whole))
                if cycles > AWAY * (every := frame.every_n(rate_hz)):
                    what = f"{frame.name} stayed away for {cycles / rate_hz:.4g} s"
                    lines[f"{what}; every {every / rate_hz:g} s was expected"] = None
    return list(lines)


def unlike(log: Log) -> list[str]:
    """Return a line if the nodes in the log do not have the same DBC file."""
    files = {name: text for name, text in log.attachments.items() if name.endswith(".dbc")}
    what = f"the nodes have different DBC files, see {', '.join(files)} in the log"
    return [what] if len(set(files.values())) > 1 else []


def frames_to(
    rig: Rig, log: Log, health: Mapping[str, Mapping[str, int]]
) -> dict[str, dict[str, int]]:
    """Return the account of each node, and of the frames that none of them listens to.

    {} of a log that does not tell, or of which a node is elsewhere: its frames are not known.
    """
    counts = log.metadata.get("frames", {})
    sections = rig.config.sections.values()
    sent_words = {frame.word for one in sections for frame in _frames(rig, one.node, "tx")}
    sent: dict[str, Counter[int]] = {role: Counter() for role in rig.roles}
    came: dict[str, Counter[str]] = {role: Counter() for role in rig.roles}
    listens = {role: {f.word for f in frames} for role, frames in _listens(rig).items()}
    keys = [match for key in counts if (match := _COUNTED.fullmatch(key))]
    counted = [match for match in keys if match["role"] in sent]
    for match in counted:
        if match["state"] is None:
            sent[match["role"]][int(match["id"], 16)] += int(counts[match[0]])
    sent_words.update(*sent.values())  # a drive's are those of a node that is none of the rig's
    for match in counted:
        role, number, state = match["role"], int(match["id"], 16), int(match["state"] or -1)
        if number in sent_words and state >= 0 and are_of_wire(state):
            came[role][STATES.get(state, "unread")] += int(counts[match[0]])
            listens[role].add(number)  # a drive takes frames that its node's DBC file does not name
    if not all(role in log.node and sum(sent[role].values()) for role in rig.roles):
        return {}
    account: dict[str, dict[str, int]] = {}
    for role in rig.roles:
        others = [sent[other] for other in rig.roles if other != role]
        total = sum(count for own in others for i, count in own.items() if i in listens[role])
        row = {name: came[role][name] for name in dict.fromkeys(STATES.values())}
        lost = health.get(role, {}).get("missed", 0)
        account[role] = {"sent": total, **row, "lost": lost}
        account[role]["unread"] = total - sum(row.values()) - lost
    heard = set().union(*listens.values())
    none = sum(n for own in sent.values() for i, n in own.items() if i not in heard)
    return account | {"nobody": {"sent": none}}


def most_clipped_signal(rig: Rig, log: Log) -> str:
    """Return which signal was cut in the most cycles, by its limits or by what it can hold.

    "" for none, and of a log too long to be looked at for it.
    """
    found = () if isinstance(log, LongLog) else _cuts(rig, log)
    cycles, text = max(found, default=(0, ""))
    return text.format(cycles) if cycles else ""


def _cuts(rig: Rig, log: Log) -> Iterator[tuple[int, str]]:
    for role, section in rig.config.sections.items():
        columns = log.node[role].columns if role in log.node else {}
        limits = getattr(section, "limits", {})
        for frame in _frames(rig, section.node, "tx"):
            for signal in frame.signals:
                name = f"{frame.name}.{signal.name}"
                values = columns.get(section.transmit.get(name, ""))
                if values is None:
                    continue
                limit = limits.get(name, Limit())
                low, high = max(signal.range[0], limit.low), min(signal.range[1], limit.high)
                for bound, by in ((low, low - values), (high, values - high)):
                    beyond = by > 0.5 * abs(signal.factor)
                    first_s = float(log.node[role].cycle[np.argmax(beyond)]) / rig.config.rate_hz
                    what = f"{name} was cut to {bound:g} {signal.unit}".rstrip()
                    yield int(beyond.sum()), f"{what} in {{:,}} cycles, first at {first_s:.4g} s"


def _listens(rig: Rig) -> dict[str, Sequence[dbc.Frame]]:
    """Return the frames that each node listens to."""
    sections = rig.config.sections.items()
    return {str(role): _frames(rig, section.node, "rx") for role, section in sections}


def _frames(rig: Rig, node: str, way: Literal["rx", "tx"]) -> Sequence[dbc.Frame]:
    """Return the frames that a node sends or receives; none if the DBC file is not there."""
    try:
        return dbc.frames(dbc.load(rig.dbc), node, way)
    except BusError:
        return ()
