"""The records of an MCAP file one by one: layout, checksums, and the checks when they are read.

    record    opcode (1 byte), length of the body (8), body

A reader takes the body and returns its content; one of `UNREADABLE` says what is wrong with it.
Only what carries a checksum is believed: chunks, attachments and, by an entry `crc32` of their own,
metadata, for which the format has none. Format: mcap.dev/spec.
"""

import json
import struct
import zlib
from collections.abc import Callable, Mapping
from functools import cache
from io import BytesIO
from typing import Any

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, Metadata
from mcap.stream_reader import get_chunk_data_stream

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")  # opcode, bytes that follow
FOOTER = struct.Struct("<BQQQI8s")  # opcode, length, summary, its offsets, CRC-32, magic
MESSAGE_HEAD = 31  # bytes of a message record before its payload
CRC_KEY = "crc32"
UNREADABLE = (
    ValueError, struct.error, McapError, zstandard.ZstdError, MemoryError, OverflowError,
)  # fmt: skip
_LARGEST = 1 << 30  # bytes of a chunk; ours have 1 MiB


@cache
def message_dtype(payload_bytes: int) -> np.dtype[Any]:
    """Return the layout of an MCAP message record whose payload has this size."""
    return np.dtype(
        [
            ("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"),
            ("log_time", "<u8"), ("publish_time", "<u8"), ("data", "u1", (payload_bytes,)),
        ]
    )  # fmt: skip


def metadata_crc(name: str, entries: Mapping[str, str]) -> str:
    """Return the CRC-32 of a metadata record, hexadecimal, whatever the order of its entries."""
    plain = sorted((key, value) for key, value in entries.items() if key != CRC_KEY)
    return f"{zlib.crc32(json.dumps([name, plain]).encode()):08x}"


def _read_chunk(body: bytes) -> bytes:
    stream = ReadDataStream(BytesIO(body))
    chunk = Chunk.read(stream)
    if not chunk.uncompressed_crc:
        raise ValueError("it has no checksum")
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        told = zstandard.frame_content_size(chunk.data)
        size = told if told >= 0 else size
    if size != chunk.uncompressed_size or size > _LARGEST:
        raise ValueError("its sizes disagree")
    plain, size = get_chunk_data_stream(chunk, validate_crc=True)
    return plain.read(size)


def _read_attachment(body: bytes) -> Attachment:
    if zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
        raise ValueError("its checksum does not match")
    return Attachment.read(ReadDataStream(BytesIO(body)))


def _read_metadata(body: bytes) -> Metadata:
    stream = ReadDataStream(BytesIO(body))
    record = Metadata.read(stream)
    crc = record.metadata.pop(CRC_KEY, None)
    if crc is None:
        raise ValueError(f"{record.name!r} has no checksum")
    if stream.count != len(body) or crc != metadata_crc(record.name, record.metadata):
        raise ValueError("its checksum does not match")
    return record


def _read_index(body: bytes) -> None:
    if len(body) < 6 or int.from_bytes(body[2:6], "little") != len(body) - 6:
        raise ValueError("its lengths disagree")


def _read_header(body: bytes) -> None:
    stream = ReadDataStream(BytesIO(body))
    stream.read_prefixed_string()
    stream.read_prefixed_string()
    if stream.count != len(body):
        raise ValueError("its lengths disagree")


def _read_data_end(body: bytes) -> int:
    (crc,) = struct.unpack("<I", body)
    return int(crc)


READERS: dict[int, Callable[[bytes], Any]] = {
    Opcode.HEADER: _read_header,
    Opcode.CHUNK: _read_chunk,
    Opcode.MESSAGE_INDEX: _read_index,
    Opcode.ATTACHMENT: _read_attachment,
    Opcode.METADATA: _read_metadata,
    Opcode.DATA_END: _read_data_end,
}
CHECKED = np.array(
    [Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END], np.uint8
)  # kinds of which garbage is no example
