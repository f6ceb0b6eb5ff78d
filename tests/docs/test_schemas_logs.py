"""What the commands about logs print with --json, held against their schemas.

More outcomes of theirs: the tests of each command, which hold what it prints as well.
"""

from pathlib import Path

from json_schemas import holds
from logcommand import DBC, barrel_log, run, run_here
from mcap.reader import make_reader
from mcap.writer import Writer
from processes import ROOT

GAIN = "controller.kv_Nms_rad"
PROBE = ROOT / "plants/probe"
INFINITE = f"""\
base: {PROBE / "rig.yaml"}
duration_s: 0.2
controllers: {{proportional: {{law: "{PROBE / "law.py"}:BLOCK"}}}}
faults: {{endless: {{kind: gain, at: controller.command, value: 1, from: 0ms, for: 9ms}}}}
"""


def test_what_a_log_holds() -> None:
    assert holds("log info", run("info", barrel_log("pd"), "--json").out)["events"]


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


def test_a_log_is_compared_and_written_in_other_formats(tmp_path: Path) -> None:
    a, b = barrel_log("pd"), barrel_log()
    for other, code in ((a, 0), (b, 1)):
        done = run("diff", a, other, "--json")
        assert done.code == code and holds("log diff", done.out)["equal"] is (code == 0), done
    for name in ("frames.log", "frames.blf", "frames.asc", "rows.csv", "all.mf4"):
        done = run("export", a, "-o", tmp_path / name, "--json")
        assert done.code == 0 and holds("log export", done.out)["file"].endswith(name), done
    made = tmp_path / "made.mcap"
    done = run("import", tmp_path / "frames.blf", "--dbc", DBC, "-o", made, "--json")
    assert holds("log import", done.out)["frames"] > 300, done
    assert holds("log info", run("info", made, "--json").out)["pacing"] == "imported"


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
        assert done.code == 0, done
    done = run_here("compare", tmp_path / "old", tmp_path / "new", "--quiet", "--json", "-")
    states = {one["rig"]: one["state"] for one in holds("compare", done.out)["pairs"]}
    assert states == {"hull": "alone", "slew10": "changed"}, done
