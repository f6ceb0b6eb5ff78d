"""What a page needs to write and read logs of a rig: all that does not depend on a run's numbers.

It comes from a real log: the rig runs natively, until each frame was sent twice. From there on the
loop's own variables are as they were last; only what is counted is computed by the page.

    schemas, channels, metadata, attachments    as in that log, without keyframes, which no page has
    nodes      by node from the executive down: columns and their steps, frames, events

    step       [cycle, value] from which cycle on a column has a value
    frame      its row in `drivers.can.dbc.table`, masks and bits as text
"""

import base64
import json
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import dbc
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.states import HEARTBEATS, State
from pcpc.executive.nodes.plan import Plan, cycles_of
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig import messages
from pcpc.executive.rig.reading import Rig
from pcpc.tools.make.generate.translator.kinds import Untranslatable

_WITHOUT = ("keyframe_passes", "keyframe_bytes", "keyframe_layout")
_AT_END = {
    "supervisor.state": float(State.STOP),
    "supervisor.nmt": float(HEARTBEATS[State.STOP]),
    "supervisor.gain": 0.0,
}
_MARGIN = 4  # cycles in which the nodes begin
_INFINITE = {math.inf: "inf", -math.inf: "-inf"}


def log_head(rig: Rig) -> dict[str, Any]:
    """Return plain data for `page/log.js`; Untranslatable, RigError, BusError.

    Takes as long as the rig needs to send its slowest frame twice.
    """
    if "local" in rig.roles:
        raise Untranslatable(f"{rig.path}: a page writes no log of a rig with a local node")
    with tempfile.TemporaryDirectory(prefix="pcpc-log-") as folder:
        file = Path(folder) / "log.mcap"
        run = VirtualRun(rig, file)
        every = [f.every_n(rig.config.rate_hz) for p in run.plans for f in p.tx_frames]
        known = min(max(every) + _MARGIN, cycles_of(rig))
        try:
            for done in run.advance():
                if done >= known:
                    run.stop()
        finally:
            run.close()
        found = logs.scan(file)
        log = logs.assemble(file, found)
        facts = log.metadata[rig.roles[0]]
        return {
            "rig": rig.config.rig,
            "version": facts["version_pcpc"],
            "period_ns": rig.config.period_ns,
            "period_s": rig.config.period_ns * 1e-9,
            "cycles": cycles_of(rig),
            "wall_ns": facts["clock_wall_ns"],
            "schemas": [[s.id, s.name, s.encoding, s.data.decode()] for s in _schemas(found)],
            "channels": [
                [c.id, c.schema_id, c.topic, c.message_encoding] for c in _channels(found)
            ],
            "metadata": [
                [one.name, one.metadata]
                for one in found.metadata
                if one.name not in ("run", "frames", "away")
            ],
            "attachments": [[a.name, a.media_type, _attachment_text(a)] for a in found.attachments],
            "tunings": _schedule(run.plans),
            "peers": int(run.blocks[0].loop.meeting.peers),
            "nodes": [_node(one, log.node[one.role], known) for one in run.plans],
        }


def _channels(found: logs.Scan) -> Iterator[Any]:
    return (c for c in found.channels.values() if not c.topic.endswith("keyframes"))


def _schemas(found: logs.Scan) -> Iterator[Any]:
    used = {channel.schema_id for channel in _channels(found)}
    return (schema for schema in found.schemas.values() if schema.id in used)


def _attachment_text(file: Any) -> str:
    """Return the text of an attachment, `base64:...` of one that is no UTF-8."""
    data = file.data
    if file.name in {f"{role}.json" for role in logs.NODES}:
        about = json.loads(data)
        data = json.dumps({k: v for k, v in about.items() if k not in _WITHOUT}).encode()
    try:
        return str(data.decode())
    except UnicodeDecodeError:
        return f"base64:{base64.b64encode(data).decode()}"


def _schedule(plans: list[Plan]) -> list[dict[str, Any]]:
    return [
        {"cycle": cycle, "node": p.role, "name": p.table.variables[place].name, "value": value}
        for p in plans
        for cycle, place, value in p.schedule
    ]


def _node(made: Plan, node: logs.NodeLog, known: int) -> dict[str, Any]:
    beats = {f.name for f in (*made.rx_frames, *made.tx_frames) if messages.is_heartbeat(f)}
    about = node.description
    sources = about["sources"]
    rate = made.rig.config.rate_hz
    period_s = made.rig.config.period_ns * 1e-9
    last = {name: _AT_END[s] for name, s in sources.items() if s in _AT_END}
    return {
        "name": made.role,
        "state": about["state_columns"],
        "timing": about["timing_columns"],
        "data_bytes": made.data_bytes,
        "steps": {
            name: _steps(values[:known])
            for name, values in (*node.columns.items(), *node.timing.items())
            if name in node.timing or _is_of_loop(name, beats)
        },
        "events": [one for one in node.events if one["cycle"] < known],
        "heard": [frame.word for frame in made.rx_frames],
        "sent": [
            _frame(frame, rate) for frame in made.tx_frames if not messages.is_emergency(frame)
        ],
        "at_end": last,
        "at_end_event": {
            "event": "state",
            "argument": int(State.STOP),
            "value": 0.0,
            "name": State.STOP.name,
        },
        "limits": {
            f"tx.{name}": {
                "source": sources.get(f"tx.{name}", ""),
                "low": _number(one.low),
                "high": _number(one.high),
                "rate": "inf" if one.rate_per_s is None else one.rate_per_s * period_s,
                "safe": one.safe or 0.0,
            }
            for name, one in made.limits.items()
        },
    }


def _is_of_loop(name: str, beats: set[str]) -> bool:
    kind, _, rest = name.partition(".")
    return kind in ("supervisor", "time") or (
        kind in ("rx", "tx") and rest.partition(".")[0] in beats
    )


def _steps(values: NDArray[np.float64]) -> list[list[float]]:
    at = np.flatnonzero(np.diff(values.view(np.int64), prepend=~values.view(np.int64)[:1]))
    return [[int(k), _number(float(values[k]))] for k in at]


def _number(value: float) -> Any:
    return _INFINITE.get(value, value)


def _frame(frame: dbc.Frame, rate_hz: float) -> dict[str, Any]:
    table = dbc.table([frame], rate_hz)
    row = table.frames[0]
    names = ("dlc", "every_n", "protected", "counter_byte", "counter_shift", "counter_mask",
             "crc_byte", "data_id", "can_id", "selector")  # fmt: skip
    return {name: int(row[name]) for name in names} | {
        "word": frame.word,
        "flags": int(frame.flags),
        "sync": frame.has_sequence,
        "beat": messages.is_heartbeat(frame),
        "signals": [
            {
                "name": f"tx.{name}",
                "kind": dbc.SignalKind(int(one.kind)).name,
                "bits": [_bits(int(one.bits_low)), _bits(int(one.bits_high))],
                "mask": _bits(int(one.mask)),
                **{key: int(one[key]) for key in ("byte", "big_endian", "shift", "layout")},
                **{key: _number(float(one[key]))
                   for key in ("factor", "offset", "code_low", "code_high")},
            }
            for name, one in zip(table.variables, table.signals, strict=True)
        ],
    }  # fmt: skip


def _bits(word: int) -> str:
    return str(word & 2**64 - 1)
