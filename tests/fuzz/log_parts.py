"""A log taken apart into its records, and written again with all checksums right."""

import io
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field

from mcap.data_stream import RecordBuilder
from mcap.records import (
    Attachment,
    Channel,
    DataEnd,
    Header,
    Message,
    Metadata,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader

from pcpc.executive.log.mcap_records import CRC_KEY, MAGIC, metadata_crc


@dataclass
class Parts:
    """What a log consists of; `content` holds (channel id, sequence, log time, payload)."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    content: list[tuple[int, int, int, bytes]] = field(default_factory=list)
    compression: str = "zstd"
    per_chunk: int = 60
    statistics: dict[int, int] | None = None
    summary: bool = True
    profile: str = "ros2"


def take_apart(data: bytes) -> Parts:
    """Return the records of a whole log."""
    parts = Parts()
    for record in StreamReader(io.BytesIO(data)).records:
        if isinstance(record, Schema):
            parts.schemas[record.id] = record
        elif isinstance(record, Channel):
            parts.channels[record.id] = record
        elif isinstance(record, Attachment):
            parts.attachments.append(record)
        elif isinstance(record, Metadata):
            record.metadata.pop(CRC_KEY, None)
            parts.metadata.append(record)
        elif isinstance(record, Message):
            row = (record.channel_id, record.sequence, record.log_time, record.data)
            parts.content.append(row)
    return parts


def _bytes(write: Callable[[RecordBuilder], None]) -> bytes:
    builder = RecordBuilder()
    write(builder)
    return bytes(builder.end())


def _text(text: str) -> bytes:
    data = text.encode("utf-8", "surrogateescape")
    return struct.pack("<I", len(data)) + data


def _record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def _pairs(pairs: dict[str, str]) -> bytes:
    body = b"".join(_text(key) + _text(value) for key, value in pairs.items())
    return struct.pack("<I", len(body)) + body


def _schema(one: Schema) -> bytes:
    data = struct.pack("<I", len(one.data)) + one.data
    return _record(3, struct.pack("<H", one.id) + _text(one.name) + _text(one.encoding) + data)


def _channel(one: Channel) -> bytes:
    head = struct.pack("<HH", one.id, one.schema_id)
    return _record(4, head + _text(one.topic) + _text(one.message_encoding) + _pairs(one.metadata))


def _message(channel: int, sequence: int, time: int, data: bytes) -> bytes:
    times = struct.pack("<HIQQ", channel & 0xFFFF, sequence & 0xFFFFFFFF, *(2 * [time & 2**64 - 1]))
    return _record(5, times + data)


def packed(data: bytes, compression: str) -> bytes:
    """Return `data` as a chunk holds it."""
    if compression == "zstd":
        import zstandard

        return zstandard.ZstdCompressor(level=1).compress(data)
    if compression == "lz4":
        import lz4.frame

        return bytes(lz4.frame.compress(data))
    return data


def chunk(data: bytes, compression: str = "zstd", size: int | None = None) -> bytes:
    """Return a chunk record; `size` is the declared one."""
    declared = len(data) if size is None else size
    body = struct.pack("<QQQI", 0, 0, declared & 2**64 - 1, zlib.crc32(data))
    content = packed(data, compression)
    return _record(6, body + _text(compression) + struct.pack("<Q", len(content)) + content)


def attachment(one: Attachment) -> bytes:
    """Return an attachment record with its checksum."""
    times = struct.pack("<QQ", one.log_time, one.create_time)
    body = times + _text(one.name) + _text(one.media_type)
    body += struct.pack("<Q", len(one.data)) + one.data
    return _record(9, body + struct.pack("<I", zlib.crc32(body)))


def metadata(name: str, pairs: dict[str, str]) -> bytes:
    """Return a metadata record with our checksum."""
    try:
        whole = pairs | {CRC_KEY: metadata_crc(name, pairs)}
    except ValueError:
        whole = pairs
    return _record(12, _text(name) + _pairs(whole))


def finished(data: bytes, summary: bytes = b"") -> bytes:
    """Return data records as a finished file with `summary`."""
    data += _bytes(DataEnd(zlib.crc32(data)).write)
    footer = struct.pack("<BQQQ", 2, 20, len(data) if summary else 0, 0)
    crc = zlib.crc32(summary + footer)
    return data + summary + footer + struct.pack("<I", crc) + MAGIC


def put_together(parts: Parts) -> bytes:
    """Return the file of these parts."""
    out = MAGIC + _bytes(Header(parts.profile, "fuzz").write)
    for one in parts.metadata:
        out += metadata(one.name, one.metadata)
    out += b"".join(map(attachment, parts.attachments))
    heads = b"".join(map(_schema, parts.schemas.values()))
    heads += b"".join(map(_channel, parts.channels.values()))
    for first in range(0, max(len(parts.content), 1), parts.per_chunk):
        rows = parts.content[first : first + parts.per_chunk]
        out += chunk(heads + b"".join(_message(*row) for row in rows), parts.compression)
    counts: dict[int, int] = {}
    for row in parts.content:
        counts[row[0]] = counts.get(row[0], 0) + 1
    numbers = counts if parts.statistics is None else parts.statistics
    total = sum(counts.values())
    summary = heads + _bytes(
        Statistics(1, len(parts.channels), numbers, 1, 1, 0, total, 0, len(parts.schemas)).write
    )
    return finished(out, summary if parts.summary else b"")
