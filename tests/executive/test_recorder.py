"""The recorder and the log: what is put into the rings is in the file, or counted as lost."""

import os
import resource
import select
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import standing
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Chunk, MessageIndex
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory

from pcpc.drivers.errors import Exit
from pcpc.executive.log import mcap_writer, recorder
from pcpc.executive.log import reader as logs
from pcpc.executive.log.recorder import Recorder
from pcpc.executive.loop import shared, sharing

PROJECT = Path(__file__).parents[2]
MONOTONIC_NS, WALL_NS = 5_000_000_123, 1_760_000_000_000_000_789
STATES = ["rx.FB_A.hub_rate", "barrel.controller.kv", "w.0", "w_0", "Ärger.2__x_", "9lives"]
WIDE = [f"x.{i}" for i in range(3000)]  # a ring of about 350 rows
TIMINGS = ["timing.wake_late_us", "timing.work_us"]
PERIOD_NS = 1_000_000


def absent(node: logs.Node) -> int:
    """Return how many cycles between the first and the last are not in the log."""
    return int(node.cycle[-1] - node.cycle[0]) + 1 - len(node.cycle)


def block_of(name: str, node: str = "executive", states: Sequence[str] = STATES) -> shared.Shared:
    """Make a block as a node does, of `states` and two timing columns."""
    variables = [
        [n, "rad/s", "state", "blocks", f"meaning of {n} # [1]\nin two lines"] for n in states
    ]
    variables += [[n, "us", "timing", "loop", ""] for n in TIMINGS]
    description: dict[str, Any] = {
        "node": node,
        "rig": "bench",
        "period_ns": PERIOD_NS,
        "variables": variables,
        "state_columns": list(states),
        "timing_columns": TIMINGS,
        "frames": {"256": "CMD_A", "257": "FB_A"},
        "attachments": {"rig.yaml": "rate_hz: 1000\n", "rig-resolved.yaml": f"# {node}\n"},
        "metadata": {
            "seed": "7",
            "clock_monotonic_ns": str(MONOTONIC_NS),
            "clock_wall_ns": str(WALL_NS),
        },
        "state_names": ["INIT", "READY", "RUN"],
        "fault_names": ["none", "STALE_FB_A"],
    }
    return standing.stand(name, description)


def put(block: shared.Shared, ring: str, row: Sequence[int]) -> None:
    """Append a row as the loop does: drop and count it when the ring is full."""
    ends, rows = block[f"{ring}_ends"], block[ring]
    if ends[shared.PUT] - block[f"{ring}_taken"][0] == len(rows):
        ends[shared.DROPPED] += 1
        return
    rows[ends[shared.PUT] % len(rows)] = row
    ends[shared.PUT] += 1


def values_of(cycle: int, count: int) -> np.ndarray:
    """Return values that differ by cycle and column; one is the canonical NaN."""
    values = np.arange(count) * 0.1 + cycle / 3
    values[0] = np.nan if cycle == 5 else values[0]
    return values


def put_cycle(block: shared.Shared, cycle: int, frames: int = 2) -> None:
    """Append one cycle's record and frames."""
    stamp = MONOTONIC_NS + cycle * PERIOD_NS
    states = len(block.description["state_columns"])
    cells = values_of(cycle, states + len(TIMINGS)).view(np.int64).tolist()
    header = shared.CDR_HEADER
    put(block, "record", [cycle, stamp, header, *cells[:states], header, *cells[states:]])
    for i in range(frames):
        word = (256 + i) | 8 << 32 | (i & 1) << 40 | 3 << 48
        put(block, "frame", [header, stamp + i, cycle, word, 0x0807060504030201 + cycle])


def put_event(block: shared.Shared, cycle: int, code: int, argument: int, value: float) -> None:
    """Append one event."""
    bits = int(np.float64(value).view(np.int64))
    put(block, "event", [MONOTONIC_NS + cycle * PERIOD_NS, cycle, code, argument, bits])


@pytest.fixture
def name() -> Iterator[str]:
    """Return a node's name of this test; what stands under it ends afterwards."""
    yield f"test-recorder-{os.getpid()}"
    standing.end_all()


@pytest.fixture
def block(name: str) -> shared.Shared:
    """Return an executive's block."""
    return block_of(name)


