"""The records of an MCAP file one by one: layout, checksums, and the checks when they are read.

    record    opcode (1 byte), length of the body (8), body

A reader takes the body and returns its content; one of `UNREADABLE` says what is wrong with it.
Only what carries a checksum is believed: chunks, attachments and, by an entry `crc32` of their own,
metadata, for which the format has none. Declared sizes are believed only as far as they agree with
what is there. Texts come back printable. Format: mcap.dev/spec.
"""

import json
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from io import BytesIO
from typing import Any

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema, Statistics

from pcpc.drivers.errors import printable

Times = tuple[int, int]  # log times, ns: first and last

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")  # opcode, bytes that follow
FOOTER = struct.Struct("<BQQQI8s")  # opcode, length, summary, its offsets, CRC-32, magic
MESSAGE_HEAD = 31  # bytes of a message record before its payload
CRC_KEY = "crc32"
UNREADABLE = (
    ValueError, struct.error, McapError, zstandard.ZstdError, MemoryError, OverflowError,
)  # fmt: skip
ALIKE = 11  # opcode, length and channel: equal for messages of one channel and size
_RUN = 1024  # messages compared at once; longer runs come in pieces
LARGEST_CHUNK = 16 << 20  # bytes; ours have 1 MiB, those of other tools usually 4
CHUNK_INDEX = struct.Struct("<QQQ")  # head of its body: first and last time, place
DECLARED = struct.Struct("<QQQ")  # head of a chunk's body: first and last time, bytes unpacked


@cache
def message_dtype(payload_bytes: int) -> np.dtype[Any]:
    """Return the layout of an MCAP message record whose payload has this size."""
    return np.dtype(
        [
            ("opcode", "u1"),
            ("length", "<u8"),
            ("channel", "<u2"),
            ("sequence", "<u4"),
            ("log_time", "<u8"),
            ("publish_time", "<u8"),
            ("data", "u1", (payload_bytes,)),
        ]
    )


def alike(data: bytes, place: int, size: int) -> int:
    """Return how many messages from `place` on are of one channel and size: of at most _RUN."""
    head, following = (data[begin : begin + ALIKE] for begin in (place, place + size))
    if following != head:
        return 1
    most = min((len(data) - place) // size, _RUN)
    low, high = (  # two words that overlap
        np.ndarray(most, "<u8", data, begin, size) for begin in (place, place + ALIKE - 8)
    )
    same = (low == low[0]) & (high == high[0])
    return most if same.all() else int(same.argmin())


def metadata_crc(name: str, entries: Mapping[str, str]) -> str:
    """Return the CRC-32 of a metadata record, hexadecimal, whatever the order of its entries."""
    plain = sorted((key, value) for key, value in entries.items() if key != CRC_KEY)
    return f"{zlib.crc32(json.dumps([name, plain]).encode()):08x}"


class ForeignMetadata(Metadata):
    """Metadata of another tool, which gives them no checksum: copied, but not believed."""


def _read_chunk(body: bytes) -> bytes:
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    if not chunk.uncompressed_crc:
        raise ValueError("it has no checksum")
    data = unpack_chunk(chunk)
    if zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("its checksum does not match")
    return data


def unpack_chunk(chunk: Chunk) -> bytes:
    """Return a chunk's content, never more than it declares; one of UNREADABLE.

    ValueError: it has another size or checksum.
    """
    size = chunk.uncompressed_size
    if size > LARGEST_CHUNK:
        raise ValueError(f"{size} bytes, more than any log has in one chunk")
    if chunk.compression == "zstd":
        told = zstandard.frame_content_size(chunk.data)
        if told not in (-1, size):  # -1: not told
            raise ValueError("its sizes disagree")
        data = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=size)
    elif chunk.compression == "lz4":
        data = _unpack_lz4(chunk.data, size)
    elif chunk.compression:
        raise ValueError(f"compression {printable(chunk.compression[:20])} is not known")
    else:
        data = chunk.data
    if len(data) != size:
        raise ValueError("its sizes disagree")
    return bytes(data)


def _unpack_lz4(data: bytes, size: int) -> bytes:
    import lz4.frame  # mcap brings it; only logs of other tools need it

    try:
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
    except (RuntimeError, EOFError) as error:
        raise ValueError(str(error)) from None


def read_schema(body: bytes) -> Schema:
    """Return a schema record; one of UNREADABLE."""
    schema: Schema = Schema.read(ReadDataStream(BytesIO(body)))
    schema.name, schema.encoding = printable(schema.name), printable(schema.encoding)
    return schema


def read_channel(body: bytes) -> Channel:
    """Return a channel record; one of UNREADABLE."""
    channel: Channel = Channel.read(ReadDataStream(BytesIO(body)))
    channel.topic = printable(channel.topic)
    channel.message_encoding = printable(channel.message_encoding)
    return channel


def _read_attachment(body: bytes) -> Attachment:
    crc = int.from_bytes(body[-4:], "little")
    if crc and zlib.crc32(body[:-4]) != crc:
        raise ValueError("its checksum does not match")
    file: Attachment = Attachment.read(ReadDataStream(BytesIO(body)))
    file.name, file.media_type = printable(file.name), printable(file.media_type)
    if not crc:  # another tool's
        raise ValueError(f"{file.name[:80]!r} has no checksum")
    return file


def _read_metadata(body: bytes) -> Metadata:
    stream = ReadDataStream(BytesIO(body))
    record = Metadata.read(stream)
    crc = record.metadata.pop(CRC_KEY, None)
    if stream.count != len(body):
        raise ValueError("its lengths disagree")
    if crc is None:
        return ForeignMetadata(name=printable(record.name), metadata=record.metadata)
    if crc != metadata_crc(record.name, record.metadata):
        raise ValueError("its checksum does not match")
    texts = {printable(key): printable(value) for key, value in record.metadata.items()}
    return Metadata(name=printable(record.name), metadata=texts)


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


def places_of(
    data: bytes, summary: int, only: Times, counts: Statistics | None
) -> Iterator[int] | None:
    """Return where, says the summary, attachments, metadata and the chunks of these times begin.

    None if it does not name them all.
    """
    place, places, named = summary, [], Counter[int]()
    while place + RECORD.size < len(data) - FOOTER.size:
        opcode, length = RECORD.unpack_from(data, place)
        place += RECORD.size
        named[opcode] += 1
        if opcode in (Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX):
            places.append(int.from_bytes(data[place : place + 8], "little"))
        elif opcode == Opcode.CHUNK_INDEX:
            first, last, at = CHUNK_INDEX.unpack_from(data, place)
            places += [at] if last >= only[0] and first <= only[1] else []
        place += length
    wanted = counts and (counts.attachment_count, counts.metadata_count, counts.chunk_count)
    kinds = Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX, Opcode.CHUNK_INDEX
    if wanted != tuple(named[kind] for kind in kinds):
        return None
    return iter(sorted({at for at in places if len(MAGIC) <= at < summary}))
