"""Whatever is in a log, each command ends in lines and a documented code, at a bounded cost."""

import json
import random
import struct
import zlib
from pathlib import Path

import commands
import corpus
import log_parts
import numpy as np
import pytest
from log_parts import chunk, finished
from mcap.records import Attachment, Metadata

from pcpc.executive.log import mcap_reader
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig

ROOT = Path(__file__).resolve().parents[2]
CASES = 45


@pytest.fixture(scope="module")
def true_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("true") / "probe.mcap"
    simulate(load_rig(ROOT / "plants/probe/rig.yaml", settings=["duration_s=0.02"]), path)
    return path


@pytest.fixture
def out(tmp_path: Path) -> Path:
    (tmp_path / "out").mkdir()
    return tmp_path / "out"


@pytest.mark.parametrize("first", range(0, CASES, 15))
def test_no_odd_log_brings_a_command_down(
    first: int, true_log: Path, tmp_path: Path, out: Path
) -> None:
    base, log = true_log.read_bytes(), tmp_path / "log.mcap"
    for number in range(first, first + 15):
        dice = random.Random(number)
        data, what = corpus.odd_log(base, dice)
        log.write_bytes(data)
        lines = commands.lines_of(log, true_log, out)
        names = [
            *dice.sample(commands.FAST, 3),
            *(["replay", "report"] if number % 15 == 0 else []),
        ]
        found = [commands.tried(lines[name], out) for name in names]
        found.append(commands.tried_to_play(log))
        assert not any(found), f"case {number}, {what}: {[one for one in found if one]}"


def changed(true_log: Path, path: Path, **kinds: object) -> log_parts.Parts:
    """Write the true log with parts replaced; return them."""
    parts = log_parts.take_apart(true_log.read_bytes())
    for name, value in kinds.items():
        setattr(parts, name, value)
    path.write_bytes(log_parts.put_together(parts))
    return parts


def every_command(log: Path, true_log: Path, out: Path) -> None:
    lines = commands.lines_of(log, true_log, out)
    found = [commands.tried(lines[name], out) for name in (*commands.FAST, "replay")]
    assert not any(found), [one for one in found if one]


def test_a_description_with_a_wrong_type_at_any_key_is_no_description(
    true_log: Path, tmp_path: Path, out: Path
) -> None:
    """Each key in turn; what is left out is told, and nothing that uses it falls."""
    parts = log_parts.take_apart(true_log.read_bytes())
    (about,) = (a for a in parts.attachments if a.name == "executive.json")
    value = json.loads(about.data)
    log = tmp_path / "log.mcap"
    dice = random.Random(1)
    for key in ("variables", "frames", "state_columns", "timing_columns", "period_ns", "metadata"):
        wrong = dice.choice([None, 5, [5], {"a": 5}, "\x1b[2J", float("nan")])
        data = json.dumps(value | {key: wrong}).encode()
        parts.attachments = [
            Attachment(0, 0, a.name, "", data) if a.name == about.name else a
            for a in parts.attachments
        ]
        log.write_bytes(log_parts.put_together(parts))
        found = logs.read(log)
        assert key not in found.node["executive"].description
        assert f"executive: {key} of its description is not readable" in found.missing
        names = ("info", "diff", "csv", "replay")
        lines = commands.lines_of(log, true_log, out)
        bad = [commands.tried(lines[name], out) for name in names]
        assert not any(bad), (key, [one for one in bad if one])


def test_frames_that_no_bus_carries_are_left_out_and_counted(
    true_log: Path, tmp_path: Path, out: Path
) -> None:
    parts = log_parts.take_apart(true_log.read_bytes())
    (frames,) = (i for i, c in parts.channels.items() if c.topic == "/can/frames")
    rows = [n for n, row in enumerate(parts.content) if row[0] == frames]
    for n, place, odd in ((0, 24, 255), (1, 25, 7), (2, 11, 0x7F), (3, 19, 0x80)):
        channel, sequence, at, data = parts.content[rows[n]]
        data = data[:place] + bytes([odd]) + data[place + 1 :]
        parts.content[rows[n]] = (channel, sequence, at, data)
    log = tmp_path / "log.mcap"
    log.write_bytes(log_parts.put_together(parts))
    whole, odd_one = logs.read(true_log), logs.read(log)
    lost = len(whole.node["executive"].frames) - len(odd_one.node["executive"].frames)
    assert (lost, len(odd_one.missing)) == (4, 1), odd_one.missing
    every_command(log, true_log, out)


def test_times_beyond_all_clocks_are_left_out(true_log: Path, tmp_path: Path, out: Path) -> None:
    parts = log_parts.take_apart(true_log.read_bytes())
    for n, at in ((3, 2**64 - 1), (40, 2**63), (77, 2**62)):
        parts.content[n] = (*parts.content[n][:2], at, parts.content[n][3])
    changed(true_log, log := tmp_path / "log.mcap", content=parts.content)
    assert "3 messages of times beyond 2116; left out" in logs.read(log).missing
    every_command(log, true_log, out)


def test_of_a_topic_no_message_has_a_time(true_log: Path, tmp_path: Path, out: Path) -> None:
    parts = log_parts.take_apart(true_log.read_bytes())
    (state,) = (i for i, c in parts.channels.items() if c.topic == "/state")
    odd = [(i, n, 2**63 if i == state else at, data) for i, n, at, data in parts.content]
    count = sum(i == state for i, *_ in odd)
    changed(true_log, log := tmp_path / "log.mcap", content=odd)
    assert f"{count} messages of times beyond 2116; left out" in logs.read(log).missing
    every_command(log, true_log, out)