def record(path: Path, block: shared.Shared, cycles: range) -> None:
    """Record cycles in one go, drained every 100."""
    log = Recorder(path, [block])
    for cycle in cycles:
        put_cycle(block, cycle)
        if cycle % 100 == 99:
            log.drain()
    log.finish()


def start(path: Path, *names: str) -> subprocess.Popen[str]:
    """Start a real recorder process and wait until it says that it is ready."""
    command = [sys.executable, "-m", "pcpc.executive.log.recorder", str(path), *names]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=PROJECT,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def end(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Wait for a recorder; return its exit code and what it said on stderr."""
    _, errors = process.communicate(timeout=20)
    return process.returncode, errors


def test_state_payload_is_the_ring_row_byte_for_byte(block: shared.Shared, tmp_path: Path) -> None:
    record(tmp_path / "log.mcap", block, range(200))
    rows = block["record"][:200].view(np.uint8)
    begin, states = 8 * shared.RECORD_HEAD, 8 * len(STATES)
    state, timing = rows[:, begin - 4 : begin + states], rows[:, begin + states + 4 :]
    frames = block["frame"][:400].view(np.uint8)[:, 4:]
    for topic, expected in ("/state", state), ("/timing", timing), ("/can/frames", frames):
        written = logs.payloads(tmp_path / "log.mcap", topic)
        assert written == [row.tobytes() for row in expected], f"{topic}: {len(written)} payloads"
        assert written[0][:4] == b"\0\1\0\0", f"{topic}: CDR header {written[0][:4]!r}"


def test_ros2_decoder_reads_every_field_of_every_message(
    block: shared.Shared, tmp_path: Path
) -> None:
    record(tmp_path / "log.mcap", block, range(120))
    fields = recorder.field_names(STATES)
    timings = recorder.field_names(TIMINGS)
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
    fields = recorder.field_names([*STATES, "w.0_2", "W.0"])
    expected = ["rx_fb_a_hub_rate", "barrel_controller_kv", "w_0", "w_0_2", "rger_2_x", "v_9lives"]
    assert fields == [*expected, "w_0_2_2", "w_0_3"], f"{fields}"


def test_log_gives_back_columns_by_dotted_name_and_explains_itself(
    block: shared.Shared, tmp_path: Path
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
    block: shared.Shared, tmp_path: Path
) -> None:
    log = Recorder(tmp_path / "log.mcap", [block])
    put_event(block, 3, shared.TUNING_EVENT, 1, 0.1 + 0.2)
    put_event(block, 4, shared.STATE_EVENT, 2, 0.0)
    put_event(block, 4, shared.FAULT_EVENT, 1, float("inf"))
    put_event(block, 6, shared.SKIP_EVENT, 2, 0.0)
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


def test_ring_that_wraps_around_loses_nothing(block: shared.Shared, tmp_path: Path) -> None:
    for ring in ("record", "frame"):  # as after seven rounds, shortly before the end of the eighth
        block[f"{ring}_ends"][shared.PUT] = 8 * len(block[ring]) - 130
        block[f"{ring}_taken"][0] = 8 * len(block[ring]) - 130
    log = Recorder(tmp_path / "log.mcap", [block])
    for cycle in range(500):
        put_cycle(block, cycle)
        if cycle % 99 == 0:
            log.drain()
    log.finish()
    assert block["record_ends"][shared.PUT] % len(block["record"]) == 370
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
    assert log.dropped()["executive.record"] == 44, f"{log.dropped()}"
    assert read.metadata["run"]["dropped.executive.record"] == "44"
    assert absent(read.node["executive"]) == 44
    assert read.node["executive"].cycle[-2:].tolist() == [rows - 1, rows + 44]


def test_cycle_survives_the_32_bits_of_the_sequence(block: shared.Shared, tmp_path: Path) -> None:
    log = Recorder(tmp_path / "log.mcap", [block])
    for cycle in range(2**32 - 3, 2**32 + 3):
        put_cycle(block, cycle)
    log.finish()
    cycles = logs.read(tmp_path / "log.mcap").node["executive"].cycle
    assert cycles.tolist() == list(range(2**32 - 3, 2**32 + 3)), f"{cycles}"


TESTS = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
KILLED = """
import os, signal, sys
from pathlib import Path
sys.path[:0] = {tests!r}
from test_recorder import PERIOD_NS, block_of, put_cycle
from pcpc.executive.log.recorder import Recorder
block, now_ns = block_of({name!r}), 0
log = Recorder(Path({path!r}), [block], clock=lambda: now_ns)
for cycle in range(3700):
    now_ns = cycle * PERIOD_NS
    put_cycle(block, cycle)
    if cycle % 20 == 19:
        log.drain()
os.kill(os.getpid(), signal.SIGKILL)
"""


def killed_log(name: str, path: Path) -> None:
    """Record 3.7 s at 1 kHz on a virtual clock in a process that then kills itself."""
    code = KILLED.format(tests=TESTS, name=name, path=str(path))
    process = subprocess.run([sys.executable, "-c", code], cwd=PROJECT, timeout=60)
    assert process.returncode == -signal.SIGKILL


def test_kill_9_costs_less_than_a_second_and_the_log_can_be_recovered(
    name: str, tmp_path: Path
) -> None:
    path, whole = tmp_path / "log.mcap", tmp_path / "whole.mcap"
    killed_log(name, path)
    log = logs.read(path)
    node = log.node["executive"]
    lost_ns = 3700 * PERIOD_NS - (int(node.cycle[-1]) + 1) * PERIOD_NS
    assert 0 <= lost_ns <= 1_000_000_000, f"{lost_ns / 1e9} s missing"
    assert np.array_equal(node.cycle, np.arange(len(node.cycle)))
    assert len(log.missing) == 1 and "nothing is readable after byte" in log.missing[0], log.missing
    assert node.description["rig"] == "bench" and log.attachments["rig.yaml"]
    mcap_writer.recover(path, whole)
    assert logs.digest(path, "/state") == logs.digest(whole, "/state")
    assert logs.read(whole).missing == []
    with whole.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        count = sum(1 for _ in reader.iter_decoded_messages("/state"))
    assert count == len(node.cycle), f"{count} of {len(node.cycle)} after recovery"


def test_chunks_stay_within_1_mib_and_the_index_agrees_with_mcaps_own(
    name: str, tmp_path: Path
) -> None:
    """The test that notices a change of mcap's private parts: compared with its own Writer."""
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
    put_event(plant, 149, shared.FAULT_EVENT, 1, 0.0)
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


def test_process_records_until_the_nodes_are_done_also_a_late_plant(
    block: shared.Shared, name: str, tmp_path: Path
) -> None:
    process = start(tmp_path / "log.mcap", name, f"{name}-plant")
    process.send_signal(signal.SIGINT)  # the terminal's Ctrl-C must not end it
    for cycle in range(200):
        put_cycle(block, cycle, frames=1)
    plant = block_of(f"{name}-plant", "plant")
    for cycle in range(100):
        put_cycle(plant, cycle)
    plant["control"][shared.DONE] = block["control"][shared.DONE] = 1
    code, errors = end(process)
    assert (code, errors) == (0, ""), errors
    read = logs.read(tmp_path / "log.mcap")
    assert [len(node.cycle) for node in read.node.values()] == [200, 100]


def test_a_recorder_lets_the_executive_go_once_it_has_the_other_nodes(
    name: str, tmp_path: Path
) -> None:
    """A run may be over when it comes: with the executive its host lets the plant go."""
    description = dict(block_of(name).description)
    standing.end_all()
    executive, plant = (sharing.Served(n, description) for n in (name, f"{name}-plant"))
    for served in (executive, plant):
        served.open()
    words = [sys.executable, "-m", "pcpc.executive.log.recorder", str(tmp_path / "log.mcap")]
    process = subprocess.Popen([*words, name, f"{name}-plant"], cwd=PROJECT)
    select.select(executive.sockets(), [], [])
    executive.serve()
    select.select(plant.sockets(), [], [])  # it asks for the plant
    executive.serve()
    assert sharing.RECORDER not in executive.told
    plant.serve()
    while sharing.RECORDER not in executive.told:
        select.select(executive.sockets(), [], [])
        executive.serve()
    plant.serve()
    assert sharing.RECORDER in plant.told
    for served in (executive, plant):
        served.block["control"][shared.DONE] = 1
    assert process.wait(20.0) == 0
    for served in (executive, plant):
        served.close()


def test_process_ends_in_order_on_sigterm(block: shared.Shared, name: str, tmp_path: Path) -> None:
    process = start(tmp_path / "log.mcap", name)
    for cycle in range(200):
        put_cycle(block, cycle)
    process.terminate()
    code, errors = end(process)
    read = logs.read(tmp_path / "log.mcap")
    assert (code, errors, read.missing) == (0, "", []), errors
    assert len(read.node["executive"].cycle) == 200


NODE = """
import sys
sys.path[:0] = {tests!r}
from test_recorder import block_of, put_cycle
put_cycle(block_of({name!r}), 0)
print("stands", flush=True)
sys.stdin.read()
"""


def test_process_takes_what_is_there_and_ends_when_its_node_was_killed(
    name: str, tmp_path: Path
) -> None:
    node = subprocess.Popen(
        [sys.executable, "-c", NODE.format(tests=TESTS, name=name)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=PROJECT,
    )  # fmt: skip
    assert node.stdout is not None and node.stdout.readline() == "stands\n"
    process = start(tmp_path / "log.mcap", name)
    node.kill()
    code, errors = end(process)
    node.communicate()  # reaped only now
    assert (code, errors) == (0, ""), errors
    assert len(logs.read(tmp_path / "log.mcap").node["executive"].cycle) == 1


def test_late_node_that_ended_in_this_run_is_recorded(name: str, tmp_path: Path) -> None:
    block, plant = block_of(name), block_of(f"{name}-plant", "plant")
    plant["control"][shared.DONE] = 1
    put_cycle(plant, 1)
    log = Recorder(tmp_path / "log.mcap", [block], late=[f"{name}-plant"])
    log.finish()
    assert logs.read(tmp_path / "log.mcap").node["plant"].cycle.tolist() == [1]


def test_late_node_that_an_earlier_run_is_leaving_is_not_recorded(
    name: str, tmp_path: Path
) -> None:
    block, old = block_of(name), block_of(f"{name}-plant", "plant")
    old["control"][shared.DONE] = 1
    put_cycle(old, 1)
    old["record"][0, 1] = MONOTONIC_NS - 1  # before the executive came
    log = Recorder(tmp_path / "log.mcap", [block], late=[f"{name}-plant"])
    log.drain()
    assert len(log.nodes) == 1
    new = block_of(f"{name}-plant", "plant")
    put_cycle(new, 2)
    log.finish()
    assert logs.read(tmp_path / "log.mcap").node["plant"].cycle.tolist() == [2]


@pytest.mark.parametrize("garbage", [-1, 10**9, -(2**63), 2**63 - 1])
def test_what_others_write_into_the_taken_words_costs_no_record(
    block: shared.Shared, tmp_path: Path, garbage: int
) -> None:
    for ring in shared.RINGS:
        block[f"{ring}_taken"][0] = garbage
    log = Recorder(tmp_path / "log.mcap", [block])
    for cycle in range(300):
        for ring in shared.RINGS:
            block[f"{ring}_taken"][0] = 0  # or the bench's own ring would be full
        put_cycle(block, cycle)
        if cycle % 100 == 99:
            for ring in shared.RINGS:
                block[f"{ring}_taken"][0] = garbage
            log.drain()
    words = [int(block[f"{ring}_taken"][0]) for ring in shared.RINGS]
    assert words == [300, 600, 0], f"{words}: a loop that waits would wait for ever"
    log.finish()
    assert logs.read(tmp_path / "log.mcap").node["executive"].cycle.tolist() == list(range(300))


def test_dropped_rows_make_the_process_end_with_loss(name: str, tmp_path: Path) -> None:
    block = block_of(name, states=WIDE)
    for cycle in range(len(block["record"]) + 4):
        put_cycle(block, cycle, frames=0)
    block["control"][shared.DONE] = 1
    code, errors = end(start(tmp_path / "log.mcap", name))
    assert code == Exit.LOSS and "'executive.record': 4" in errors, errors


def run(path: Path, *names: str, file_bytes: int = -1) -> tuple[int, str]:
    """Run a recorder to its end, with a limit on the size of files; return exit code and stderr."""

    def limit() -> None:
        if file_bytes >= 0:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, file_bytes))

    command = [sys.executable, "-B", "-m", "pcpc.executive.log.recorder", str(path), *names]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=20, preexec_fn=limit, cwd=PROJECT
    )
    return done.returncode, done.stderr


