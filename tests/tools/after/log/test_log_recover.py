"""`pcpc log recover`: what is readable becomes a whole file, and the damaged one stays as it is."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from logcommand import PLANT, barrel_log, run
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory

from pcpc.executive.log import reader as logs
from pcpc.executive.log.recorder import Recorder
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import load_rig


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return a log of 2,000 cycles as a recorder leaves it that is killed after 1,000 of them."""
    path = tmp_path_factory.mktemp("killed") / "log.mcap"
    rig = load_rig(PLANT / "rigs" / "slew10.yaml", "pd", ["duration_s=2.0"])
    run = VirtualRun(rig, path)
    assert isinstance(run.recorder, Recorder)
    next(run.advance())
    run.recorder.writer.flush()
    content = path.read_bytes()
    run.close()
    return content


def test_killed_log_becomes_one_that_every_reader_opens(killed: bytes, tmp_path: Path) -> None:
    path, out = tmp_path / "log.mcap", tmp_path / "log-recovered.mcap"
    path.write_bytes(killed)
    done = run("recover", path)
    assert done.code == 0 and "executive: 1000 cycles, 1 s" in done.out, done
    assert "nothing is readable after byte" in done.err and path.read_bytes() == killed
    with out.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        count = sum(1 for _ in reader.iter_decoded_messages("/state"))
    before, after = logs.read(path), logs.read(out)
    assert count == 1000 and after.missing == before.missing, f"{count} messages; {after.missing}"
    for name, node in before.node.items():
        for column, values in node.columns.items():
            new = after.node[name].columns[column]
            assert np.array_equal(values.view(np.int64), new.view(np.int64)), column
        assert np.array_equal(node.frames, after.node[name].frames)
    assert after.attachments == before.attachments
    assert "nothing is readable" in after.metadata["recovered"]["missing 1"]


def test_nothing_is_overwritten(killed: bytes, tmp_path: Path) -> None:
    path, out = tmp_path / "log.mcap", tmp_path / "precious.mcap"
    path.write_bytes(killed)
    out.write_bytes(b"precious")
    done = run("recover", path, "-o", out)
    assert done.code == 2 and out.read_bytes() == b"precious", done
    assert "exists" in done.err and done.err.count("\n") == 1, done.err
    assert run("recover", path, "-o", path).code == 2 and path.read_bytes() == killed


@pytest.mark.parametrize("size", [0, 100, 5000])
def test_log_of_which_nothing_is_left_gives_no_file(
    size: int, killed: bytes, tmp_path: Path
) -> None:
    (tmp_path / "log.mcap").write_bytes(killed[:size])
    done = run("recover", tmp_path / "log.mcap")
    assert done.code == 2 and done.err.count("\n") == 1, done
    assert os.listdir(tmp_path) == ["log.mcap"], f"{os.listdir(tmp_path)}"


def test_report_tells_what_was_kept(tmp_path: Path) -> None:
    done = run("recover", barrel_log("pd"), "-o", tmp_path / "new.mcap", "--json")
    report = json.loads(done.out)
    assert report["nodes"]["plant"] == {"cycles": 301, "seconds": 0.301}, f"{report}"
    assert report["missing"] == [] and report["messages"]["/can/frames"] > 1000


def test_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    done = run("recover", barrel_log("pd"), "-o", tmp_path / "none" / "new.mcap")
    assert done.code == 2 and done.err.count("\n") == 1, done
    assert str(tmp_path / "none" / "new.mcap") in done.err, done.err


