"""A log is the file that mcap's own Writer writes, to the byte; memory does not grow with it."""

import random
import tempfile
import tracemalloc
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from pcpc.executive.log.mcap_records import CRC_KEY, MAGIC, message_dtype, metadata_crc
from pcpc.executive.log.mcap_writer import CHUNK_BYTES, BulkWriter, message_records

CHANNELS, EACH = 8, 5


class Usual(Writer):
    """mcap's Writer, message by message; as in our logs what explains them is in two chunks."""

    def __init__(self, path: Path) -> None:
        self.file = path.open("wb")
        about: dict[str, Any] = {"compression": CompressionType.ZSTD, "enable_data_crcs": True}
        super().__init__(self.file, CHUNK_BYTES, **about)
        self.own = {name.rpartition("__")[2]: part for name, part in vars(self).items()}
        self.in_one_chunk: list[Schema | Channel] = []

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        super().add_metadata(name, data | {CRC_KEY: metadata_crc(name, data)})

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        number: int = super().register_schema(name, encoding, data)
        self.in_one_chunk.append(self.own["schemas"][number])
        return number

    def register_channel(self, *about: Any) -> int:
        number: int = super().register_channel(*about)
        self.in_one_chunk.append(self.own["channels"][number])
        return number

    def register(self, name: str, schema: str, text: str, encoding: str) -> int:
        kind = {"cdr": "ros2msg", "json": "jsonschema"}[encoding]
        return self.register_channel(
            name, encoding, self.register_schema(schema, kind, text.encode()), {}
        )

    def flush(self) -> None:
        chunk = self.own["chunk_builder"]
        has_messages = chunk.num_messages > 0
        vars(Writer)["_Writer__finalize_chunk"](self)  # `flush` came with mcap 1.5
        if has_messages:
            for record in self.in_one_chunk:
                record.write(chunk.record_writer)
            self.in_one_chunk = []

    def add(self, messages: Sequence[NDArray[Any]]) -> None:
        if self.own["chunk_builder"].count + sum(array.nbytes for array in messages) > CHUNK_BYTES:
            self.flush()
        for row in (row for array in messages for row in array):
            times = int(row["log_time"]), row["data"].tobytes(), int(row["publish_time"])
            self.add_message(int(row["channel"]), *times, int(row["sequence"]))


def many_small_chunks(writer: Any, chunks: int = 300) -> int:
    """Write small chunks; return by how many bytes the memory in use grew meanwhile."""
    ids = [writer.register(f"/t{i}", f"s{i}", "float64 x", "cdr") for i in range(CHANNELS)]
    held = 0
    for k in range(chunks):
        stamps = np.arange(EACH) + EACH * k
        data = np.full((EACH, 16), k % 256, np.uint8)
        for i in ids:
            writer.add([message_records(i, stamps, stamps, data)])
        writer.flush()
        if k == 100:  # from here on all is allocated that does not grow
            tracemalloc.start()
            held = tracemalloc.get_traced_memory()[0]
    grown = tracemalloc.get_traced_memory()[0] - held
    tracemalloc.stop()
    return grown


def nothing(writer: Any) -> None:
    """Write no message and nothing that explains one."""


def only_heads(writer: Any) -> None:
    """Write what explains messages that never come."""
    writer.register("/a", "s", "", "json")
    writer.flush()
    none = np.zeros(0, np.int64)
    writer.add([message_records(1, none, none, np.zeros((0, 8), np.uint8))])
    writer.add_metadata("none", {})
    writer.add_attachment(1, 2, "none", "", b"")


def a_large_schema(writer: Any) -> None:
    """Write a schema that a chunk has no room for; it ends with it."""
    for name in "ab":
        writer.add([some_messages(random.Random(3), 1)])
        writer.register(f"/{name}", name, "#" * CHUNK_BYTES, "cdr")
    writer.add([some_messages(random.Random(3), 1)])


