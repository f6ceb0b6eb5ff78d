"""A recorded run, read back from its MCAP file, also from a damaged one.

    /state, /timing     a message a cycle: CDR header, then float64 fields in schema order
    /can/frames         a message a frame: CDR header, then `FRAME`
    /events, /tunings   JSON

Topics of the other nodes begin with their names: /plant, /local. `sequence` is the low half of the
cycle number; `log_time` is wall time: stamp - clock_monotonic_ns + clock_wall_ns of the node's
metadata, ns. Where no clock ran (pacing lockstep, virtual) stamps are k T, and count from the start
of the first node; `timing.wall_s` holds wall time. Metadata records: one a node (versions, clock,
machine), `variables:<topic>` (field -> name, unit, help), `run` (what the recorder counted),
`recovered` (what was missing when the log was written anew). Attachments: rig, DBC, `<node>.json`
(the block's description). A value whose checksum does not match is left out and told in `missing`:
see `executive.log.mcap_reader`.
"""

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import printable
from pcpc.executive.log import checks as log_checks
from pcpc.executive.log.description import LATEST, NodeDescription
from pcpc.executive.log.frames import (
    CDR_BYTES,
    FD_FRAME,
    FRAME,
    FRAME_SIZES,
    frame_type,
    frames_in,
    on_bus,
)
from pcpc.executive.log.inventory import OTHER_ENTRIES, SEQUENCE, TOPICS, topic
from pcpc.executive.log.mcap_reader import NONE, LogError, Scan, scan, walk
from pcpc.executive.log.mcap_records import MESSAGE_HEAD, Times, message_dtype
from pcpc.executive.rig.roles import ROLES as NODES

__all__ = [
    "CDR_BYTES",
    "FD_FRAME",
    "FRAME",
    "FRAME_SIZES",
    "LATEST",
    "NODES",
    "LogError",
    "Scan",
    "Times",
    "frame_type",
    "frames_in",
    "message_dtype",
    "on_bus",
    "scan",
    "topic",
    "walk",
]  # and its own

CARRIED = "files/"  # of attachments that `executive.own_laws.carried_files` describes
PIECE_BYTES = 1 << 23  # of a file that is read in pieces
_PATIENCE_BYTES = 1 << 25  # unpacked, until a piece ends though one half of its records is ahead
_STATES = {topic(name, "state") for name in NODES}
_LARGE = "/frames", *(f"/{kind}" for kind in OTHER_ENTRIES)  # ends of topics
_FIELD = re.compile(r"float64 (\w+)(.*)")


@dataclass(frozen=True)
class NodeLog:
    """One node's run: `cycle`, `stamp_ns` (n,) int64; `columns`, `timing`: name -> (n,) float64."""

    cycle: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    columns: Mapping[str, NDArray[np.float64]]
    timing: Mapping[str, NDArray[np.float64]]
    frames: NDArray[Any]
    events: list[dict[str, Any]]
    tunings: list[dict[str, Any]]
    description: NodeDescription
    others: Mapping[str, Sequence[bytes]] = field(default_factory=dict)  # texts by OTHER_ENTRIES


@dataclass(frozen=True)
class Log:
    """A run. `missing` says in words what could not be read; empty for a whole file.

    `rig`: the effective rig's data, of a run in memory; else it is a text of the attachments.
    """

    path: Path
    node: dict[str, NodeLog]
    attachments: dict[str, str]
    metadata: dict[str, dict[str, str]]
    missing: list[str]
    files: Mapping[str, bytes] = field(default_factory=dict)  # of `own_laws.carried_files`
    rig: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class LoggedVariable:
    """A field of a topic of columns: its name in the message, its dotted name, its unit."""

    field: str
    name: str
    unit: str


def read(path: Path) -> Log:
    """Read a log as far as it is readable; LogError (one line) if it is not one of this project."""
    return assemble(path, scan(path))


def head(path: Path) -> Log:
    """As `read`, without the records of the cycles: rig, DBC, metadata, descriptions."""
    scanned = Scan()
    for _ in walk(path, scanned, NONE):
        pass
    return assemble(path, scanned)