def test_what_cannot_be_written_is_one_clear_line(
    block: shared.Shared, name: str, tmp_path: Path
) -> None:
    block["control"][shared.DONE] = 1
    for path, why, expected in (
        (tmp_path / "none" / "log.mcap", "No such file or directory", Exit.ENVIRONMENT),
        (Path("/dev/full"), "No space left on device", Exit.LOSS),
    ):
        code, errors = run(path, name)
        assert code == expected and errors.count("\n") == 1, errors
        assert str(path) in errors and why in errors, errors
    code, errors = run(tmp_path / "log.mcap", "test-recorder-nobody")
    assert code == Exit.ENVIRONMENT and "no such node is running" in errors, errors


def test_disk_that_fills_up_leaves_a_readable_log(name: str, tmp_path: Path) -> None:
    states = [f"x.{i}" for i in range(200)]
    block = block_of(name, states=states)
    noise = np.random.default_rng(1).standard_normal((2000, len(states))).view(np.int64)
    for cycle in range(2000):
        put_cycle(block, cycle, frames=0)
    block["record"][:2000, 3 : 3 + len(states)] = noise
    block["control"][shared.DONE] = 1
    code, errors = run(tmp_path / "log.mcap", name, file_bytes=2_000_000)
    assert code == Exit.LOSS and errors.count("\n") == 1 and "File too large" in errors, errors
    log = logs.read(tmp_path / "log.mcap")
    count = len(log.node["executive"].cycle)
    assert 500 < count < 2000 and len(log.missing) == 1, f"{count} cycles; {log.missing}"


