"""What became of an emulated CAN line: its numbers, and a line to read."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pcpc.drivers.line.line import state_of
from pcpc.tools.start.bus.report import rate_of
from pcpc.tools.terminal.outfile import whole_file

STATES = "active", "warning", "passive", "bus-off"
_COUNTS = ("sent", "waiting", "errors", "refused", "lost_off", "times_off", "most_waiting")


def numbers(line: Any, names: Sequence[str]) -> dict[str, Any]:
    """Return the numbers of a LINE record with its senders' names.

    The load is that from its first to its last frame.
    """
    per_s, bit, fast = (int(line[key]) for key in ("per_s", "bit", "fast"))
    return {
        "bitrate": per_s // bit, "data_bitrate": None if fast == bit else per_s // fast,
        "load": int(line.busy) / max(int(line.free_at - line.first), 1),
        "sides": [
            {"bus": name, "bitrate": per_s // int(line.own_bit[s])}
            | {key: int(line[key][s]) for key in _COUNTS} | {
                "state": STATES[state_of(line, s)], "tec": int(line.transmit_errors[s]),
                "rec": int(line.receive_errors[s]), "worst_tec": int(line.worst[s]),
                "longest_us": 1e6 * int(line.longest[s]) / per_s,
            }
            for s, name in enumerate(names)
        ],
    }  # fmt: skip


def mismatches(found: dict[str, Any]) -> list[str]:
    """Return a line for each side that has another bit rate than the line."""
    return [
        f"line: {side['bus']} has a bit rate of {rate_of(side['bitrate'])}, the line "
        f"{rate_of(found['bitrate'])}: it and the others do not hear each other"
        for side in found["sides"]
        if side["bitrate"] != found["bitrate"]
    ]


def rates_of(bitrate: int, data_bitrate: int | None) -> str:
    """Return the bit rates of a line as people say them."""
    return rate_of(bitrate) + (f", data at {rate_of(data_bitrate)}" if data_bitrate else "")


def write(found: dict[str, Any], path: Path) -> None:
    """Write the numbers as JSON; OSError."""
    with whole_file(path) as unfinished:
        unfinished.write_text(json.dumps(found, indent=2) + "\n")


def summary(found: dict[str, Any]) -> str:
    """Return the numbers in a line."""
    sides, late = found["sides"], found.get("handed_over_late_us")
    total = {key: sum(side[key] for side in sides) for key in _COUNTS}
    rates = rates_of(found["bitrate"], found["data_bitrate"])
    return (
        f"line: {rates}, {total['sent']} frames, load {found['load']:.1%}, "
        f"{total['errors']} errors, {total['refused'] + total['lost_off']} lost, "
        f"{total['times_off']} times bus-off" + (f", late p99 {late['p99']:.0f} us" if late else "")
    )