def full_chunks(writer: Any, more: int = 0) -> None:
    """Fill a chunk with messages, and one that ends with heads, to `more` bytes than it takes."""
    heads = RecordBuilder()
    for record in Schema(1, b"", "ros2msg", "s"), Channel(1, "/a", "cdr", {}, 1):
        record.write(heads)
    empty = message_dtype(0).itemsize
    free = CHUNK_BYTES + more - heads.count - empty
    channel = writer.register("/a", "s", "", "cdr")
    add_zeros(writer, channel, free - empty)
    add_zeros(writer, channel, 0)
    writer.flush()  # the next chunk begins with the heads
    add_zeros(writer, channel, free - heads.count)
    writer.register("/b", "s", "", "cdr")
    add_zeros(writer, channel, 0)


def add_zeros(writer: Any, channel: int, count: int) -> None:
    """Add a message of so many bytes."""
    cycle, stamp_ns = np.zeros((2, 1), np.int64)
    writer.add([message_records(channel, cycle, stamp_ns, np.zeros((1, count), np.uint8))])


def anything(writer: Any, seed: int) -> None:
    """Write a random course of all that a log can have, past several chunks."""
    dice = random.Random(seed)
    ids = [writer.register("/first", "first", "float64 a", "cdr")]
    for number in range(60):
        match dice.randrange(12):
            case 0:
                schema = writer.register_schema(f"s{number}", "ros2msg", dice.randbytes(number))
                ids.append(writer.register_channel(f"/{number}", "cdr", schema, {"a": "\u00b5"}))
            case 1:
                writer.add_metadata(f"m{number}", {"b": "1", "a": "\u00e9" * number})
            case 2:
                writer.add_attachment(number, 2**63, f"f{number}", "text/plain", dice.randbytes(99))
            case 3:
                writer.flush()
            case _:
                writer.add(
                    [some_messages(dice, dice.choice(ids)) for _ in range(dice.randrange(4))]
                )


FULL = [partial(full_chunks, more=more) for more in (-1, 0, 1)]


def some_messages(dice: random.Random, channel: int) -> NDArray[Any]:
    """Return messages of one channel; their times rise, fall or stand."""
    count, size = dice.choice((0, 1, 7, 700)), dice.choice((0, 1, 60, 300))
    times = dice.choice((0, 5, 2**62)) + dice.choice((-1, 0, 1)) * np.arange(count)
    data = np.frombuffer(dice.randbytes(count * size), np.uint8).reshape(count, size)
    return message_records(channel, np.arange(count) + 2**32 - 3, times + count, data)


def written(path: Path, kind: type[Any], course: Callable[[Any], Any]) -> bytes:
    """Return the file of a course of calls, written by a writer of this kind."""
    writer = kind(path)
    writer.start("ros2")
    course(writer)
    writer.finish()
    writer.file.close()
    return path.read_bytes()


@pytest.mark.parametrize("course", [nothing, only_heads, a_large_schema, *FULL, *range(6)])
def test_the_file_is_as_mcap_writes_it(course: Any, tmp_path: Path) -> None:
    call = course if callable(course) else lambda writer: anything(writer, course)
    ours, usual = (written(tmp_path / of.__name__, of, call) for of in (BulkWriter, Usual))
    assert ours == usual
    with (tmp_path / "BulkWriter").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        messages, summary = list(reader.iter_messages()), reader.get_summary()
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count == len(messages)


def test_memory_does_not_grow_with_chunks(tmp_path: Path) -> None:
    grown: dict[type[Any], int] = {}

    def course(writer: Any) -> None:
        grown[type(writer)] = many_small_chunks(writer)

    ours, usual = (written(tmp_path / "x", kind, course) for kind in (BulkWriter, Usual))
    assert ours == usual
    assert grown[Usual] > 200 * 500 > 10 * grown[BulkWriter], "0.9 kB a chunk with mcap's"


def test_a_folder_that_takes_no_such_file_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = written(tmp_path / "ours", BulkWriter, lambda writer: many_small_chunks(writer, 120))

    def refused(**_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    memory = written(tmp_path / "memory", BulkWriter, lambda writer: many_small_chunks(writer, 120))
    assert memory == ours


def test_a_flush_leaves_nothing_in_the_process(tmp_path: Path) -> None:
    writer = BulkWriter(path := tmp_path / "log.mcap")
    writer.start("x")
    writer.add([some_messages(random.Random(3), writer.register("/a", "s", "", "cdr"))])
    writer.flush()
    size = path.stat().st_size
    writer.file.close()
    assert size == path.stat().st_size > len(MAGIC)
