"""What a run leaves that was killed: its nodes' last cycles, its log, names on the bus.

The memory of a node stays mapped here when it dies, so that what it did last is known to the cycle.
"""

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.machine import claim
from pcpc.executive.log import reader as logs
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.ring_layout import RECORD_HEAD, OfFrame, OfRecord
from pcpc.executive.loop.states import STATE_NAMES, State
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.plan import Plan, plan
from pcpc.executive.rig.messages import database_of
from pcpc.executive.rig.reading import load_rig


class NodeAftermath(NamedTuple):
    """A node's run, as its memory has it."""

    cycle: NDArray[np.int64]
    state: str  # its last one
    fault: str
    exposed: int
    safe: bool  # its last command
    limit: int
    period_ms: float


def node_run(node: Live, rig: str, role: Any) -> NodeAftermath:
    """Return what the memory of a node says of its run, also after its death."""
    block, made = node.block, plan(load_rig(rig), role, "real")
    safe = {f"rx.{name}": value for name, value in made.spec.safe.items()}
    safe |= {f"tx.{name}": limit.safe or 0.0 for name, limit in made.limits.items()}
    put = int(block.ends("record").head)
    newest = np.arange(max(0, put - len(block["record"])), put) % len(block["record"])
    rows, values = block["record"][newest], block["record_values"][newest]
    names = block.description["state_columns"]
    column = {name: RECORD_HEAD + i for i, name in enumerate(names)}
    state = values[:, column["supervisor.state"]]
    away = np.any([values[:, column[name]] != value for name, value in safe.items()], axis=0)
    exposed = _longest(away & np.isin(state, (State.HOLD, State.FAULT, State.STOP)))
    last = dict(node.read()) if node.ended else {n: values[-1, at] for n, at in column.items()}
    held = {name: last[name] for name in safe}
    told = held | _received_values(block, made)
    fault = block.description["fault_names"][int(block.control.fault)]
    asked = role == "plant" and bool(block.control.stop)
    return NodeAftermath(
        rows[:, OfRecord.CYCLE],
        STATE_NAMES[int(last["supervisor.state"])],
        fault,
        exposed,
        asked or safe in (held, told),
        _limit(made),
        1e-6 * node.period_ns,
    )


def _received_values(block: sh.NodeMemory, made: Plan) -> dict[str, float]:
    """Return the last valid values that came over the bus for what has a safe value here."""
    put, rows = int(block.ends("frame").head), block["frame"]
    newest = np.arange(max(0, put - len(rows)), put) % len(rows)
    about, data = rows[newest, OfFrame.ABOUT], rows[newest, OfFrame.PAYLOAD]
    used = (about >> 40 & 0xFF == 1) & np.isin(
        about >> 48 & 0xFF, (FrameState.OK, FrameState.OK_SOME_LOST)
    )
    found: dict[str, float] = {}
    for message in database_of(made.rig).messages:
        wanted = [n for n in made.spec.safe if n.partition(".")[0] == message.name]
        word = can_id.word_of(message.frame_id, message.is_extended_frame)
        came = np.flatnonzero(used & (about & 0xFFFF_FFFF == word))
        if wanted and len(came):
            text = data[came[-1]].tobytes()[: message.length]
            values: Any = message.decode(text, decode_choices=False)
            found |= {f"rx.{name}": values[name.partition(".")[2]] for name in wanted}
    return found


def _limit(made: Plan) -> int:
    """Return for how many cycles a command may be neither fresh nor safe: watchdog and ramp."""
    of = made.rig.config.supervisor
    return of.fault_after_cycles + math.ceil(of.ramp_s * made.rig.config.rate_hz)


def _longest(there: NDArray[np.bool_]) -> int:
    """Return the most true values in a row."""
    edges = np.flatnonzero(np.diff(there.astype(np.int8), prepend=0, append=0))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def log_losses(
    path: Path, seen: Mapping[str, NodeAftermath], until: Mapping[str, int]
) -> dict[str, Any]:
    """Return what a log lacks at its end, up to the cycles `until`, and before its end."""
    try:
        found = logs.read(path)
    except logs.LogError as error:
        return {"opens": False, "why": str(error), "missing_ms": None, "holes": None}
    missing_ms, holes = 0.0, 0
    for role, one in seen.items():
        node = found.node.get(role)
        has = node.cycle if node is not None else np.zeros(0, np.int64)
        last = int(has[-1]) if len(has) else -1
        end = min(int(one.cycle[-1]), until.get(role, int(one.cycle[-1])))
        missing_ms = max(missing_ms, (end - last) * one.period_ms)
        holes += len(np.setdiff1d(one.cycle[one.cycle <= last], has))
    return {"opens": True, "why": "", "missing_ms": missing_ms, "holes": holes}


def leftovers(bus: str) -> list[str]:
    """Return what is left of the nodes on a bus: claims, and files in /dev/shm."""
    mine = sh.block_name("", bus, "")
    files = [path.name for path in Path("/dev/shm").iterdir() if "pcpc" in path.name]
    claims = [*claim.held_names("lock/"), *claim.held_names("node/")]
    of_frames = [
        *claim.held_names(f"frame/{bus}/"),
        *claim.held_names(f"seat/{os.getuid()}/{bus}/"),
    ]
    return [name for name in (*files, *claims) if mine in name] + of_frames
