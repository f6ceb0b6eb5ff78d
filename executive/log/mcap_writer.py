"""MCAP files written a batch at a time.

All that is written carries a checksum: see `executive.log.mcap_reader`. Schemas and channels are in
two chunks, so that a damaged one does not take the meaning of all others with it.
"""

import io
import tempfile
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import LIBRARY_IDENTIFIER
from numpy.typing import NDArray

from pcpc.drivers.errors import Exit, UserError
from pcpc.drivers.machine.regular_files import show_being_written
from pcpc.executive.log.mcap_records import CRC_KEY, MAGIC, message_dtype, metadata_crc

CHUNK_BYTES = 1 << 20


class RecordError(UserError):
    """The log cannot be written; LOSS: the disk has no room."""

    code = Exit.ENVIRONMENT


class _ChunkIndices:
    """What the summary says of every chunk: on the disk until then, in 0.2 kB instead of 1.

    So a recorder does not grow with its run. In memory where the log's folder takes no such file.
    """

    def __init__(self, folder: Path) -> None:
        self.count = 0
        try:
            self._file: IO[bytes] = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115
        except OSError:
            self._file = io.BytesIO()

    def append(self, index: ChunkIndex) -> None:
        """Keep the index of one chunk more."""
        self._file.write(_bytes_of(index))
        self.count += 1

    def __iter__(self) -> Iterator[bytes]:
        self._file.seek(0)
        while data := self._file.read(1 << 16):
            yield data
        self._file.close()


