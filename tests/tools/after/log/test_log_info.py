"""`pcpc log info`: what it tells is what the log holds, also of a log that is cut or not ours."""

import os
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from json_schemas import holds
from logcommand import PLANT, barrel_log, run
from mcap.reader import make_reader
from mcap.writer import Writer

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import VirtualRun, simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.log import info, tally


def told(path: Path, code: int = 0) -> dict[str, Any]:
    """Return what `--json` says of a log."""
    done = run("info", path, "--json")
    assert done.code == code, done
    return dict(holds("log info", done.out))


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a log of 50 cycles in which a parameter is tuned after 20."""
    folder = tmp_path_factory.mktemp("tuned")
    base = os.path.relpath(PLANT / "rigs" / "slew10.yaml", folder)
    (folder / "tuned.yaml").write_text(
        f"base: {base}\nrig: tuned\nduration_s: 0.05\n"
        "schedule:\n  - {at_s: 0.02, set: {controller.kv_Nms_rad: 77.5}}\n"
    )
    simulate(load_rig(folder / "tuned.yaml", "pd"), folder / "log.mcap")
    return folder


def test_counts_and_facts_are_those_of_the_log() -> None:
    report, whole = told(barrel_log("pd")), logs.read(barrel_log("pd"))
    for name, node in whole.node.items():
        cycles = {"cycles": len(node.cycle), "first": int(node.cycle[0]),
                  "last": int(node.cycle[-1]), "skipped": 0, "lost": 0}  # fmt: skip
        assert report["nodes"][name] == cycles, f"{report['nodes']}"
    names, frames = logs.frame_names(whole), whole.node["executive"].frames
    counted = Counter((names[int(f["id"])], int(f["direction"])) for f in frames)
    expected = {(name, tally.DIRECTIONS[i]): n for (name, i), n in counted.items()}
    found = {(f["name"], f["direction"]): f["count"] for f in report["frames"]}
    assert found == expected, f"{found}"
    topics = {row["topic"]: row["messages"] for row in report["topics"]}
    assert topics["/state"] == 300 and topics["/plant/can/frames"] == len(
        whole.node["plant"].frames
    )
    assert (report["rig"], report["controller"], report["pacing"]) == ("slew10", "pd", "virtual")
    assert report["bytes"] == barrel_log("pd").stat().st_size and report["missing"] == []
    held = {*whole.attachments, *whole.files}
    assert set(report["attachments"]) == held, f"{report['attachments']}"
    assert report["versions"]["mcap"] and report["start"].startswith("20"), report["start"]


def test_tunings_and_events_carry_time_name_and_value(tuned: Path) -> None:
    report = told(tuned)  # a run folder is as good as its log
    (tuning,) = report["tunings"]
    found = (tuning["node"], tuning["name"], tuning["value"], tuning["cycle"])
    assert found == ("executive", "controller.kv_Nms_rad", 77.5, 20), f"{tuning}"
    assert tuning["time_s"] == pytest.approx(0.02, abs=1.1e-3), f"{tuning}"
    states = [e["name"] for e in report["events"] if e["node"] == "executive"]
    assert states == ["READY", "RUN", "STOP"], f"{states}"
    screen = run("info", tuned).out
    assert "  state READY\n" in screen and "  state RUN\n" in screen, screen
    assert "controller.kv_Nms_rad 77.5" in screen and len(screen.splitlines()) < 50, screen


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ({"event": "state", "argument": 1, "value": 0.0, "name": "READY"}, "state READY"),
        ({"event": "fault", "argument": 9, "value": 0.0}, "fault 9"),
        ({"event": "skip", "argument": 3, "value": 0.0}, "skip 3 periods"),
        ({"event": "late", "argument": 130_200, "value": 0.0}, "late by 130.2 us"),
        ({"event": "late", "argument": "odd"}, "late by nan us"),
        ({"event": "change", "name": "controller.on", "value": 1.0}, "change controller.on 1.0"),
        ({"name": "controller.kv", "value": 2.0}, "controller.kv 2.0"),
        ({"event": "code_77", "argument": 5, "value": 0.0}, "code_77 5"),
    ],
)
def test_events_are_told_by_name(entry: dict[str, Any], text: str) -> None:
    assert info.entry_text(entry) == text


def test_cut_log_is_described_as_far_as_it_goes(tmp_path: Path) -> None:
    whole = barrel_log("pd").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) - 30])
    report = told(tmp_path / "cut.mcap", code=3)
    assert report["nodes"]["executive"]["cycles"] == 300
    assert "damaged or cut" in report["missing"][0], f"{report['missing']}"
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])  # within the only chunk
    report = told(tmp_path / "cut.mcap", code=3)
    nothing = {"cycles": 0, "first": None, "last": None, "skipped": 0, "lost": 0}
    assert report["nodes"]["executive"] == nothing, f"{report['nodes']}"
    assert report["rig"] == "slew10" and report["attachments"], f"{report}"
    assert "missing" in run("info", tmp_path / "cut.mcap").out


def test_log_without_a_cycle_is_valid(tmp_path: Path) -> None:
    empty = VirtualRun(load_rig(PLANT / "rigs" / "slew10.yaml", "pd"), tmp_path / "log.mcap")
    empty.close()
    report = told(tmp_path / "log.mcap")
    assert report["nodes"]["plant"]["cycles"] == 0 and report["bytes_per_hour"] is None
    assert "0 cycles" in run("info", tmp_path / "log.mcap").out


def without(path: Path, gone: set[int], copy: Path) -> Path:
    """Write a copy of a log without some of the executive's cycles."""
    with path.open("rb") as file, copy.open("wb") as out:
        reader, writer = make_reader(file), Writer(out)
        writer.start("ros2", "")
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages():
            if channel.id not in channels:
                own = 0
                if schema is not None:
                    own = writer.register_schema(schema.name, schema.encoding, schema.data)
                about = channel.topic, channel.message_encoding, own, channel.metadata
                channels[channel.id] = writer.register_channel(*about)
            if channel.topic != "/state" or message.sequence not in gone:
                at = channels[channel.id], message.log_time, message.data, message.log_time
                writer.add_message(*at, message.sequence)
        for text in reader.iter_metadata():
            writer.add_metadata(text.name, text.metadata)
        for one in reader.iter_attachments():
            writer.add_attachment(0, 0, one.name, one.media_type, one.data)
        writer.finish()
    return copy


