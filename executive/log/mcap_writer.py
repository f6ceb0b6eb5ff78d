"""MCAP files written a batch at a time, and damaged ones written anew.

All that is written carries a checksum: see `executive.log.mcap_reader`. Schemas and channels are in
two chunks, so that a damaged one does not take the meaning of all others with it.
"""

import io
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, MessageIndex, Schema
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from pcpc.drivers.errors import Exit, UserError
from pcpc.drivers.machine.regular_files import show_being_written
from pcpc.executive.errors import code_of
from pcpc.executive.log.mcap_reader import Piece, Scan, walk
from pcpc.executive.log.mcap_records import CRC_KEY, message_dtype, metadata_crc
from pcpc.executive.rig.roles import ROLES

CHUNK_BYTES = 1 << 20
_OWN = {*ROLES, "run", "frames", "away", "import", "recovered"}  # metadata of this project


class RecordError(UserError):
    """The log cannot be written; LOSS: the disk has no room."""

    code = Exit.ENVIRONMENT


class _Index(MessageIndex):
    """A message index whose (log time, offset) pairs are arrays."""

    def __init__(self, channel_id: int) -> None:
        super().__init__(channel_id, [])
        self.pairs: list[NDArray[np.uint64]] = []

    def write(self, stream: RecordBuilder) -> None:
        body = np.concatenate(self.pairs).tobytes()
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write2(self.channel_id)
        stream.write4(len(body))
        stream.write(body)
        stream.finish_record()


class _WrittenRecords:
    """Records that are written already."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def write(self, stream: RecordBuilder) -> None:
        stream.write(self._data)


class _ChunkIndices:
    """What mcap keeps of every chunk until the end, 1 kB each: on the disk here, 0.2 kB.

    So a recorder does not grow with its run. In memory where the log's folder takes no such file.
    """

    def __init__(self, folder: Path) -> None:
        try:
            self._file: IO[bytes] = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115
        except OSError:
            self._file = io.BytesIO()

    def append(self, index: ChunkIndex) -> None:
        builder = RecordBuilder()
        index.write(builder)
        self._file.write(builder.end())

    def __iter__(self) -> Iterator[_WrittenRecords]:
        self._file.seek(0)
        while data := self._file.read(1 << 16):
            yield _WrittenRecords(data)
        self._file.close()


class BulkWriter(Writer):
    """mcap's Writer that also takes many messages at once: 2 us each with zstd instead of 7.

    The one place that uses private parts of mcap (1.6): the chunk in the making, what is kept of
    those that are done, the statistics, schemas and channels.
    """

    def __init__(self, path: Path) -> None:
        self.file = path.open("wb")
        show_being_written(self.file)
        super().__init__(
            self.file,
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        self._chunk = vars(self)["_Writer__chunk_builder"]
        self._statistics = vars(self)["_Writer__statistics"]
        vars(self)["_Writer__chunk_indices"] = _ChunkIndices(path.parent)
        self._told_once: list[Schema | Channel] = []

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Add a metadata record, with its checksum as an entry."""
        super().add_metadata(name, data | {CRC_KEY: metadata_crc(name, data)})

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """As mcap's; the schema will be in two chunks."""
        number: int = super().register_schema(name, encoding, data)
        self._told_once.append(vars(self)["_Writer__schemas"][number])
        return number

    def register_channel(
        self,
        topic: str,
        message_encoding: str,
        schema_id: int,
        metadata: dict[str, str] | None = None,
    ) -> int:
        """As mcap's; the channel will be in two chunks."""
        number: int = super().register_channel(topic, message_encoding, schema_id, metadata or {})
        self._told_once.append(vars(self)["_Writer__channels"][number])
        return number

    def flush(self) -> None:
        """End the chunk and hand all to the kernel; the next repeats schemas and channels once."""
        whole = bool(self._chunk.num_messages)
        super().flush()
        if whole:
            for record in self._told_once:
                record.write(self._chunk.record_writer)
            self._told_once = []

    def add(self, messages: Sequence[NDArray[Any]]) -> None:
        """Append message records (n,) of `message_dtype` to one chunk, an array a channel."""
        if self._chunk.count + sum(array.nbytes for array in messages) > CHUNK_BYTES:
            self.flush()
        for array in messages:
            if len(array):
                self._add(int(array["channel"][0]), array)

    def _add(self, channel: int, array: NDArray[Any]) -> None:
        chunk, statistics, times = self._chunk, self._statistics, array["log_time"]
        first, last = int(times.min()), int(times.max())
        pairs = np.empty((len(array), 2), np.uint64)
        pairs[:, 0] = times
        pairs[:, 1] = chunk.count + array.dtype.itemsize * np.arange(len(array), dtype=np.uint64)
        if channel not in chunk.message_indices:
            chunk.message_indices[channel] = _Index(channel)
        chunk.message_indices[channel].pairs.append(pairs)
        chunk.record_writer.write(array.tobytes())
        start = min(chunk.message_start_time, first) if chunk.num_messages else first
        chunk.message_start_time = start
        chunk.message_end_time = max(chunk.message_end_time, last)
        chunk.num_messages += len(array)
        start = min(statistics.message_start_time, first) if statistics.message_count else first
        statistics.message_start_time = start
        statistics.message_end_time = max(statistics.message_end_time, last)
        statistics.message_count += len(array)
        statistics.channel_message_counts[channel] += len(array)

    def register(self, name: str, schema: str, text: str, encoding: str) -> int:
        """Register a topic with its schema (`encoding` cdr or json); return the channel id."""
        kind = {"cdr": "ros2msg", "json": "jsonschema"}[encoding]
        schema_id = self.register_schema(schema, kind, text.encode())
        return self.register_channel(name, encoding, schema_id)


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