class BulkWriter:
    """Writes the file that mcap's Writer would, many messages at once: 2 us each instead of 7."""

    def __init__(self, path: Path) -> None:
        self.file = path.open("wb")
        show_being_written(self.file)
        self._crc = 0  # of the data so far, then of the summary
        self._chunk = RecordBuilder()
        self._places: dict[int, list[NDArray[np.uint64]]] = {}  # of messages in it
        self._first_ns, self._last_ns = 1 << 64, 0
        self._counts = Counter[int]()  # messages by channel
        self._chunks = _ChunkIndices(path.parent)
        kinds = Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX
        self._summary: dict[Opcode, list[bytes]] = {kind: [] for kind in kinds}
        self._in_one_chunk: list[bytes] = []  # schemas and channels

    def _write(self, data: bytes) -> tuple[int, int]:
        """Write records; return where, and how many bytes they are."""
        place = self.file.tell()
        self._crc = zlib.crc32(data, self._crc)
        self.file.write(data)
        return place, len(data)

    def start(self, profile: str, library: str = LIBRARY_IDENTIFIER) -> None:
        """Begin the file."""
        self._write(MAGIC + _bytes_of(Header(profile, library)))

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Add a metadata record, with its checksum as an entry."""
        record = Metadata(name, data | {CRC_KEY: metadata_crc(name, data)})
        place, size = self._write(_bytes_of(record))
        index = MetadataIndex(place, size, name)
        self._summary[Opcode.METADATA_INDEX].append(_bytes_of(index))

    def add_attachment(
        self, create_time: int, log_time: int, name: str, media_type: str, data: bytes
    ) -> None:
        """Add a file; times in ns."""
        record = Attachment(create_time, log_time, name, media_type, data)
        place, size = self._write(_bytes_of(record))
        index = AttachmentIndex(place, size, log_time, create_time, len(data), name, media_type)
        self._summary[Opcode.ATTACHMENT_INDEX].append(_bytes_of(index))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Return the id of a new schema, which will be in two chunks."""
        number = len(self._summary[Opcode.SCHEMA]) + 1
        return self._explain(Opcode.SCHEMA, Schema(number, data, encoding, name))

    def register_channel(
        self, topic: str, encoding: str, schema_id: int, metadata: dict[str, str]
    ) -> int:
        """Return the id of a new channel, which will be in two chunks."""
        number = len(self._summary[Opcode.CHANNEL]) + 1
        return self._explain(Opcode.CHANNEL, Channel(number, topic, encoding, metadata, schema_id))

    def _explain(self, kind: Opcode, record: Schema | Channel) -> int:
        data = _bytes_of(record)
        self._chunk.write(data)
        if self._chunk.count > CHUNK_BYTES:
            self._end_chunk()
        self._in_one_chunk.append(data)
        self._summary[kind].append(data)
        return record.id

    def register(self, name: str, schema: str, text: str, encoding: str) -> int:
        """Register a topic with its schema (`encoding` cdr or json); return the channel id."""
        kind = {"cdr": "ros2msg", "json": "jsonschema"}[encoding]
        schema_id = self.register_schema(schema, kind, text.encode())
        return self.register_channel(name, encoding, schema_id, {})

    def flush(self) -> None:
        """End the chunk and hand all to the kernel; the next repeats schemas and channels once."""
        has_ended = self._end_chunk()
        self.file.flush()
        if has_ended:
            self._chunk.write(b"".join(self._in_one_chunk))
            self._in_one_chunk = []

    def add(self, messages: Sequence[NDArray[Any]]) -> None:
        """Append message records (n,) of `message_dtype` to one chunk, an array a channel."""
        if self._chunk.count + sum(array.nbytes for array in messages) > CHUNK_BYTES:
            self.flush()
        for array in messages:
            if count := len(array):
                places = np.empty((count, 2), np.uint64)
                places[:, 0] = array["log_time"]
                places[:, 1] = self._chunk.count + array.itemsize * np.arange(count)
                self._places.setdefault(int(array["channel"][0]), []).append(places)
                self._chunk.write(array.tobytes())

    def _end_chunk(self) -> bool:
        """Write the chunk and what finds its messages; return False if it has none."""
        if not self._places:
            return False
        data = self._chunk.end()
        indices = {n: np.concatenate(pieces) for n, pieces in self._places.items()}
        self._places = {}
        self._counts.update({number: len(places) for number, places in indices.items()})
        first_ns = int(min(places[:, 0].min() for places in indices.values()))
        last_ns = int(max(places[:, 0].max() for places in indices.values()))
        self._first_ns, self._last_ns = min(first_ns, self._first_ns), max(last_ns, self._last_ns)
        packed = zstandard.compress(data)
        chunk = Chunk("zstd", packed, last_ns, first_ns, zlib.crc32(data), len(data))
        place, size = self._write(_bytes_of(chunk))
        records, ends = RecordBuilder(), dict[int, int]()
        for number, places in indices.items():
            ends[number] = place + size + records.count
            _write_index(records, number, places.tobytes())
        _, length = self._write(records.end())
        index = ChunkIndex(
            size, place, "zstd", len(packed), last_ns, length, ends, first_ns, len(data)
        )
        self._chunks.append(index)
        return True

    def finish(self) -> None:
        """Write the chunk and the summary; the file stays open."""
        self._end_chunk()
        self._write(_bytes_of(DataEnd(self._crc)))
        start, self._crc = self.file.tell(), 0
        groups = self._summary_groups()
        offsets = [
            _bytes_of(SummaryOffset(kind, self.file.tell(), sum(self._write(x)[1] for x in data)))
            for kind, data in groups.items()
        ]
        place, _ = self._write(b"".join(offsets))
        crc = zlib.crc32(_bytes_of(Footer(start, place, 0))[:-4], self._crc)  # of all before it
        self._write(_bytes_of(Footer(start, place, crc)) + MAGIC)

    def _summary_groups(self) -> dict[Opcode, Iterable[bytes]]:
        """Return the records of the summary by kind, in their order."""
        schemas, channels, attachments, metadata = self._summary.values()
        statistics = Statistics(
            attachment_count=len(attachments),
            channel_count=len(channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunks.count,
            message_count=self._counts.total(),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns if self._counts else 0,
            metadata_count=len(metadata),
            schema_count=len(schemas),
        )
        return {
            Opcode.SCHEMA: schemas,
            Opcode.CHANNEL: channels,
            Opcode.STATISTICS: [_bytes_of(statistics)],
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.ATTACHMENT_INDEX: attachments,
            Opcode.METADATA_INDEX: metadata,
        }


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()
    return data


def _write_index(stream: RecordBuilder, channel: int, places: bytes) -> None:
    """Write where a chunk has a channel's messages: pairs of log time and offset, 8 bytes each."""
    stream.start_record(Opcode.MESSAGE_INDEX)
    stream.write2(channel)
    stream.write4(len(places))
    stream.write(places)
    stream.finish_record()


def message_records(
    channel: int, cycle: NDArray[np.int64], log_ns: NDArray[np.int64], data: NDArray[np.uint8]
) -> NDArray[Any]:
    """Return message records (n,); `cycle`, `log_ns` (n,), `data` (n, payload bytes)."""
    out = np.empty(len(data), message_dtype(data.shape[1]))
    out["opcode"], out["channel"] = Opcode.MESSAGE, channel
    out["length"] = out.dtype.itemsize - 9
    out["sequence"] = cycle & 0xFFFFFFFF
    out["log_time"] = out["publish_time"] = log_ns
    out["data"] = data
    return out
