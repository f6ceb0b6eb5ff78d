"""A recorded run, read back from its MCAP file: one sequential pass, also over a damaged file.

    /state, /timing     a message a cycle: CDR header, then float64 fields in schema order
    /can/frames         a message a frame: CDR header, then `FRAME`
    /events, /tunings   JSON

Topics of the plant begin with /plant. `sequence` is the low half of the cycle number; `log_time` is
wall time: stamp - clock_monotonic_ns + clock_wall_ns of the node's metadata, ns. Metadata records:
`executive`, `plant` (versions, clock, machine), `variables:<topic>` (field -> name, unit, help),
`run` (what the recorder counted). Attachments: rig, DBC, `<node>.json` (the block's description).
Format: mcap.dev/spec.
"""

import hashlib
import json
import re
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema, Statistics
from mcap.stream_reader import get_chunk_data_stream
from numpy.typing import NDArray

NODES = ("executive", "plant")
MAGIC = b"\x89MCAP0\r\n"
CDR_BYTES = 4  # the header of a CDR payload: 00 01 00 00, little-endian
FRAME = np.dtype(
    [
        ("stamp_ns", "<i8"), ("cycle", "<i8"), ("id", "<u4"), ("dlc", "u1"),
        ("direction", "u1"), ("e2e", "u1"), ("reserved", "u1"), ("data", "u1", (8,)),
    ]
)  # fmt: skip

_RECORD = struct.Struct("<BQ")  # opcode, bytes that follow
_MESSAGE_HEAD = 31  # bytes of a message record before its payload
_ALIKE = 11  # opcode, length and channel: equal for messages of one channel and size
_RUN = 256  # messages compared at once; longer runs come in pieces
_UNREADABLE = (
    ValueError, struct.error, McapError, zstandard.ZstdError, MemoryError, OverflowError,
)  # fmt: skip


class LogError(Exception):
    """The file is no log of this project. One line, ready to print."""


def topic(node: str, kind: str) -> str:
    """Return the topic of `kind` (state, timing, can/frames, events, tunings) for a node."""
    return f"/{kind}" if node == "executive" else f"/{node}/{kind}"


@cache
def message_dtype(payload_bytes: int) -> np.dtype[Any]:
    """Return the layout of an MCAP message record whose payload has this size."""
    return np.dtype(
        [
            ("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"),
            ("log_time", "<u8"), ("publish_time", "<u8"), ("data", "u1", (payload_bytes,)),
        ]
    )  # fmt: skip


