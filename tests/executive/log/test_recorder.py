"""The recorder and the log: what is put into the rings is in the file, or counted as lost."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, MessageIndex
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rings import (
    MONOTONIC_NS,
    PERIOD_NS,
    STATES,
    TIMINGS,
    WALL_NS,
    WIDE,
    absent,
    block_of,
    put_cycle,
    put_event,
    record,
    values_of,
)

from pcpc.executive.log import reader as logs
from pcpc.executive.log.recorder import Recorder
from pcpc.executive.log.run_counts import RunCounts
from pcpc.executive.log.schemas import field_names
from pcpc.executive.loop import shared
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.ring_layout import RECORD_HEAD, OfFrame


def test_state_payload_is_the_ring_row_byte_for_byte(
    block: shared.NodeMemory, tmp_path: Path
) -> None:
    record(tmp_path / "log.mcap", block, range(200))
    rows = block["record"][:200].view(np.uint8)
    begin, states = 8 * RECORD_HEAD, 8 * len(STATES)
    state, timing = rows[:, begin - 4 : begin + states], rows[:, begin + states + 4 :]
    frames = block["frame"][:400].view(np.uint8)[:, 4:]
    for topic, expected in ("/state", state), ("/timing", timing), ("/can/frames", frames):
        written = logs.payloads(tmp_path / "log.mcap", topic)
        assert written == [row.tobytes() for row in expected], f"{topic}: {len(written)} payloads"
        assert written[0][:4] == b"\0\1\0\0", f"{topic}: CDR header {written[0][:4]!r}"


def test_frames_of_an_id_are_counted_whatever_their_flags_and_length() -> None:
    """A sender that is error-passive sets a flag of CAN FD."""
    counts, rows = RunCounts({"node": "plant", "variables": []}), np.zeros((6, 5), np.int64)
    for row, flags in zip(rows, (0, 4, 5, 7, 6, 7), strict=True):
        row[OfFrame.ABOUT] = 0x121 | (8 + flags) << 32 | (flags & 1) << 40 | flags << 56
    counts.add("frame", rows)
    assert counts.frame_counts() == {"plant.sent.121": 3, "plant.received.121.0": 3}


def test_ros2_decoder_reads_every_field_of_every_message(
    block: shared.NodeMemory, tmp_path: Path
) -> None:
    record(tmp_path / "log.mcap", block, range(120))
    fields = field_names(STATES)
    timings = field_names(TIMINGS)
    seen = {"/state": 0, "/timing": 0, "/can/frames": 0}
    with (tmp_path / "log.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for _, channel, message, decoded in reader.iter_decoded_messages():
            cycle, topic = message.sequence, channel.topic
            expected = values_of(cycle, len(STATES) + len(TIMINGS))
            if topic == "/can/frames":
                i = seen[topic] % 2
                assert (decoded.cycle, decoded.id, decoded.dlc) == (cycle, 256 + i, 8)
                assert (decoded.direction, decoded.e2e, decoded.reserved) == (i, 3, 0)
                assert bytes(decoded.data) == (0x0807060504030201 + cycle).to_bytes(8, "little")
                assert message.log_time == decoded.stamp_ns - MONOTONIC_NS + WALL_NS
            else:
                names = fields if topic == "/state" else timings
                expected = expected[: len(STATES)] if topic == "/state" else expected[len(STATES) :]
                got = [getattr(decoded, field) for field in names]
                assert np.array_equal(got, expected, equal_nan=True), f"{topic} {cycle}: {got}"
                assert message.log_time == message.publish_time == WALL_NS + cycle * PERIOD_NS
            seen[topic] += 1
    assert seen == {"/state": 120, "/timing": 120, "/can/frames": 240}, f"{seen}"


def test_field_names_are_valid_and_unique() -> None:
    fields = field_names([*STATES, "w.0_2", "W.0"])
    expected = ["rx_fb_a_hub_rate", "barrel_controller_kv", "w_0", "w_0_2", "rger_2_x", "v_9lives"]
    assert fields == [*expected, "w_0_2_2", "w_0_3"], f"{fields}"


def test_log_gives_back_columns_by_dotted_name_and_explains_itself(
    block: shared.NodeMemory, tmp_path: Path
) -> None:
    record(tmp_path / "log.mcap", block, range(300))
    log = logs.read(tmp_path / "log.mcap")
    node = log.node["executive"]
    expected = np.array([values_of(c, len(STATES) + len(TIMINGS)) for c in range(300)]).T
    assert list(node.columns) == STATES and list(node.timing) == TIMINGS
    assert np.array_equal([*node.columns.values(), *node.timing.values()], expected, equal_nan=True)
    assert np.array_equal(node.cycle, np.arange(300))
    assert np.array_equal(node.stamp_ns, MONOTONIC_NS + PERIOD_NS * np.arange(300))
    assert np.array_equal(node.frames["cycle"], np.arange(600) // 2)
    assert node.frames.dtype == logs.FRAME and set(node.frames["id"].tolist()) == {256, 257}
    assert log.attachments["rig.yaml"] == "rate_hz: 1000\n"
    assert node.description["fault_names"] == ["none", "STALE_FB_A"]
    assert log.metadata["executive"]["seed"] == "7" and log.metadata["executive"]["rig"] == "bench"
    assert log.metadata["run"]["written.executive.record"] == "300", f"{log.metadata['run']}"
    assert log.missing == [] and absent(node) == 0


def test_events_and_tunings_keep_name_cycle_and_exact_value(
    block: shared.NodeMemory, tmp_path: Path
) -> None:
    log = Recorder(tmp_path / "log.mcap", [block])
    put_event(block, 3, Event.TUNING, 1, 0.1 + 0.2)
    put_event(block, 4, Event.STATE, 2, 0.0)
    put_event(block, 4, Event.FAULT, 1, float("inf"))
    put_event(block, 6, Event.SKIP, 2, 0.0)
    put_event(block, 6, 77, 9, -0.0)
    log.finish()
    node = logs.read(tmp_path / "log.mcap").node["executive"]
    at = {c: MONOTONIC_NS + c * PERIOD_NS for c in (3, 4, 6)}
    tuning = {"cycle": 3, "stamp_ns": at[3], "name": "barrel.controller.kv", "value": 0.1 + 0.2}
    assert node.tunings == [tuning], f"{node.tunings}"
    got = [tuple(e.get(k) for k in ("event", "name", "argument", "value")) for e in node.events]
    assert got == [
        ("state", "RUN", 2, 0.0),
        ("fault", "STALE_FB_A", 1, "inf"),
        ("skip", None, 2, 0.0),
        ("code_77", None, 9, -0.0),
    ], f"{got}"


def test_ring_that_wraps_around_loses_nothing(block: shared.NodeMemory, tmp_path: Path) -> None:
    for ring in ("record", "frame"):  # as after seven rounds, shortly before the end of the eighth
        block.ends(ring).head = 8 * len(block[ring]) - 130
        block[f"{ring}_taken"][0] = 8 * len(block[ring]) - 130
    log = Recorder(tmp_path / "log.mcap", [block])
    for cycle in range(500):
        put_cycle(block, cycle)
        if cycle % 99 == 0:
            log.drain()
    log.finish()
    assert block.ends("record").head % len(block["record"]) == 370
    node = logs.read(tmp_path / "log.mcap").node["executive"]
    assert np.array_equal(node.cycle, np.arange(500)), f"{len(node.cycle)} cycles"
    assert np.array_equal(node.frames["cycle"], np.arange(1000) // 2)
    assert np.array_equal(node.columns[STATES[1]], [values_of(c, 2)[1] for c in range(500)])


def test_overflow_is_counted_exactly_and_seen_in_the_sequence(name: str, tmp_path: Path) -> None:
    block = block_of(name, states=WIDE)
    rows = len(block["record"])
    log = Recorder(tmp_path / "log.mcap", [block])
    for cycle in range(rows + 44):
        put_cycle(block, cycle, frames=0)
    assert log.drain(), "a full ring asks to be drained again at once"
    put_cycle(block, rows + 44)
    assert not log.drain()
    log.finish()
    read = logs.read(tmp_path / "log.mcap")
    assert log.dropped_rows()["executive.record"] == 44, f"{log.dropped_rows()}"
    assert read.metadata["run"]["dropped.executive.record"] == "44"
    assert absent(read.node["executive"]) == 44
    assert read.node["executive"].cycle[-2:].tolist() == [rows - 1, rows + 44]


def test_cycle_survives_the_32_bits_of_the_sequence(
    block: shared.NodeMemory, tmp_path: Path
) -> None:
    log = Recorder(tmp_path / "log.mcap", [block])
    for cycle in range(2**32 - 3, 2**32 + 3):
        put_cycle(block, cycle)
    log.finish()
    cycles = logs.read(tmp_path / "log.mcap").node["executive"].cycle
    assert cycles.tolist() == list(range(2**32 - 3, 2**32 + 3)), f"{cycles}"


def test_chunks_stay_within_1_mib_and_the_index_agrees_with_mcaps_own(
    name: str, tmp_path: Path
) -> None:
    """The summary of a recorder's log is that of mcap's own Writer, in chunks of at most 1 MiB."""
    path, plain = tmp_path / "log.mcap", tmp_path / "plain.mcap"
    block = block_of(name, states=[f"x.{i}" for i in range(200)])
    record(path, block, range(2000))
    with path.open("rb") as file, plain.open("wb") as out:
        reader, writer = make_reader(file, validate_crcs=True), Writer(out)
        ours = reader.get_summary()
        assert ours is not None and ours.statistics is not None
        writer.start("ros2")
        for schema in ours.schemas.values():
            writer.register_schema(schema.name, schema.encoding, schema.data)
        for channel in ours.channels.values():
            writer.register_channel(channel.topic, channel.message_encoding, channel.schema_id)
        for _, channel, message in reader.iter_messages():
            writer.add_message(
                channel.id, message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()
    largest = max(index.uncompressed_size for index in ours.chunk_indexes)
    assert len(ours.chunk_indexes) > 2 and largest <= 1 << 20, f"{largest} bytes"
    with plain.open("rb") as file:
        theirs = make_reader(file).get_summary()
    assert theirs is not None and theirs.statistics is not None
    for key in (
        "message_count",
        "channel_message_counts",
        "message_start_time",
        "message_end_time",
    ):
        assert getattr(ours.statistics, key) == getattr(theirs.statistics, key), key
    assert indexed_times(path) == indexed_times(plain)
    for topic in ("/state", "/timing", "/can/frames"):
        assert logs.digest(path, topic) == logs.digest(plain, topic), topic


def test_a_chunk_is_half_a_second_old_when_it_ends(
    block: shared.NodeMemory, tmp_path: Path
) -> None:
    now_ns = 0
    log = Recorder(tmp_path / "log.mcap", [block], clock=lambda: now_ns)
    for cycle in range(2000):
        put_cycle(block, cycle)
        now_ns += PERIOD_NS
        if cycle % 20 == 19:
            log.drain()
    log.finish()
    with (tmp_path / "log.mcap").open("rb") as file:
        found = make_reader(file).get_summary()
    assert found is not None
    ends_s = sorted(round(1e-9 * one.message_end_time, 2) for one in found.chunk_indexes)
    assert np.diff(ends_s[-4:]) == pytest.approx([0.5] * 3, abs=0.03), ends_s


def indexed_times(path: Path) -> dict[int, list[int]]:
    """Return log times by channel as the message indexes have them, checked at their offsets."""
    times: dict[int, list[int]] = {}
    chunk = b""
    with path.open("rb") as file:
        for entry in StreamReader(file, emit_chunks=True).records:
            if isinstance(entry, Chunk):
                stream, size = get_chunk_data_stream(entry, validate_crc=True)
                chunk = stream.read(size)
            if isinstance(entry, MessageIndex):
                for time_ns, offset in entry.records:
                    head = np.frombuffer(chunk, logs.message_dtype(0), 1, offset)[0]
                    assert (head["channel"], head["log_time"]) == (entry.channel_id, time_ns)
                    times.setdefault(entry.channel_id, []).append(time_ns)
    return times


def test_two_nodes_share_a_file_and_the_plant_may_come_later(name: str, tmp_path: Path) -> None:
    block = block_of(name)
    log = Recorder(tmp_path / "log.mcap", [block], late=[f"{name}-plant"])
    for cycle in range(150):
        put_cycle(block, cycle)
    log.drain()
    plant = block_of(f"{name}-plant", "plant", ["barrel.angle"])
    for cycle in range(40, 150):
        put_cycle(plant, cycle)
    put_event(plant, 149, Event.FAULT, 1, 0.0)
    log.drain()
    log.finish()
    read = logs.read(tmp_path / "log.mcap")
    assert read.missing == []
    assert np.array_equal(read.node["executive"].cycle, np.arange(150))
    assert np.array_equal(read.node["plant"].cycle, np.arange(40, 150))
    assert list(read.node["plant"].columns) == ["barrel.angle"]
    assert len(read.node["plant"].frames) == 220 and len(read.node["plant"].events) == 1
    assert read.attachments["rig-resolved.yaml"] == "# executive\n"
    assert read.attachments["plant/rig-resolved.yaml"] == "# plant\n"


def test_a_drained_node_sees_the_recorder_lag_until_the_others_are_drained(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that it is patient with one that waits: the recorder may stand for seconds between."""
    blocks = [block_of(name), block_of(f"{name}-plant", "plant")]
    log = Recorder(tmp_path / "log.mcap", blocks)

    def lagging() -> list[bool]:
        return [block.ends("record").head != block["record_taken"][0] for block in blocks]

    for block in blocks:
        put_cycle(block, 0)
    before_plant: list[list[bool]] = []
    first: Any = log.nodes[1].observers[0]
    monkeypatch.setattr(first, "look", lambda: before_plant.append(lagging()) or [])
    log.drain()
    assert before_plant == [[True, True]] and lagging() == [False, False]
    log.finish()


@pytest.mark.parametrize(
    ("ended", "kept"),
    [((True, True), 0), ((True, False), 50), ((False, True), 50), ((False, False), 50)],
)
def test_the_death_of_any_node_keeps_what_came_before_it(
    ended: tuple[bool, bool], kept: int, name: str, tmp_path: Path
) -> None:
    keep = {"keep_ns": 50 * PERIOD_NS, "keep_on": ["fault"]}
    blocks = [block_of(name, **keep), block_of(f"{name}-plant", "plant", **keep)]
    log = Recorder(tmp_path / "log.mcap", blocks)
    for cycle in range(150):
        for block in blocks:
            put_cycle(block, cycle)
    for block, in_order in zip(blocks, ended, strict=True):
        block.control.pid, block.control.done = os.getpid(), int(in_order)
    log.finish()
    read = logs.read(tmp_path / "log.mcap")
    assert {role: len(node.cycle) for role, node in read.node.items()} == dict.fromkeys(
        read.node, kept
    ), read.node
    assert (read.metadata["run"]["discarded"] == "0") is False
