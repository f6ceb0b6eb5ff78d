"""Damaged logs: a value that is read is the one that was written, or it is absent and told.

The log has two nodes and three chunks, is finished or as a killed recorder leaves it, and is
damaged at seeded random places: a byte replaced by another, or the file cut.
"""

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import standing
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rings import PERIOD_NS, block_of, put_cycle, put_event

from pcpc.executive.log import mcap_reader, mcap_writer, recovery
from pcpc.executive.log import reader as logs
from pcpc.executive.log.recorder import FLUSH_NS, Recorder
from pcpc.executive.loop.events import Event

PLACES = 500  # of each kind of log and damage
RECOVERED = 10  # every tenth is also recovered and read with mcap's own readers
CYCLES = 30
NAMES = [f"x.{i}" for i in range(4)]


@dataclass(frozen=True)
class Written:
    """A log as bytes, and what was written into it."""

    data: bytes
    log: logs.Log


def record(path: Path, name: str) -> Iterator[bytes]:
    """Record two nodes in three chunks; yield the file before and after its end was written."""
    now_ns = 0
    nodes = [block_of(name, states=NAMES), block_of(f"{name}-plant", "plant", NAMES)]
    recorder = Recorder(path, nodes, clock=lambda: now_ns)
    for cycle in range(CYCLES):
        now_ns = (cycle + 1) * 3 * FLUSH_NS // CYCLES
        for node in nodes:
            put_cycle(node, cycle, frames=1)
        if cycle % 7 == 3:
            put_event(nodes[0], cycle, Event.TUNING, 1, cycle / 3)
            put_event(nodes[1], cycle, Event.STATE, 2, 0.0)
        if now_ns - recorder.flushed_ns >= FLUSH_NS:
            recorder.drain()
    yield path.read_bytes()
    recorder.finish()
    yield path.read_bytes()


@pytest.fixture(scope="module")
def logs_written(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Written]:
    """Return the same run as a finished log and as one without an end."""
    name, folder = f"test-damage-{os.getpid()}", tmp_path_factory.mktemp("intact")
    found = {}
    try:
        for kind, data in zip(("unfinished", "finished"), record(folder / "x", name), strict=True):
            (folder / kind).write_bytes(data)
            found[kind] = Written(data, logs.read(folder / kind))
    finally:
        standing.end_all()
    return found


def compared(got: Any, whole: Any, what: str) -> int:
    """Return how many of the values in `whole` are absent in `got`; AssertionError at a wrong one.

    Both are dictionaries, or lists without an order.
    """
    if isinstance(whole, dict):
        for key, value in got.items():
            assert key in whole and value == whole[key], f"{what}: {key} is {value!r}"
    else:
        wrong = Counter(got) - Counter(whole)
        assert not wrong, f"{what}: {wrong} was not written"
    return len(whole) - len(got)


def values(node: logs.NodeLog) -> dict[str, Any]:
    """Return all of a node in comparable form: columns by name, each bit for bit by cycle."""
    columns = {"cycle": node.cycle, "stamp_ns": node.stamp_ns} | node.columns | node.timing
    bits = {name: array.view(np.int64).tolist() for name, array in columns.items()}
    by_cycle = {name: dict(zip(bits["cycle"], row, strict=True)) for name, row in bits.items()}
    return by_cycle | {
        "frames": [frame.tobytes() for frame in node.frames],
        "events": [repr(event) for event in node.events],
        "tunings": [repr(tuning) for tuning in node.tunings],
        "description": node.description,
    }


def absent(got: logs.Log, whole: logs.Log) -> int:
    """Return how many values are absent in a damaged log; AssertionError at a wrong one."""
    known = {k: v for k, v in got.metadata.items() if k != "recovered"}
    count = compared(got.attachments, whole.attachments, "attachments")
    count += compared(known, whole.metadata, "metadata")
    for name, node in whole.node.items():
        if name not in got.node:
            count += 1
            continue
        expected, found = values(node), values(got.node[name])
        if len(got.node[name].cycle) == 0:  # then columns have no names, or no values
            found = {key: value for key, value in found.items() if key in expected}
        assert found.keys() <= expected.keys(), f"{found.keys() - expected.keys()}"
        count += len(expected) - len(found)
        count += sum(compared(found[key], expected[key], f"{name}: {key}") for key in found)
    return count


def check(path: Path, written: Written) -> tuple[int, int]:
    """Read a damaged log; return how many values are absent, and the cycles of both nodes."""
    log = logs.read(path)
    lost = absent(log, written.log)
    told = [line for line in log.missing if "\n" not in line]
    extra = set(told) - set(written.log.missing)
    assert extra or not lost, f"{lost} values are absent without a word"
    return lost, sum(len(node.cycle) for node in log.node.values())