@dataclass
class Scan:
    """What a file holds, in file order. `pieces`: (channel id, uint8 (messages, bytes each))."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    pieces: list[tuple[int, NDArray[np.uint8]]] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)

    def of(self, name: str) -> list[NDArray[np.uint8]]:
        """Return the pieces of a topic."""
        ids = [i for i, channel in self.channels.items() if channel.topic == name]
        return [piece for i, piece in self.pieces if i in ids]


def scan(path: Path) -> Scan:
    """Read all records of a file as far as they are whole; LogError if it is no MCAP file."""
    try:
        data = memoryview(path.read_bytes())
    except OSError as error:
        raise LogError(f"{path}: {error.strerror}") from None
    if data[:8] != MAGIC:
        raise LogError(f"{path}: not an MCAP file (begins with {bytes(data[:8])!r})")
    found = Scan()
    for place, opcode, body in _records(data, len(MAGIC), found.missing):
        try:
            _take(found, opcode, body)
        except _UNREADABLE as error:
            what = Opcode(opcode).name.lower()
            found.missing.append(f"{what} at byte {place} is damaged ({error})")
    return found


def _records(
    data: memoryview, place: int, missing: list[str]
) -> Iterator[tuple[int, int, memoryview]]:
    """Yield (place, opcode, body) up to the footer; say in `missing` where an earlier end is."""
    while place + _RECORD.size <= len(data):
        opcode, length = _RECORD.unpack_from(data, place)
        end = place + _RECORD.size + length
        if end > len(data) or not Opcode.HEADER <= opcode <= Opcode.DATA_END:
            break
        yield place, opcode, data[place + _RECORD.size : end]
        if opcode == Opcode.FOOTER:
            return
        place = end
    missing.append(
        f"the end: nothing is readable after byte {place} of {len(data)} "
        "(recorder killed, disk full, or file cut); the rest of the log is whole"
    )


def _take(found: Scan, opcode: int, body: memoryview) -> None:
    stream = ReadDataStream(BytesIO(body))
    if opcode == Opcode.CHUNK:
        chunk = Chunk.read(stream)
        plain, size = get_chunk_data_stream(chunk, validate_crc=True)
        _take_chunk(found, plain.read(size))
    elif opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        found.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        found.channels[channel.id] = channel
    elif opcode == Opcode.ATTACHMENT:
        found.attachments.append(Attachment.read(stream))
    elif opcode == Opcode.METADATA:
        found.metadata.append(Metadata.read(stream))
    elif opcode == Opcode.STATISTICS:
        _compare(found, Statistics.read(stream))


def _take_chunk(found: Scan, data: bytes) -> None:
    """Split a chunk's records; neighbours of one channel and size come as one piece."""
    place = 0
    while place < len(data):
        opcode, length = _RECORD.unpack_from(data, place)
        size = _RECORD.size + length
        if opcode != Opcode.MESSAGE:
            _take(found, opcode, memoryview(data)[place + _RECORD.size : place + size])
            place += size
            continue
        if size < _MESSAGE_HEAD:
            raise ValueError(f"message of {size} bytes")
        head = data[place : place + _ALIKE]
        alone = data[place + size : place + size + _ALIKE] != head
        count = 1 if alone else min((len(data) - place) // size, _RUN)
        rows = np.frombuffer(data, np.uint8, count * size, place).reshape(count, size)
        same = (rows[:, :_ALIKE] == rows[0, :_ALIKE]).all(axis=1)
        if not same.all():
            rows = rows[: int(same.argmin())]
        found.pieces.append((int.from_bytes(head[_RECORD.size :], "little"), rows))
        place += rows.size


def _compare(found: Scan, statistics: Statistics) -> None:
    """Note the channels of which fewer messages are readable than were written."""
    count: Counter[int] = Counter()
    for i, piece in found.pieces:
        count[i] += len(piece)
    for i, written in statistics.channel_message_counts.items():
        if count[i] < written:
            name = found.channels[i].topic if i in found.channels else f"channel {i}"
            found.missing.append(f"{name}: {written - count[i]} of {written} messages")


@dataclass(frozen=True)
class Node:
    """One node's run: `cycle`, `stamp_ns` (n,) int64; `columns`, `timing`: name -> (n,) float64."""

    cycle: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    columns: dict[str, NDArray[np.float64]]
    timing: dict[str, NDArray[np.float64]]
    frames: NDArray[Any]
    events: list[dict[str, Any]]
    tunings: list[dict[str, Any]]
    description: dict[str, Any]

    @property
    def lost_cycles(self) -> int:
        """Return how many cycles between the first and the last are not in the log."""
        return int(self.cycle[-1] - self.cycle[0]) + 1 - len(self.cycle) if len(self.cycle) else 0


@dataclass(frozen=True)
class Log:
    """A run. `missing` says in words what could not be read; empty for a whole file."""

    path: Path
    node: dict[str, Node]
    attachments: dict[str, str]
    metadata: dict[str, dict[str, str]]
    missing: list[str]


def read(path: Path) -> Log:
    """Read a log as far as it is readable; LogError (one line) if it is not one of this project."""
    found = scan(path)
    metadata = {record.name: record.metadata for record in found.metadata}
    attachments = {file.name: file.data.decode("utf-8", "replace") for file in found.attachments}
    nodes = {name: _node(name, found, metadata, attachments) for name in NODES if name in metadata}
    if not nodes:
        raise LogError(f"{path}: an MCAP file, but not a log of pcpc (no metadata of a node)")
    return Log(path, nodes, attachments, metadata, found.missing)


def payloads(path: Path, name: str) -> list[bytes]:
    """Return the payloads of a topic in the order of recording."""
    rows = (row for piece in scan(path).of(name) for row in piece)
    return [row[_MESSAGE_HEAD:].tobytes() for row in rows]


def digest(path: Path, name: str) -> str:
    """Return the sha256 over all payloads of a topic, to compare runs bit for bit."""
    return hashlib.sha256(b"".join(payloads(path, name))).hexdigest()


def _node(
    name: str, found: Scan, metadata: dict[str, dict[str, str]], attachments: dict[str, str]
) -> Node:
    cycle, log_time, columns = _columns(found, topic(name, "state"), metadata)
    timing_cycle, _, timing = _columns(found, topic(name, "timing"), metadata)
    if timing and not np.array_equal(cycle, timing_cycle):  # one of them lost messages
        _, kept, timing_kept = np.intersect1d(cycle, timing_cycle, return_indices=True)
        found.missing.append(f"{name}: {len(cycle) - len(kept)} cycles have no timing; left out")
        cycle, log_time = cycle[kept], log_time[kept]
        columns = {key: values[kept] for key, values in columns.items()}
        timing = {key: values[timing_kept] for key, values in timing.items()}
    facts = metadata[name]
    wall_ns, monotonic_ns = (
        _parsed(facts.get(key, "absent"), 0, f"{name}: {key}", found)
        for key in ("clock_wall_ns", "clock_monotonic_ns")
    )
    frames = _messages(found, topic(name, "can/frames"), CDR_BYTES + FRAME.itemsize)
    data = np.ascontiguousarray(frames["data"][:, CDR_BYTES:])
    return Node(
        cycle, log_time - (wall_ns - monotonic_ns), columns, timing, data.view(FRAME)[:, 0],
        _objects(found, topic(name, "events")), _objects(found, topic(name, "tunings")),
        _parsed(attachments.get(f"{name}.json", "absent"), {}, f"{name}: its description", found),
    )  # fmt: skip


def _messages(found: Scan, name: str, payload_bytes: int) -> NDArray[Any]:
    """Return the messages of a topic of one payload size as one structured array."""
    dtype = message_dtype(payload_bytes)
    pieces = [piece for piece in found.of(name) if piece.shape[1] == dtype.itemsize]
    if not pieces:
        return np.empty(0, dtype)
    return np.concatenate(pieces).view(dtype)[:, 0]


def _columns(
    found: Scan, name: str, metadata: dict[str, dict[str, str]]
) -> tuple[NDArray[np.int64], NDArray[np.int64], dict[str, NDArray[np.float64]]]:
    """Return (cycle, log_time in ns, columns by dotted name) of a topic of flat float64 fields."""
    schemas = [found.schemas.get(c.schema_id) for c in found.channels.values() if c.topic == name]
    text = schemas[0].data.decode("utf-8", "replace") if schemas and schemas[0] else ""
    fields = re.findall(r"^float64 (\w+)", text, re.MULTILINE)
    messages = _messages(found, name, CDR_BYTES + 8 * len(fields))
    values = np.frombuffer(messages["data"][:, CDR_BYTES:].tobytes(), "<f8")
    values = values.reshape(len(messages), len(fields)).T.copy()
    variables = metadata.get(f"variables:{name}", {})
    about = [_parsed(variables.get(f, "absent"), {}, f"{name}: name of {f}", found) for f in fields]
    names = [str(a.get("name", f)) for a, f in zip(about, fields, strict=True)]
    sequence = messages["sequence"].astype(np.int64)
    wraps = np.cumsum(np.diff(sequence, prepend=sequence[:1]) < 0, dtype=np.int64)
    cycle = sequence + (wraps << 32)
    return cycle, messages["log_time"].astype(np.int64), dict(zip(names, values, strict=True))


def _objects(found: Scan, name: str) -> list[dict[str, Any]]:
    texts = (row[_MESSAGE_HEAD:].tobytes() for piece in found.of(name) for row in piece)
    return [_parsed(text, {}, f"{name}: an entry", found) for text in texts]


def _parsed(text: str | bytes, otherwise: Any, what: str, found: Scan) -> Any:
    """Return the JSON value; `otherwise`, and a note in `found`, if it is damaged."""
    with suppress(ValueError):
        value = json.loads(text)
        if isinstance(value, type(otherwise)):
            return value
    found.missing.append(f"{what} is not readable")
    return otherwise