@dataclass
class Recovery:
    """What was written anew: messages by topic, what is missing, and what nothing proves."""

    messages: dict[str, int]
    missing: list[str]
    unproved: list[str]


class _Copy:
    """Writes what a scan finds, as it finds it, to a new file."""

    def __init__(self, found: Scan, writer: BulkWriter) -> None:
        self.found, self.writer = found, writer
        self.messages: dict[str, int] = {}
        self._schemas, self._channels = {0: 0}, dict[int, int]()
        self._notes = self._files = self._foreign = 0
        self.unproved: list[str] = []
        self._undescribed = Counter[str]()  # messages by topic

    def heads(self) -> None:
        """Write metadata and attachments that were found since the last call."""
        for note in self.found.metadata[self._notes :]:
            self.writer.add_metadata(note.name, note.metadata)
        for file in self.found.attachments[self._files :]:
            self.writer.add_attachment(
                file.create_time, file.log_time, file.name, file.media_type, file.data
            )
        for note in self.found.foreign[self._foreign :]:
            if is_own(note.name):
                self.found.missing.append(f"metadata {note.name!r}: no checksum proves them")
            else:
                self.writer.add_metadata(note.name, note.metadata)
                self.unproved.append(f"metadata {note.name!r} of another tool")
        self._notes, self._files = len(self.found.metadata), len(self.found.attachments)
        self._foreign = len(self.found.foreign)

    def channel(self, number: int) -> int:
        """Return the new id of a channel, 0 if the file does not describe it."""
        channel = self.found.channels.get(number)
        if channel is None or channel.schema_id not in (0, *self.found.schemas):
            return 0
        if number not in self._channels:
            if channel.schema_id not in self._schemas:
                schema = self.found.schemas[channel.schema_id]
                new = self.writer.register_schema(schema.name, schema.encoding, schema.data)
                self._schemas[schema.id] = new
            self._channels[number] = self.writer.register_channel(
                channel.topic,
                channel.message_encoding,
                self._schemas[channel.schema_id],
                channel.metadata,
            )
            self.messages.setdefault(channel.topic, 0)
        return self._channels[number]

    def add(self, number: int, piece: NDArray[np.uint8]) -> None:
        """Write messages of a channel."""
        new = self.channel(number)
        if not new:
            self._undescribed[self.found.topic(number)] += len(piece)
            return
        messages = piece.copy().view(message_dtype(piece.shape[1] - 31))[:, 0]
        messages["channel"] = new
        self.writer.add([messages])
        self.messages[self.found.channels[number].topic] += len(piece)

    def end(self) -> None:
        """Write what no message has brought; tell which messages nothing describes."""
        self.heads()
        for number in sorted(self.found.channels):
            self.channel(number)
        for name, count in sorted(self._undescribed.items()):
            if name:  # else the reader has counted them
                what = f"{name}: {count} messages, whose schema is not readable"
                self.found.missing.append(what)


def is_own(name: str) -> bool:
    """Return whether logs of this project have metadata of this name."""
    return name.startswith("variables:") or name in _OWN


def recover(path: Path, out: Path, watch: Callable[[Scan], None] = lambda found: None) -> Recovery:
    """Write what is readable of a damaged log to `out`, which is then a whole one.

    `watch` is told how far it is. Raises LogError; RecordError if `out` cannot be written.
    """
    found = Scan(copies=True)
    pieces = walk(path, found)
    begin = list(islice(pieces, 1))  # LogError comes before `out` is made
    try:
        return _write_copy(path.name, chain(begin, pieces), found, out, watch)
    except OSError as error:
        out.unlink(missing_ok=True)
        message = f"{out}: {error.strerror}; give another place with -o"
        raise RecordError(message, code_of(error)) from None
    except BaseException:  # Ctrl-C: no half file
        out.unlink(missing_ok=True)
        raise


def _write_copy(
    name: str, pieces: Iterable[Piece], found: Scan, out: Path, watch: Callable[[Scan], None]
) -> Recovery:
    writer = BulkWriter(out)
    with writer.file:
        writer.start(profile="ros2")
        copy = _Copy(found, writer)
        for number, piece in pieces:
            copy.heads()
            copy.add(number, piece)
            watch(found)
        copy.end()
        notes = {f"missing {i}": line for i, line in enumerate(found.missing, 1)}
        notes |= {f"unproved {i}": line for i, line in enumerate(copy.unproved, 1)}
        writer.flush()
        writer.add_metadata("recovered", {"from": name} | notes)
        writer.finish()
    return Recovery(copy.messages, found.missing, copy.unproved)