@pytest.mark.parametrize("odd", [1e308, float("nan"), -1e19, float("-inf")])
def test_a_count_of_passes_that_is_none_is_a_gap(
    odd: float, true_log: Path, tmp_path: Path, out: Path
) -> None:
    parts = log_parts.take_apart(true_log.read_bytes())
    names = list(logs.read(true_log).node["executive"].timing)
    place = 4 + 8 * names.index("health.passes")
    (timing,) = (i for i, c in parts.channels.items() if c.topic == "/timing")
    n = [n for n, row in enumerate(parts.content) if row[0] == timing][7]
    *head, data = parts.content[n]
    parts.content[n] = (*head, data[:place] + struct.pack("<d", odd) + data[place + 8 :])
    changed(true_log, log := tmp_path / "log.mcap", content=parts.content)
    found = commands.tried(commands.lines_of(log, true_log, out)["replay"], out)
    assert found is None, found


@pytest.mark.parametrize("wrong", ["-1", "nan", "9" * 5000, "1e9", "0", ""])
def test_metadata_that_is_no_number_is_told(
    wrong: str, true_log: Path, tmp_path: Path, out: Path
) -> None:
    parts = log_parts.take_apart(true_log.read_bytes())
    notes = [
        Metadata(name=m.name, metadata=m.metadata | {"clock_wall_ns": wrong, "period_ns": wrong})
        if m.name == "executive"
        else Metadata(name=m.name, metadata=dict.fromkeys(m.metadata, wrong))
        if m.name == "run"
        else m
        for m in parts.metadata
    ]
    changed(true_log, log := tmp_path / "log.mcap", metadata=notes)
    assert "executive: period_ns is impossible" in logs.read(log).missing
    every_command(log, true_log, out)


def bombs() -> dict[str, bytes]:
    """Return small files that declare, or hold, much more than they are."""
    tiny = (log_parts._message(1, 7, 7, b"") + log_parts._message(2, 7, 7, b"")) * (1 << 16)
    zeros, head = bytes(9 << 20), log_parts.MAGIC
    frame = log_parts.packed(zeros, "lz4")
    # a chunk that declares 100 bytes and holds 9 MiB
    short = struct.pack("<QQQI", 0, 0, 100, zlib.crc32(zeros)) + log_parts._text("lz4")
    short = log_parts._record(6, short + struct.pack("<Q", len(frame)) + frame)
    channel = "".join(f"float64 a{n}  # b [c\n" for n in range(9)) + "float64 x  # " + " [" * 50_000
    schema = log_parts._schema(log_parts.Schema(1, channel.encode(), "ros2msg", "s"))
    alike = b"".join(
        log_parts._channel(log_parts.Channel(n, "/state", "cdr", {}, 1)) for n in range(1, 2000)
    )
    each = b"".join(log_parts._message(n, n, n, b"1234") for n in range(1, 2000))
    node = log_parts.metadata("executive", {"period_ns": "1000000"})
    lookalike = struct.pack("<BQ", 9, 300_000 - 9) + bytes(3)
    return {
        "many chunks of zeros": finished(head + node + chunk(zeros) * 10),
        "many tiny messages": finished(head + node + chunk(tiny) * 3),
        "lz4 that declares less": finished(head + node + short),
        "lz4 that declares all": finished(head + node + chunk(zeros, "lz4") * 3),
        "a declared size without data": finished(
            head + node + chunk(b"12", "zstd", 2**64 - 1) + chunk(b"12", "lz4", 2**40)
        ),
        "many channels of one topic": finished(
            head + node + chunk(schema + alike + each)
        ),
        "lookalikes": head + node + lookalike * 8_000 + bytes(300_000),
        "damage after damage": head + (node + b"\x05" + bytes(20)) * 3000,
    }  # fmt: skip


def test_a_small_file_costs_little_whatever_it_declares(
    true_log: Path, tmp_path: Path, out: Path
) -> None:
    """The work that a file makes is counted and bounded by its size; nothing is silent."""
    for name, data in bombs().items():
        log = tmp_path / "log.mcap"
        log.write_bytes(data)
        found = mcap_reader.scan(log)
        kept = sum(piece.nbytes for _, piece in found.pieces)
        assert kept <= (16 << 20) + 200 * len(data), f"{name}: {kept} bytes of {len(data)}"
        assert found.records <= 20_000 + len(data) + 256, f"{name}: {found.records} messages"
        assert found.missing and len(found.missing) < 120, f"{name}: {found.missing[:3]}"
        lines = commands.lines_of(log, true_log, out)
        bad = [commands.tried(lines[command], out) for command in ("info", "csv")]
        assert not any(bad), (name, [one for one in bad if one])


def test_a_true_log_is_far_from_the_bounds(true_log: Path) -> None:
    found = mcap_reader.scan(true_log)
    share = found.cost / (200 * found.size), found.records / found.size
    assert max(share) < 0.2 and not found.missing, f"{share} {found.missing}"


def test_a_sequence_out_of_order_is_no_wrap_of_its_counter(true_log: Path, tmp_path: Path) -> None:
    parts = log_parts.take_apart(true_log.read_bytes())
    (state,) = (i for i, c in parts.channels.items() if c.topic == "/state")
    rows = [n for n, row in enumerate(parts.content) if row[0] == state]
    for n, sequence in zip(rows, (5, 4, 2**32 - 1, 0, 1), strict=False):
        parts.content[n] = (state, sequence, *parts.content[n][2:])
    changed(true_log, log := tmp_path / "log.mcap", content=[parts.content[n] for n in rows[:5]])
    found = logs.read(log).node["executive"].cycle
    first = mcap_reader.scan(log)
    assert first.count[state] == 5
    assert found.tolist() == [] or np.array_equal(found % 2**32, [5, 4, 2**32 - 1, 0, 1]), found