def pieces(
    path: Path,
    size: int = PIECE_BYTES,
    see: Callable[[Scan, int, NDArray[np.uint8]], None] = lambda found, channel, rows: None,
    only: Times | None = None,
    short: int | None = None,
) -> Iterator[tuple[Log, bool]]:
    """As `read`, in pieces of about `size` bytes of the file; yield them and whether it is the end.

    `missing` of a piece is what could not be read since the piece before. `see` gets the scan and
    each run of messages, channel and rows (n, bytes of a message), as they come; at the end channel
    -1. `only`: of `walk`. With `short` there are neither frames nor OTHER_ENTRIES, and a log whose
    nodes have at most so many cycles is one piece.
    """
    scanned, begin, told_notes, waited, sifted = Scan(), 0, 0, 0, 0
    newest: dict[str, bytes] = {}  # sequence of the last message, by topic
    is_due = short is None
    for piece in walk(path, scanned, only):
        name, rows = scanned.topic(piece[0]), piece[1]
        if short is not None:
            is_due = is_due or (name in _STATES and scanned.inventory.kept[name] > short)
            if scanned.place - sifted >= size:
                _leave_frames_out(scanned)
                sifted = scanned.place
        if is_due and scanned.place - begin >= size:
            waited += rows.nbytes
            if waited > _PATIENCE_BYTES or _is_level(scanned, newest):
                if short is not None:
                    _leave_frames_out(scanned)
                log = assemble(path, scanned, told_notes)
                begin, told_notes, waited = scanned.place, len(scanned.missing), 0
                scanned.pieces.clear()
                yield log, False
        scanned.pieces.append(
            piece if short is None else (piece[0], rows.copy())
        )  # else its chunk stays
        newest[name] = rows[-1, SEQUENCE].tobytes()
        see(scanned, *piece)
    see(scanned, -1, np.empty((0, 0), np.uint8))
    if short is not None:
        _leave_frames_out(scanned)
    yield assemble(path, scanned, told_notes), True


def _is_level(scanned: Scan, newest: Mapping[str, bytes]) -> bool:
    """Return whether states and timing of each node, where both are logged, are at one cycle."""
    logged = {channel.topic for channel in scanned.channels.values()}
    logged |= {record.name.removeprefix("variables:") for record in scanned.metadata}
    halves = ((name, topic(TOPICS[name][0], "timing")) for name in _STATES & logged)
    return all(newest.get(a) == newest.get(b) or b not in logged for a, b in halves)


def _leave_frames_out(scanned: Scan) -> None:
    """Take frames and OTHER_ENTRIES out of a scan; count frames that cannot be."""
    for name in {c.topic for c in scanned.channels.values() if c.topic.endswith("/frames")}:
        for size in FRAME_SIZES:
            _, sane = _frames_of(scanned, name, size)
            scanned.inventory.impossible[name] += len(sane) - int(sane.sum())
    scanned.pieces = [p for p in scanned.pieces if not scanned.topic(p[0]).endswith(_LARGE)]


def assemble(path: Path, scanned: Scan, told_notes: int = 0) -> Log:
    """Return what a scan found as a log, without the first `told_notes` of what is missing.

    Raises LogError if it is not one of this project.
    """
    notes = scanned.missing[told_notes:]
    metadata = {record.name: record.metadata for record in scanned.metadata}
    for name in {"run", "frames", "away"} & metadata.keys():
        metadata[name] = log_checks.counts(metadata[name])
    files = {one.name: one.data for one in scanned.attachments if one.name.startswith(CARRIED)}
    attachments = {
        one.name: one.data.decode("utf-8", "replace")
        for one in scanned.attachments
        if one.name not in files
    }
    wrong: list[str] = []
    descriptions = _descriptions(metadata, attachments, wrong)
    notes += _unsaid(scanned, wrong)
    if not descriptions:
        reason = scanned.missing[0] if scanned.missing else "no metadata of a node"
        raise LogError(f"{path}: an MCAP file, but not a log of pcpc ({reason})")
    nodes = {
        name: _node(name, scanned, metadata, about, notes) for name, about in descriptions.items()
    }
    return Log(path, nodes, attachments, metadata, notes, files)


