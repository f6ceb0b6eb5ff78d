"""What commands print with --json of odd logs, signals and runs, held against their schemas."""

from pathlib import Path

from fd_rig import fd_rig
from json_schemas import holds
from logcommand import barrel_log, run, run_here
from mcap.reader import make_reader
from mcap.writer import Writer
from motors import motors
from processes import ROOT

from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.run.check import describe
from pcpc.tools.terminal.screen import json_text

GAIN = "controller.kv_Nms_rad"
PROBE = ROOT / "plants/probe"
INFINITE = f"""\
base: {PROBE / "rig.yaml"}
duration_s: 0.2
controllers: {{proportional: {{law: "{PROBE / "law.py"}:BLOCK"}}}}
faults: {{endless: {{kind: gain, at: controller.command, value: 1, from: 0ms, for: 9ms}}}}
"""


def test_a_log_of_others(tmp_path: Path) -> None:
    foreign, cut = tmp_path / "foreign.mcap", tmp_path / "cut.mcap"
    with foreign.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "another library")
        writer.add_message(writer.register_channel("/chatter", "json", 0), 1, b"{}", 1)
        writer.finish()
    cut.write_bytes(foreign.read_bytes()[:40])
    for path, damaged in ((foreign, False), (cut, True)):
        done = run("info", path, "--json")
        assert (done.code, "damaged" in holds("log info", done.out)) == (2, damaged), done


def test_what_others_write_into_a_log(tmp_path: Path) -> None:
    whole, odd = barrel_log("pd"), tmp_path / "odd.mcap"
    entry = b'{"cycle": 1, "stamp_ns": 2, "value": NaN, "time_s": "x", "more": Infinity}'
    with whole.open("rb") as file, odd.open("wb") as out:
        reader, writer = make_reader(file), Writer(out)
        writer.start("ros2", "")
        for schema, channel, message in reader.iter_messages("/state"):
            assert schema is not None
            if message.sequence == 0:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                state = writer.register_channel("/state", channel.message_encoding, known)
                events = writer.register_channel("/events", "json", 0)
                writer.add_message(events, message.log_time, entry, message.publish_time)
            writer.add_message(state, message.log_time, message.data, message.publish_time)
        for text in reader.iter_metadata():
            writer.add_metadata(text.name, text.metadata)
        for one in reader.iter_attachments():
            writer.add_attachment(0, 0, one.name, one.media_type, one.data)
        writer.finish()
    done = run("info", odd, "--json")
    (event,) = holds("log info", done.out)["events"]
    assert (event["value"], event["time_s"]) == ("nan", 0.0), done


def test_a_replay_and_a_difference_without_end(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(INFINITE)
    done = run_here(
        "simulate",
        tmp_path / "rig.yaml",
        "-o",
        tmp_path / "a",
        "--quiet",
        "--no-figure",
        "--set",
        "controller.target=10",
    )
    assert done.code == 0, done
    done = run_here("replay", tmp_path / "a", "--json", "--quiet")
    assert all(one["identical"] for one in holds("replay", done.out)), done
    endless = "--set", "faults.endless.value=1e308"
    done = run_here("replay", tmp_path / "a", "--json", "--quiet", *endless)
    (executive, _) = holds("replay", done.out)
    assert done.code == 1 and executive["first"]["largest"] == "inf", done


def test_a_comparison_of_runs(tmp_path: Path) -> None:
    for name, more in (("old/a", ()), ("new/a", (f"{GAIN}=111",)), ("new/b", ())):
        rig = "hull" if name.endswith("b") else "slew10"
        words = [word for setting in ("duration_s=0.2", *more) for word in ("--set", setting)]
        done = run_here("simulate", rig, "-o", tmp_path / name, "--quiet", "--no-figure", *words)
        assert done.code == 1 and "verdict  not judged" in done.out, done
    done = run_here("compare", tmp_path / "old", tmp_path / "new", "--quiet", "--json", "-")
    states = {one["rig"]: one["state"] for one in holds("compare", done.out)["pairs"]}
    assert states == {"hull": "alone", "slew10": "changed"}, done


def test_a_signal_without_bounds_has_words_for_them(tmp_path: Path) -> None:
    text = (PROBE / "probe.dbc").read_text()
    old = "position : 0|32@1- (1e-06,0) [-2147.483648|2147.483647]"
    assert old in text
    text = text.replace(old, "position : 0|32@1- (1e300,0) [0|0]")
    (tmp_path / "probe.dbc").write_text(f"{text}\nSIG_VALTYPE_ 288 position : 1;\n")
    (tmp_path / "rig.yaml").write_text(f"base: {PROBE / 'rig.yaml'}\ndbc: probe.dbc\n")
    done = run_here("check", tmp_path / "rig.yaml", "--json")
    (frame,) = (
        one for one in holds("check", done.out)["nodes"]["plant"]["sends"] if one["name"] == "FB"
    )
    assert frame["scales"][0]["range"] == ["-inf", "inf"], frame


def test_several_plants_two_buses_and_fd_frames(tmp_path: Path) -> None:
    for name in ("two", "fd"):
        (tmp_path / name).mkdir()
    two, fd = motors(tmp_path / "two", 2, 1), fd_rig(tmp_path / "fd")
    buses = holds("bus", run_here("bus", two, "--json").out)["buses"]
    assert [one["name"] for one in buses] == ["bus", "second bus"]
    for path, told in ((two, "plant_2"), (fd, "plant")):
        rig = load_rig(path)
        plans = [plan(rig, role, rig.config.pacing) for role in rig.roles]
        nodes = holds("check", json_text(describe(rig, plans)))["nodes"]
        assert told in nodes, nodes
    assert any(one["bytes"] > 8 for node in nodes.values() for one in node["sends"]), nodes


def test_bounds_of_a_short_run_and_of_one_that_diverges() -> None:
    words = "bounds", "friction-c", "--set", "duration_s=0.5", "--json", "--quiet"
    short = holds("bounds", run_here(*words).out)  # it is over before the error is back in its ball
    assert short["constants"]["other_rate"] is None and short["holds"] is False
    assert holds("bounds", run_here(*words, "--set", "controller.kappa=0.0").out)["holds"] is False