def test_cycles_that_the_loop_skipped_are_told_apart_from_rows_that_are_lost(
    tmp_path: Path,
) -> None:
    base = os.path.relpath(PLANT / "rigs" / "slew10.yaml", tmp_path)
    (tmp_path / "stalls.yaml").write_text(
        f"base: {base}\nrig: stalls\nduration_s: 0.1\n"
        "faults: {it: {kind: stall, node: executive, from: 50ms, for: 5ms}}\n"
    )
    simulate(load_rig(tmp_path / "stalls.yaml", "pd"), tmp_path / "log.mcap")
    counts = {"cycles": 95, "first": 0, "last": 99, "skipped": 5, "lost": 0}
    assert told(tmp_path / "log.mcap")["nodes"]["executive"] == counts
    assert "95 cycles (0 to 99), 5 skipped\n" in run("info", tmp_path / "log.mcap").out
    fewer = without(tmp_path / "log.mcap", {7, 8}, tmp_path / "fewer.mcap")
    counts |= {"cycles": 93, "lost": 2}
    assert told(fewer, code=3)["nodes"]["executive"] == counts
    assert "93 cycles (0 to 99), 5 skipped, 2 lost" in run("info", fewer).out


def test_recordings_of_others_are_listed_and_refused(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "another library")
        schema = writer.register_schema("std_msgs/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema)
        for i in range(7):
            writer.add_message(channel, i, b"\0\1\0\0", i)
        writer.add_metadata("rosbag2", {"x": "y"})
        writer.finish()
    done = run("info", path)
    assert done.code == 2 and "/chatter  7 messages" in done.out, done
    assert "not a log of pcpc" in done.err and done.err.count("\n") == 1, done.err
    assert told(path, code=2)["topics"] == {"/chatter": 7}


def test_every_sub_command_has_help_with_an_example() -> None:
    for name in ("info", "recover", "export", "import", "plot"):
        text = run(name, "--help").out
        assert f"example:\n  pcpc log {name}" in text and "exit code: 0" in text, text