def frame_names(log: Log) -> dict[int, str]:
    """Return the names in the DBC of the frames that the nodes know, by id as in `FRAME`."""
    names: dict[int, str] = {}
    for node in log.node.values():
        names |= {int(i): str(name) for i, name in node.description.get("frames", {}).items()}
    return names


def variables(scanned: Scan, name: str) -> list[LoggedVariable]:
    """Return the fields of a topic of columns, in the order of its messages; empty if unknown."""
    schemas = [
        scanned.schemas.get(c.schema_id) for c in scanned.channels.values() if c.topic == name
    ]
    text = schemas[0].data.decode("utf-8", "replace") if schemas and schemas[0] else ""
    known = next((m.metadata for m in scanned.metadata if m.name == f"variables:{name}"), {})
    listed = []
    for found_field in map(_FIELD.match, text.split("\n")):
        if found_field:
            short, dotted, unit = _field(*found_field.groups())
            given = known.get(short, "absent")
            about = _json_value(given, {"name": dotted or short, "unit": unit}, "", [])
            name, unit = about.get("name", dotted or short), about.get("unit", "")
            listed.append(LoggedVariable(short, str(name), str(unit)))
    return listed


def _field(field: str, rest: str) -> tuple[str, str, str]:
    """Return field, dotted name and unit of a line `float64 field  # dotted [unit] help`."""
    dotted, opened, about = rest.removeprefix("  # ").partition(" [")
    unit, closed, _ = about.partition("]")
    if not (rest.startswith("  # ") and dotted and opened and closed):
        dotted = unit = ""
    return field, printable(dotted), printable(unit)


def payloads(path: Path, name: str) -> list[bytes]:
    """Return the payloads of a topic in the order of recording."""
    rows = (row for piece in scan(path).pieces_of(name) for row in piece)
    return [row[MESSAGE_HEAD:].tobytes() for row in rows]


def digest(path: Path, name: str) -> str:
    """Return the sha256 over all payloads of a topic, to compare runs bit for bit."""
    return hashlib.sha256(b"".join(payloads(path, name))).hexdigest()


def _descriptions(
    metadata: dict[str, dict[str, str]], attachments: Mapping[str, str], notes: list[str]
) -> dict[str, NodeDescription]:
    """Return the description of each node; add metadata that is damaged but repeated in there."""
    descriptions: dict[str, NodeDescription] = {}
    for name in NODES:
        if name not in metadata and f"{name}.json" not in attachments:
            continue
        text = attachments.get(f"{name}.json", "absent")
        given = _json_value(text, {}, f"{name}: its description", notes)
        description, wrong = log_checks.description(given)
        if name not in metadata and {"metadata", "rig", "period_ns"} <= description.keys():
            facts = description["metadata"] | {
                key: description[key] for key in ("rig", "period_ns")
            }
            metadata[name] = {key: str(value) for key, value in facts.items()}
        if name in metadata:
            metadata[name], impossible = log_checks.facts(metadata[name])
            descriptions[name] = description
            for key in wrong:
                notes.append(f"{name}: {key} of its description is not readable")
            for key in impossible:
                notes.append(f"{name}: {key} is impossible")
    return descriptions


def _node(
    name: str,
    scanned: Scan,
    metadata: Mapping[str, Mapping[str, str]],
    description: NodeDescription,
    notes: list[str],
) -> NodeLog:
    cycle, log_time, columns = _columns(scanned, topic(name, "state"))
    timing_cycle, _, timing = _columns(scanned, topic(name, "timing"))
    if timing and not np.array_equal(cycle, timing_cycle):  # one of them lost messages
        _, kept_rows, timing_kept = np.intersect1d(cycle, timing_cycle, return_indices=True)
        if len(cycle) > len(kept_rows):
            notes.append(f"{name}: {len(cycle) - len(kept_rows)} cycles have no timing; left out")
        cycle, log_time = cycle[kept_rows], log_time[kept_rows]
        columns = {key: values[kept_rows] for key, values in columns.items()}
        timing = {key: values[timing_kept] for key, values in timing.items()}
    wrong: list[str] = []
    wall_ns, monotonic_ns = (
        _json_value(metadata[name].get(key, "absent"), 0, f"{name}: {key}", wrong)
        for key in ("clock_wall_ns", "clock_monotonic_ns")
    )
    notes += _unsaid(scanned, wrong)
    frames = _frames(scanned, name, notes, frame_type(description))
    return NodeLog(
        cycle,
        log_time - (wall_ns - monotonic_ns),
        columns,
        timing,
        frames,
        _objects(scanned, topic(name, "events"), notes),
        _objects(scanned, topic(name, "tunings"), notes),
        description,
        {kind: _texts(scanned, topic(name, kind)) for kind in OTHER_ENTRIES},
    )