def of_another_tool(path: Path, crcs: bool = True) -> bytes:
    """Write a log as another tool does that adds things of its own; return its bytes."""
    with barrel_log("pd").open("rb") as source, path.open("wb") as file:
        reader, writer = make_reader(source), Writer(file, 64 << 10, enable_data_crcs=crcs)
        writer.start("ros2", "another tool")
        for note in reader.iter_metadata():
            writer.add_metadata(note.name, note.metadata)
        writer.add_metadata("note of mine", {"text": "two\nlines"})
        for one in reader.iter_attachments():
            writer.add_attachment(1, 2, one.name, one.media_type, one.data)
        writer.add_attachment(5, 6, "photo.png", "image/png", b"\x89PNG")
        schema = writer.register_schema("mine", "jsonschema", b"{}")
        own = [writer.register_channel("/mine", "json", schema, {"robot": n}) for n in "ab"]
        own += [writer.register_channel("/bare", "json", 0)]
        own += [writer.register_channel("/lost", "json", 77)]
        channels: dict[str, int] = {}
        for i, (kind, channel, message) in enumerate(reader.iter_messages(log_time_order=False)):
            assert kind is not None
            if channel.topic not in channels:
                number = writer.register_schema(kind.name, kind.encoding, kind.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", number)
            at = channels[channel.topic], message.log_time, message.data, message.log_time
            writer.add_message(*at, message.sequence)
            for number in own if i % 100 == 0 else ():
                writer.add_message(number, message.log_time, b"{}", message.log_time)
        writer.add_metadata("late", {"a": "b"})
        writer.finish()
    return path.read_bytes()


def contents(path: Path) -> tuple[dict[str, int], dict[str, dict[str, str]], list[str]]:
    """Return messages by topic and what robot, metadata, attachments as mcap reads them."""
    with path.open("rb") as file:
        reader, count = make_reader(file), dict[str, int]()
        for _, channel, _ in reader.iter_messages():
            name = channel.topic + channel.metadata.get("robot", "")
            count[name] = count.get(name, 0) + 1
        notes = {one.name: one.metadata for one in reader.iter_metadata()}
        return count, notes, [one.name for one in reader.iter_attachments()]


@pytest.mark.parametrize("part", [1.0, 0.6])
def test_what_another_tool_has_added_is_kept(part: float, tmp_path: Path) -> None:
    path, out = tmp_path / "log.mcap", tmp_path / "new.mcap"
    whole = of_another_tool(path)
    path.write_bytes(whole[: int(part * len(whole))])
    done = run("recover", path, "-o", out)
    count, notes, files = contents(out)
    assert done.code == 0 and count["/minea"] == count["/mineb"] == count["/bare"] > 10
    assert f"missing: /lost: {count['/bare']} messages, whose schema is not readable" in done.err
    assert f" {sum(count.values())} messages" in done.out
    assert notes["note of mine"]["text"] == "two\nlines" and files[-1] == "photo.png"
    kept = ["note of mine", "late"][: 1 + (part == 1.0)]
    assert [line for line in done.err.splitlines() if "kept" in line] == [
        f"kept as it reads, no checksum proves it: metadata {name!r} of another tool"
        for name in kept
    ]
    said = [text for key, text in notes["recovered"].items() if key.startswith("unproved")]
    assert said == [f"metadata {name!r} of another tool" for name in kept]
    assert not any("note of mine" in line for line in logs.read(out).missing)


def test_a_metadata_of_our_own_without_its_checksum_is_not_believed(tmp_path: Path) -> None:
    path, out = tmp_path / "log.mcap", tmp_path / "new.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for name in ("plant_2", "variables:/state", "run", "away", "frames", "import", "b", "c"):
            writer.add_metadata(name, {"pacing": "real"})
        number = writer.register_channel("/x", "json", 0)
        writer.add_message(number, 1, b"{}", 1)
        writer.finish()
    done = run("recover", path, "-o", out)
    assert set(contents(out)[1]) == {"b", "c", "recovered"}
    assert done.err.count(": no checksum proves them") == 6, done.err


@pytest.mark.parametrize("crcs", [True, False])
def test_in_a_whole_log_the_checksum_of_all_data_proves_them(crcs: bool, tmp_path: Path) -> None:
    of_another_tool(tmp_path / "log.mcap", crcs)
    lines = [line for line in logs.read(tmp_path / "log.mcap").missing if "another tool" in line]
    what = "metadata 'note of mine', 'late', 2 in all, of another tool: no checksum proves them"
    assert lines == ([] if crcs else [f"{what}; `pcpc log recover` keeps them"])


def test_a_file_without_a_checksum_is_left_out_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    whole = of_another_tool(path)
    at = whole.index(b"\x89PNG") + 4
    path.write_bytes(whole[:at] + bytes(4) + whole[at + 4 :])
    done = run("recover", path, "-o", tmp_path / "new.mcap")
    assert done.code == 0 and "attachment at byte" in done.err
    assert "('photo.png' has no checksum)" in done.err
    assert "photo.png" not in contents(tmp_path / "new.mcap")[2]
