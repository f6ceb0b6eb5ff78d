"""What became of a run's nodes, as their host saw it; it loads nothing of what judges a log.

Counters are those of the nodes at their end.
"""

import signal
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pcpc.drivers.errors import Exit
from pcpc.executive.loop import faults
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.plausibility import WHYS
from pcpc.tools.after.verdict.latest import latest_cycles

_UNJUDGED_KEYS = {"seed", "title", "bus", "xcp", "record", "watch", "note", "pacing", "realtime"}

_OF_A_VALUE = (
    Fault.COMMAND_NOT_FINITE,
    Fault.OUTPUT_NOT_FINITE,
    Fault.PLANT_NOT_FINITE,
    Fault.NOT_PLAUSIBLE,
)

_WORDS = {"late_cycles": "late", "skipped_cycles": "skipped", "held_cycles": "held",
          "saturated_values": "saturated"}  # fmt: skip
_VARIABLES = {
    "sent": "frames_sent", "received": "frames_received", "lost": "frames_lost",
    "stale": "stale_cycles", "repeated": "frames_repeated",
    "lost_on_purpose": "frames_lost_on_purpose", "missed": "frames_missed",
    "starved": "starved_cycles", "foreign": "frames_foreign",
}  # fmt: skip
HEALTH = {  # key of the summary -> word of `control`, variable of the log
    key: (_WORDS.get(key, key), _VARIABLES.get(key, key))
    for key in (
        "late_cycles", "skipped_cycles", "held_cycles", "sent", "received", "lost", "stale",
        "crc_errors", "repeated", "saturated_values", "lost_on_purpose", "wrong_sequence",
        "implausible", "intrusions", "signs_on_purpose", "missed", "starved", "foreign",
        "send_errors", "bus_errors", "bus_warnings", "bus_passives", "bus_offs", "bus_restarts",
        "bus_no_acks", "bus_tx_timeouts",
    )
}  # fmt: skip


@dataclass
class Outcome:
    """What the host knows about a run beyond its log."""

    pacing: str
    bus: str
    interrupted: bool = False
    faults: list[str] = field(default_factory=list)
    changed: list[str] = field(default_factory=list)  # NAME=VALUE, on the command line
    strict: bool = False  # what could not be judged is not met
    realtime: bool | None = None
    begin_ns: int | None = None  # monotonic, of the command; None in virtual time
    dropped: int = 0
    cycles: int = 0
    stall: str = ""  # how late a cycle was that may have cost input, and the cure
    short: str = ""  # how far the run came, where it ended early
    latest: list[dict[str, Any]] = field(default_factory=list)
    nodes: list[str] = field(default_factory=list)  # seen here, so they have to be in the log
    missing: list[str] = field(default_factory=list)  # what could not be written
    doubt: str = ""  # why the summary beside the log is not of it
    kept: dict[str, int] = field(default_factory=dict)  # cycles of each node in the log
    health: dict[str, dict[str, int]] = field(default_factory=dict)  # of the nodes seen here

    def judge(self, name: str, code: int, block: sh.NodeMemory | None) -> None:
        """Note the fault or death of process `name`, and what a node's rings dropped."""
        cycle = "" if block is None else f"cycle {int(block.control.cycle)}"
        if block is not None and block.control.fault:
            self.faults.append(f"{name}: {_fault(block)}")
        elif code < 0:
            killer = f"{name}: ended by {signal.Signals(-code).name}{cycle and f' in {cycle}'}"
            hint = " (`dmesg` shows whether memory ran out)" if -code == signal.SIGKILL else ""
            self.faults.append(killer + hint)
        elif code == Exit.SAFETY_STOP and name != "watchdog":
            self.faults.append(f"{name}: ended before its first cycle, see above")
        elif code == 1:
            self.faults.append(f"{name}: failed, see above")
        if block is not None:
            self.nodes.append(name)
            rings = [block.ends(ring) for ring in ("record", "frame", "event")]
            self.dropped += sum(int(ends.dropped) for ends in rings)
            counters = block.control
            self.health[name] = {key: int(counters[word]) for key, (word, _) in HEALTH.items()}
            if name == "executive":
                self.short = _short(block)
                self.latest = latest_cycles(block)
                self.cycles = int(block.control.cycle) + 1
                if self.pacing != "lockstep":
                    self.realtime = bool(block.control.realtime)


def _short(block: sh.NodeMemory) -> str:
    """Return how far a run came that ended before its last cycle; "" if it did not."""
    control, wanted = block.control, int(block.description["cycles"])
    if int(control.passes) + int(control.skipped) >= wanted:
        return ""
    done = int(control.cycle) + 1 if control.passes else 0
    asked = " asked to end (SIGTERM or SIGINT)" if control.stop else " ended"
    return f"{done:,} of {wanted:,} cycles: the executive was{asked} before"


def follows(block: sh.NodeMemory | None) -> bool:
    """Return whether a node's fault may be no more than the end of another one."""
    fault = 0 if block is None else int(block.control.fault)
    return fault in (Fault.INPUT_MISSING, Fault.PEER_SILENT)


def _fault(block: sh.NodeMemory) -> str:
    """Return a node's fault, with the variable or block that it comes from, and its cycle."""
    control = block.control
    fault, step = int(control.fault), int(control.stepping)
    if fault in (Fault.STEP_HANGS, Fault.STEP_RAISED) and step:
        did = "does not return" if fault == Fault.STEP_HANGS else "ended with an exception"
        at = int(control.cycle) + 1 if control.passes else 0
        return f"the step of {block.description['blocks'][step - 1]} {did}, in cycle {at}"
    if fault not in _OF_A_VALUE:
        return f"{faults.reason(block.description, control)}, cycle {int(control.cycle)}"
    name = block.description["variables"][int(control.odd_place) - 1][0]
    value = float(np.int64(control.odd_bits).view(np.float64))
    what = _of_an_fmu(block, name) or "the plant diverged: " * (fault == Fault.PLANT_NOT_FINITE)
    known = WHYS[int(control.culprit) : int(control.culprit) + 1]  # none: of a fault after it
    why = f", {known[0]}" if known and fault == Fault.NOT_PLAUSIBLE else ""
    return f"{what}{name} was {value:g} in cycle {int(control.odd_cycle)}{why}"


def _of_an_fmu(block: sh.NodeMemory, name: str) -> str:
    """Return what the FMU of an output answered; "" for another block, and one that is well."""
    of = name.partition(".")[0]
    names = [entry[0] for entry in block.description["variables"]]
    if f"{of}.fmi_status" not in names:
        return ""
    status = int(block["snapshot"][names.index(f"{of}.fmi_status")])
    answer = {2: "discard", 3: "error", 4: "fatal", 5: "an end"}.get(status)
    return f"the FMU {of} returned {answer}: " if answer else ""


def warnings_of(nodes: Mapping[str, Any]) -> list[str]:
    """Return a line for each FMU in the nodes of a log that warned and went on."""
    lines = []
    for role, node in nodes.items():
        for name in [name for name in node.columns if name.endswith(".fmi_status")]:
            status = node.columns[name]
            if len(status) and status.max() == 1.0:
                first = int(node.cycle[np.argmax(status)])
                of = name.removesuffix(".fmi_status")
                lines.append(f"{role}: the FMU {of} returned a warning, first in cycle {first:,}")
    return lines


def changed_settings(settings: Sequence[str]) -> list[str]:
    """Return the settings, NAME=VALUE, that change what the rig's expectations are about."""
    return [s for s in settings if s.partition("=")[0].partition(".")[0] not in _UNJUDGED_KEYS]
