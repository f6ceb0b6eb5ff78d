"""`pcpc log export -o -`: what is printed is what the log holds, in forms that other tools read."""

import csv
import io
import json
import math
import subprocess
from pathlib import Path

import can
import numpy as np
import pytest
from copies import program
from logcommand import barrel_log, run
from places import PATIENCE_S

from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import cat
from pcpc.tools.after.log.tally import senseless

ROOT = Path(__file__).resolve().parents[4]


@pytest.fixture(scope="module")
def log() -> logs.Log:
    return logs.read(barrel_log("pd"))


def printed(*words: str | Path, code: int = 0) -> str:
    """Return what `cat` prints of the barrel's log."""
    done = run("export", "-o-", barrel_log("pd"), *words)
    assert done.code == code, done
    return done.out


@pytest.mark.parametrize("topic", ["/state", "/plant/timing"])
def test_csv_gives_back_every_bit_under_name_and_unit(topic: str, log: logs.Log) -> None:
    head, *rows = csv.reader(io.StringIO(printed("--topics", topic)))
    node = log.node["plant" if "plant" in topic else "executive"]
    columns = node.columns if topic.endswith("state") else node.timing
    assert [name.partition(" [")[0] for name in head[2:]] == list(columns)
    assert head[:2] == ["time [s]", "cycle [1]"]
    if topic == "/state":
        assert "controller.e_rad [rad]" in head, f"{head}"
    values = np.array(rows, np.float64).T
    assert np.array_equal(values[1], node.cycle)
    for name, got, expected in zip(columns, values[2:], columns.values(), strict=True):
        assert np.array_equal(got.view(np.int64), expected.view(np.int64)), name


def test_candump_text_is_read_by_python_can_frame_by_frame(log: logs.Log, tmp_path: Path) -> None:
    text = printed("--topics", "can/frames")
    (tmp_path / "frames.log").write_text(text)
    frames = log.node["executive"].frames
    ours = [(int(f["id"]), f["data"][: f["dlc"]].tobytes()) for f in frames]
    read = list(can.CanutilsLogReader(tmp_path / "frames.log"))
    assert [(m.arbitration_id, bytes(m.data)) for m in read] == ours, f"{len(read)} frames"
    facts = log.metadata["executive"]
    offset_ns = int(facts["clock_wall_ns"]) - int(facts["clock_monotonic_ns"])
    off = [
        abs(m.timestamp - (int(f["stamp_ns"]) + offset_ns) / 1e9)
        for m, f in zip(read, frames, strict=True)
    ]
    assert max(off) < 1e-6, f"a stamp is off by {max(off)} s"
    assert text.splitlines()[2].split()[1:] == ["memory", f"080#{ours[2][1].hex().upper()}"]


def test_ndjson_holds_every_topic_by_dotted_name(log: logs.Log) -> None:
    entries = [json.loads(line) for line in printed("--format", "ndjson").splitlines()]
    count = sum(len(n.cycle) * 2 + len(n.frames) + len(n.events) for n in log.node.values())
    assert len(entries) == count, f"{len(entries)} of {count} messages"
    state = [e for e in entries if e["topic"] == "/state"]
    assert [e["controller.e_rad"] for e in state] == log.node["executive"].columns[
        "controller.e_rad"
    ].tolist()
    frame = next(e for e in entries if e["topic"] == "/can/frames" and e["name"] == "CMD")
    assert frame["id"] == "0A0" and frame["direction"] == "sent", f"{frame}"
    events = [e for e in entries if e["topic"] == "/plant/events"]
    assert [e["name"] for e in events] == [e["name"] for e in log.node["plant"].events]


def test_start_and_end_are_seconds_since_the_first_cycle() -> None:
    rows = printed("--start", "100ms", "--end", "0.15").splitlines()[1:]
    cycles = [int(row.split(",")[1]) for row in rows]
    assert cycles == list(range(100, 150)), f"{cycles}"
    frames = printed("--topics", "/can/frames", "--format", "csv", "--end", "0.003").splitlines()
    assert 5 < len(frames) < 50 and frames[0].startswith("time [s],cycle [1],id"), f"{frames}"


def test_numbers_that_json_has_not_are_text() -> None:
    entry = json.loads(cat.json_line({"a": math.nan, "b": -math.inf, "c": 1.5}))
    assert entry == {"a": "nan", "b": "-inf", "c": 1.5}, f"{entry}"


def test_closed_pipe_ends_quietly() -> None:
    log = str(barrel_log("pd"))
    words = [program(), "log", "export", log, "-o-", "--format", "ndjson"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT)
    assert process.stdout is not None and process.stderr is not None
    assert process.stdout.readline().startswith(b"{")
    process.stdout.close()
    errors = process.stderr.read()
    assert (process.wait(timeout=PATIENCE_S), errors) == (0, b""), errors


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("--topics", "/stat"), "no topic /stat; did you mean /state?"),
        (("--topics", "/state", "/timing", "--format", "csv"), "csv holds one topic"),
        (("--topics", "/state", "--format", "candump"), "candump is for frames"),
        (("--topics", "/events", "--format", "csv"), "/events has no columns"),
        (("--start", "soon"), "--start"),
    ],
)
def test_wrong_input_is_one_line(words: tuple[str, ...], part: str) -> None:
    done = run("export", "-o-", barrel_log("pd"), *words)
    assert done.code == 2 and done.out == "" and done.err.count("\n") == 1, done
    assert part in done.err, done.err


def test_damaged_log_is_printed_as_far_as_it_is_readable(tmp_path: Path) -> None:
    whole = barrel_log("pd").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) - 30])
    done = run("export", "-o-", tmp_path / "cut.mcap")
    assert done.code == 3 and done.out.count("\n") == 301, f"{done.code}, {done.err}"
    assert "damaged or cut" in done.err, done.err


def test_a_name_that_no_line_holds_is_cut() -> None:
    (line,) = senseless({"9" * 5000: 136, "/state": 0})
    assert line == f"{'9' * 77}...: 136 messages make no sense"