def test_recorder_process_does_not_load_the_compiler() -> None:
    code = "import pcpc.executive.log.recorder, sys; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=PROJECT)
    assert done.stdout == "False\n", done.stdout + done.stderr


def test_what_is_no_log_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("rate_hz: 1000\n")
    (tmp_path / "empty").touch()
    with (tmp_path / "foreign").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()
    for file_name in ("text", "empty", "foreign", "none"):
        with pytest.raises(logs.LogError) as caught:
            logs.read(tmp_path / file_name)
        assert file_name in str(caught.value) and "\n" not in str(caught.value), str(caught.value)


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a good log of several chunks."""
    path = tmp_path_factory.mktemp("intact") / "log.mcap"
    block = block_of(f"test-intact-{os.getpid()}")
    now_ns = 0
    log = Recorder(path, [block], clock=lambda: now_ns)
    for cycle in range(1000):
        now_ns += PERIOD_NS
        put_cycle(block, cycle)
        if cycle % 50 == 0:
            log.drain()
    log.finish()
    standing.end_all()
    return path


def test_damaged_chunk_is_named_and_the_others_are_read(intact: Path, tmp_path: Path) -> None:
    whole = intact.read_bytes()
    place = whole.index(b"zstd") + 400
    (tmp_path / "log.mcap").write_bytes(whole[:place] + b"damage" + whole[place + 6 :])
    log = logs.read(tmp_path / "log.mcap")
    node = log.node["executive"]
    assert 0 < len(node.cycle) < 1000 and node.cycle[-1] == 999, f"{len(node.cycle)} cycles"
    lost = 1000 - len(node.cycle)
    assert "chunk at byte" in log.missing[0] and f"/state: {lost} of 1000 messages" in log.missing
    assert len(node.timing[TIMINGS[0]]) == len(node.cycle)


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_no_damage_is_a_crash_neither_in_reading_nor_in_recovery(
    intact: Path, data: st.DataObject
) -> None:
    whole = intact.read_bytes()
    damaged = bytearray(whole[: data.draw(st.integers(0, len(whole)) | st.just(len(whole)))])
    for _ in range(data.draw(st.integers(0, 3)) if damaged else 0):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = intact.with_name("damaged.mcap")
    path.write_bytes(damaged)
    try:
        log = logs.read(path)
        mcap_writer.recover(path, intact.with_name("recovered.mcap"))
        recovered = logs.read(intact.with_name("recovered.mcap"))
        for name, node in log.node.items():
            assert np.array_equal(recovered.node[name].cycle, node.cycle), f"{log.missing}"
    except logs.LogError as error:
        assert "\n" not in str(error), f"{error}"