def check_recovered(path: Path, written: Written, cycles: int) -> None:
    """Recover a damaged log; mcap's own readers and ours read all of the result."""
    out = path.with_name("recovered.mcap")
    recovered = recovery.recover(path, out)
    with out.open("rb") as file:
        topics = Counter(
            c.topic for _, c, _ in make_reader(file, validate_crcs=True).iter_messages()
        )
        file.seek(0)
        records = list(StreamReader(file, validate_crcs=True).records)
    assert topics == +Counter(recovered.messages), f"{topics}, not {recovered.messages}"
    assert topics["/state"] + topics["/plant/state"] == cycles, f"{topics}, not {cycles} cycles"
    assert len(records) > topics.total(), f"{len(records)} records"
    again = logs.read(out)
    absent(again, written.log)
    assert set(again.missing) <= set(logs.read(path).missing), f"{again.missing}"


@pytest.mark.parametrize("kind", ["finished", "unfinished"])
def test_a_damaged_byte_never_gives_a_wrong_value(
    kind: str, logs_written: dict[str, Written], tmp_path: Path
) -> None:
    written, random, path = logs_written[kind], np.random.default_rng(1), tmp_path / "log.mcap"
    harmless = 0
    for number in range(PLACES):
        data = bytearray(written.data)
        place = int(random.integers(len(data)))
        data[place] ^= int(random.integers(1, 256))
        path.write_bytes(data)
        lost, cycles = check(path, written)
        harmless += lost == 0
        if number % RECOVERED == 0:
            check_recovered(path, written, cycles)
    assert 0 < harmless < PLACES * 2 / 3, f"{harmless} of {PLACES} flips cost nothing"


@pytest.mark.parametrize("kind", ["finished", "unfinished"])
def test_a_cut_never_gives_a_wrong_value(
    kind: str, logs_written: dict[str, Written], tmp_path: Path
) -> None:
    written, random, path = logs_written[kind], np.random.default_rng(2), tmp_path / "log.mcap"
    refused = 0
    for number in range(PLACES):
        size = int(random.integers(len(written.data)))
        path.write_bytes(written.data[:size])
        try:
            _, cycles = check(path, written)
        except logs.LogError as error:
            assert "\n" not in str(error) and size < 3000, f"{size} bytes: {error}"
            refused += 1
            continue
        if number % RECOVERED == 0:
            check_recovered(path, written, cycles)
    assert 0 < refused < PLACES / 2, f"{refused} of {PLACES} cuts leave nothing"


def test_a_damaged_byte_costs_at_most_one_chunk(
    logs_written: dict[str, Written], tmp_path: Path
) -> None:
    """Also in the first chunk, which explains all others, or in a length, of a killed recorder."""
    written, path = logs_written["unfinished"], tmp_path / "log.mcap"
    chunk = written.data.index(b"\4\0\0\0zstd") - 37  # opcode of the first
    for place in (chunk, chunk + 1, chunk + 4, chunk + 7, chunk + 30, chunk + 37, chunk + 99):
        data = bytearray(written.data)
        data[place] ^= 0x41
        path.write_bytes(data)
        cycles = logs.read(path).node["executive"].cycle
        assert len(cycles) >= CYCLES * 6 // 10, f"byte {place}: only cycles {cycles} are left"
        assert cycles[-1] == CYCLES - 1, f"byte {place}: {cycles}"


def test_a_zeroed_block_is_told_and_all_else_is_read(
    logs_written: dict[str, Written], tmp_path: Path
) -> None:
    written, path = logs_written["finished"], tmp_path / "log.mcap"
    for begin in range(8, len(written.data) - 64, 256):
        data = bytearray(written.data)
        data[begin : begin + 64] = bytes(64)
        path.write_bytes(data)
        log = logs.read(path)
        absent(log, written.log)
        assert log.missing, f"zeros at {begin} are not told"


def test_stamps_are_those_of_the_run(logs_written: dict[str, Written]) -> None:
    stamps = logs_written["finished"].log.node["executive"].stamp_ns
    assert np.array_equal(np.diff(stamps), np.full(CYCLES - 1, PERIOD_NS)), f"{stamps}"


@pytest.mark.parametrize("is_open", [True, False])
def test_a_log_that_is_being_written_is_no_killed_one(is_open: bool, tmp_path: Path) -> None:
    writer = mcap_writer.BulkWriter(path := tmp_path / "log.mcap")
    writer.start("pcpc", "test")
    writer.file.flush()
    if not is_open:
        writer.file.close()
    said = " ".join(mcap_reader.scan(path).missing)
    writer.file.close()
    assert ("it is still being written" in said) == is_open, said
    assert ("recorder killed" in said) != is_open, said