def _unsaid(scanned: Scan, lines: list[str]) -> list[str]:
    """Return what was not told with an earlier piece of the log."""
    fresh = [line for line in lines if line not in scanned.inventory.said]
    scanned.inventory.said.update(fresh)
    return fresh


def _frames(scanned: Scan, name: str, notes: list[str], kind: np.dtype[Any]) -> NDArray[Any]:
    """Return the frames of a node; what no bus could have carried is left out."""
    place = topic(name, "can/frames")
    frames, sane = _frames_of(scanned, place, kind.itemsize)
    if lost := len(frames) - int(sane.sum()) + scanned.inventory.impossible.pop(place, 0):
        notes.append(f"{name}: {lost} frames that no bus could have carried")
        frames = frames[sane]
    return frames


def _frames_of(scanned: Scan, name: str, size: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return the frames of a topic of `size` bytes, and which of them a bus could have carried."""
    none = np.empty(0, message_dtype(CDR_BYTES + size))
    return frames_in(np.concatenate([none, *_messages(scanned, name, CDR_BYTES + size)]))


def _messages(scanned: Scan, name: str, payload_bytes: int) -> list[NDArray[Any]]:
    """Return the messages of a topic of one payload size as structured arrays, each (n,)."""
    dtype = message_dtype(payload_bytes)
    pieces = scanned.pieces_of(name)
    return [piece.view(dtype)[:, 0] for piece in pieces if piece.shape[1] == dtype.itemsize]


def _columns(
    scanned: Scan, name: str
) -> tuple[NDArray[np.int64], NDArray[np.int64], dict[str, NDArray[np.float64]]]:
    """Return (cycle, log_time in ns, columns by dotted name) of a topic of flat float64 fields."""
    names = [variable.name for variable in variables(scanned, name)]
    messages = _messages(scanned, name, CDR_BYTES + 8 * len(names))
    count = sum(map(len, messages))
    cycle, log_time = np.empty((2, count), np.int64)
    values = np.empty((len(names), count))
    begin = 0
    for piece in messages:
        rows = slice(begin, begin := begin + len(piece))
        cycle[rows], log_time[rows] = piece["sequence"], piece["log_time"]
        values[:, rows] = np.ascontiguousarray(piece["data"][:, CDR_BYTES:]).view("<f8").T
    cycle = log_checks.unwrapped_cycles(cycle, scanned.inventory.cycles.get(name))
    if count:
        scanned.inventory.cycles[name] = int(cycle[-1])
    return cycle, log_time, dict(zip(names, values, strict=True))


def _objects(found: Scan, name: str, notes: list[str]) -> list[dict[str, Any]]:
    entries = [log_checks.entry(text, name.endswith("tunings")) for text in _texts(found, name)]
    if bad := entries.count(None):
        notes.append(f"{name}: {bad} entries are not readable")
    return [entry for entry in entries if entry is not None]


def _texts(found: Scan, name: str) -> list[bytes]:
    return [row[MESSAGE_HEAD:].tobytes() for piece in found.pieces_of(name) for row in piece]


def _json_value(text: str | bytes, otherwise: Any, subject: str, notes: list[str]) -> Any:
    """Return the JSON value; `otherwise`, and a note, if it is damaged or of another kind."""
    try:
        value = log_checks.parse_json(text)
    except ValueError:
        value = None
    if isinstance(value, type(otherwise)) and not isinstance(value, bool):
        return value
    notes.append(f"{subject} is not readable")
    return otherwise
