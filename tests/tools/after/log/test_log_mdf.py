"""`pcpc log export` and `import` of MDF 4: others read what the log holds, we read theirs."""

import csv
import json
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import can
import canedge
import numpy as np
import pytest
from asammdf import MDF, Signal
from logcommand import DBC, barrel_log, run, run_here
from numpy.typing import NDArray

from pcpc.drivers.can.wire_layout import Flag
from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import export, recording, series
from pcpc.tools.after.log.readers import child, measurement
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress

# these would run for ever in this process
OWN_READERS = ("test_a_block_that_declares_too_much_or_names_itself_ends_its_reader",)
# what asammdf leaves of a damaged file prints a traceback, which its reader's process hides
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
ODD = [np.nan, np.inf, -np.inf, -0.0, 5e-324, 0.1]
EDGES = {"time_ns": 1_760_000_000_999_999_999, "cycle": 2**40}


def exported(folder: Path, *words: str | Path) -> Path:
    """Export a log, of the barrel unless one is named, as MDF."""
    path = folder / "t.mf4"
    log = words if words and isinstance(words[0], Path) else (barrel_log(), *words)
    done = run("export", *log, "-o", path)
    assert done.code == 0, done
    return path


def odd_log(frames: NDArray[Any]) -> logs.Log:
    """Return a log of six rows with a variable of odd values, and of these frames."""
    stamps = 10**6 * np.arange(6)
    about: Any = {"variables": [["a.odd", "m/s²", "state", "a", 'what is odd: "<&>"']]}
    node = logs.NodeLog(
        EDGES["cycle"] + np.arange(6), stamps, {"a.odd": np.array(ODD)}, {}, frames, [], [], about
    )
    facts = {"clock_wall_ns": str(EDGES["time_ns"]), "clock_monotonic_ns": "0"}
    return logs.Log(Path("made.mcap"), {"executive": node}, {}, {"executive": facts}, [])


def written(log: logs.Log, path: Path) -> Path:
    """Write a log that is in memory."""
    form, window = export.FORMATS[path.suffix], (-np.inf, np.inf)
    job = export._Job(log, path, form, None, window, export.Progress(quiet=True))
    (export._write_mf4 if form == "mf4" else export._write_table)(job)
    return path


def same_as_csv(mdf: Path, table: Path) -> int:
    """Compare all columns and rows bit for bit; return how many there are."""
    with table.open(newline="") as file:
        header, *rows = csv.reader(file)
    with MDF(mdf) as read:
        names = [name.split(" ", 1) for name in header]
        assert [c.name for c in read.groups[0].channels][1:] == [name for name, _ in names]
        for (name, unit), *texts in zip(names, *rows, strict=True):
            signal = read.get(name, group=0)
            kind = int if name in EDGES else float
            assert signal.samples.tobytes() == np.array([kind(t) for t in texts]).tobytes(), name
            assert series.label(signal.unit) == unit, (name, signal.unit, unit)
    return len(header) * len(rows)


def test_every_variable_is_that_of_the_csv_to_the_bit(tmp_path: Path) -> None:
    path = exported(tmp_path)
    assert run("export", barrel_log(), "-o", tmp_path / "t.csv").code == 0
    assert same_as_csv(path, tmp_path / "t.csv") > 300 * 100
    log = logs.read(barrel_log()).node["executive"]
    with MDF(path) as read:
        signal = read.get("controller.e_rad")
        help_ = next(v[4] for v in log.description["variables"] if v[0] == signal.name)
    assert signal.timestamps.tobytes() == ((log.stamp_ns - log.stamp_ns[0]) / 1e9).tobytes()
    assert signal.comment == help_ and help_, signal


def test_values_that_are_no_numbers_stay_what_they_are(tmp_path: Path) -> None:
    log = odd_log(np.zeros(0, logs.FRAME))
    path, table = (written(log, tmp_path / f"odd.{kind}") for kind in ("mf4", "csv"))
    assert same_as_csv(path, table) == 18
    with MDF(path) as read:
        assert read.header.abs_time == EDGES["time_ns"], read.header
        signal = read.get("a.odd")
    assert signal.samples.tobytes() == np.array(ODD).tobytes(), signal.samples
    assert (signal.unit, signal.comment) == ("m/s²", 'what is odd: "<&>"'), signal


def test_frames_are_those_of_the_candump_export(tmp_path: Path) -> None:
    path = exported(tmp_path)
    assert run("export", barrel_log(), "-o", tmp_path / "t.log").code == 0
    pair = [list(can.LogReader(tmp_path / name)) for name in ("t.log", "t.mf4")]
    assert len(pair[0]) > 1000, len(pair[0])
    # us: candump rounds to one, python-can's reader the start of the recording; float64 adds 0.24
    for ours, theirs in zip(*pair, strict=True):
        assert theirs.equals(ours, timestamp_delta=1.5e-6, check_channel=False), (ours, theirs)
    log = logs.read(barrel_log()).node["executive"]
    stamp_ns = np.sort(log.frames["stamp_ns"]) - log.stamp_ns[0]
    with MDF(path) as read:
        (place,) = [i for i, g in enumerate(read.groups) if g.channel_group.acq_name == "CAN"]
        group = read.groups[place]
        exact = read.get("Timestamp", group=place).timestamps
        assert exact.tobytes() == (stamp_ns / 1e9).tobytes(), exact
        source = group.channel_group.acq_source
        assert source is not None and (source.source_type, source.bus_type) == (2, 2), source
        assert group.channels[0].name == "Timestamp", group.channels[0]
        assert read.bus_logging_map["CAN"], "asammdf sees no bus logging"


def test_fd_extended_and_remote_frames_stay_what_they_are(tmp_path: Path) -> None:
    frames = np.zeros(5, logs.FD_FRAME)
    frames["id"] = 1 << 31 | 0x1FFFFFFF, 0x123, 1 << 30 | 0x321, 0x7FF, 0
    frames["dlc"], frames["direction"] = (64, 12, 3, 8, 0), (0, 1, 1, 0, 1)
    frames["flags"] = 4 | 1, 4 | 2, 0, 0, 4
    frames["data"] = np.arange(64) * (np.arange(64) < frames["dlc"][:, None])
    frames["data"][2], frames["stamp_ns"] = 0, np.arange(5) * 1_000_001
    path = written(odd_log(frames), tmp_path / "fd.mf4")
    for row, read in zip(frames, can.LogReader(path), strict=True):
        assert read.equals(export.message(row, read.timestamp), check_channel=False), (row, read)
    with MDF(path) as file:
        codes = file.get("CAN_DataFrame.DLC").samples.tolist()
    assert codes == [15, 9, 8, 0], codes


def test_events_and_tunings_are_markers(tmp_path: Path) -> None:
    rig = tmp_path / "run"
    words = "simulate", "slew10", "-o", rig, "--quiet", "--no-figure", "--set", "duration_s=0.1"
    assert run_here(*words).code == 1, "too short to be judged"
    path = exported(tmp_path, rig)
    told = run(
        "export", "-o-", rig, "--topics", "/events", "/tunings", "/plant/events", "/plant/tunings"
    )
    expected = [json.loads(line) for line in told.out.splitlines()]
    with MDF(path) as read:
        found = [(event.sync_base, json.loads(event.comment)) for event in read.events]
        assert read.events[0].name == "state READY", read.events[0]
        assert {event.event_type for event in read.events} == {6}
    assert sorted(round(1e9 * one.pop("time_s")) for one in expected) == [at for at, _ in found]
    assert sorted(map(json.dumps, expected)) == sorted(json.dumps(one) for _, one in found)


@pytest.mark.parametrize(
    "words",
    [
        ["--topics", "/timing"],
        ["--topics", "/plant/can/frames"],
        ["--start", "0.1", "--end", "0.15"],
    ],
)
def test_a_part_holds_nothing_else(words: list[str], tmp_path: Path) -> None:
    timing = next(iter(logs.read(barrel_log()).node["executive"].timing))
    with MDF(exported(tmp_path, *words)) as read:
        names = {channel.name for group in read.groups for channel in group.channels}
        rows = read.groups[0].channel_group.cycles_nr
    assert (timing in names) == ("/timing" in words), names
    assert ("CAN_DataFrame" in names) == ("/timing" not in words), names
    assert ("time.t_s" in names) == ("--topics" not in words) == (rows == 50), (names, rows)


def recorded(path: Path) -> list[can.Message]:
    """Write a recording as python-can does, in three channel groups; return its data frames."""
    start_s = 1_760_000_000.25
    messages = [
        can.Message(start_s + 1e-3 * i, (0x120, 0x12345)[i % 2], i % 2 == 1, i == 5, i == 6,
                    data=b"" if i == 5 else bytes([i] * 8), channel=3, is_rx=i % 3 > 0)
        for i in range(20)
    ]  # fmt: skip
    with can.Logger(path) as writer:
        for message in messages:
            writer.on_message_received(message)
    return [m for m in messages if not (m.is_remote_frame or m.is_error_frame)]


def test_a_recording_of_python_can_is_imported(tmp_path: Path) -> None:
    messages = recorded(tmp_path / "theirs.mf4")
    words = "--dbc", DBC, "-o", tmp_path / "i.mcap"
    done = run("import", tmp_path / "theirs.mf4", *words)
    assert done.code == 0 and "left out: 1 error, 1 remote frames" in done.out, done
    frames = logs.read(tmp_path / "i.mcap").node["executive"].frames
    assert frames["id"].tolist() == [m.arbitration_id | m.is_extended_id << 31 for m in messages]
    assert frames["data"].tobytes() == b"".join(bytes(m.data) for m in messages)
    assert frames["direction"].tolist() == [m.is_rx for m in messages]
    off = np.abs(frames["stamp_ns"] / 1e9 - [m.timestamp for m in messages]).max()
    assert off < 2e-6, f"a stamp is off by {off} s"


def test_a_recording_of_a_canedge_that_lost_its_power_is_imported(tmp_path: Path) -> None:
    sent = [
        (20 * i, (0x120, 0x12345)[i % 2], i % 2 == 1, i % 3 == 0, bytes(range(i % 9)))
        for i in range(2500)
    ]
    canedge.write(tmp_path / "ce.mf4", sent)
    done = run("import", tmp_path / "ce.mf4", "--dbc", DBC, "-o", tmp_path / "i.mcap", "--json")
    assert done.code == 0 and json.loads(done.out)["channels"] == {"1": 2500}, done
    frames = logs.read(tmp_path / "i.mcap").node["executive"].frames
    found = [
        ((int(f["stamp_ns"]) - canedge.START_NS) // 50_000, int(f["id"]) & 0x1FFFFFFF,
         bool(f["id"] >> 31), not f["direction"], f["data"][: f["dlc"]].tobytes())
        for f in frames
    ]  # fmt: skip
    assert found == sent, next(pair for pair in zip(found, sent, strict=True) if pair[0] != pair[1])
    leftovers = list(Path(tempfile.gettempdir()).glob("*_ce.mf4"))
    assert not leftovers, leftovers


_BUS = {"BusChannel": 3, "ID": 0x100, "IDE": 0, "DLC": 2, "DataLength": 2, "Dir": 0}
_FD = _BUS | {"EDL": 1, "BRS": 1, "DLC": 15, "DataLength": 64}
_BYTES = bytes(range(0x11, 0x51))
_HEX = _BYTES.hex().upper()


def without(row: dict[str, Any], *keys: str) -> dict[str, Any]:
    return {key: value for key, value in row.items() if key not in keys}


@pytest.mark.parametrize(
    ("row", "room", "expected"),
    [  # members that others leave out, or write in another way; bytes that there is room for
        (_BUS, 8, "100#1112 R"),
        (without(_BUS, "IDE"), 8, "100#1112 R"),
        (without(_BUS, "IDE") | {"ID": 0x7FF}, 8, "7FF#1112 R"),
        (without(_BUS, "IDE") | {"ID": 0x800}, 8, "00000800#1112 R"),
        (without(_BUS, "IDE") | {"ID": 0x98FEF100}, 8, "18FEF100#1112 R"),
        (_BUS | {"ID": 0x98FEF100}, 8, "18FEF100#1112 R"),
        (_BUS | {"IDE": 1}, 8, "00000100#1112 R"),
        (_BUS | {"ID": 0x800}, 8, "no id of 11 bits: 0x800"),
        (without(_BUS, "ID"), 8, "'ID'"),
        (without(_BUS, "BusChannel", "Dir"), 8, "100#1112 R"),
        (without(_BUS, "DataLength"), 8, "100#1112 R"),
        (without(_BUS, "DataLength") | {"DLC": 15}, 8, f"100#{_HEX[:16]} R"),
        (without(_BUS, "DataLength", "DLC"), 3, "100#111213 R"),
        (_BUS | {"DLC": 9, "DataLength": 12}, 8, f"100#{_HEX[:16]} R"),
        (_BUS | {"EDL": 0, "DLC": 9, "DataLength": 12}, 64, f"100#{_HEX[:16]} R"),
        (_BUS, 1, "1 of 2 bytes"),
        (_BUS | {"Dir": 1}, 8, "100#1112 T"),
        (_BUS | {"Dir": b"Tx"}, 8, "100#1112 T"),
        (_BUS | {"Dir": "RX"}, 8, "100#1112 R"),
        (_BUS | {"RTR": 1}, 8, "remote"),
        (_FD, 64, f"100##1{_HEX} R"),
        (_FD, 8, "8 of 64 bytes"),
        (_FD | {"BRS": 0, "ESI": 1, "DataLength": 1}, 8, "100##211 R"),
        (without(_FD, "EDL", "BRS") | {"DataLength": 12}, 64, f"100##0{_HEX[:24]} R"),
        (without(_FD, "EDL", "BRS") | {"DataLength": 8}, 64, f"100#{_HEX[:16]} R"),
        (without(_FD, "DataLength", "BRS") | {"DLC": 9}, 64, f"100##0{_HEX[:24]} R"),
        (without(_FD, "DataLength", "EDL"), 64, f"100##1{_HEX} R"),
    ],
)
def test_a_frame_of_bus_logging_is_read_by_the_members_that_it_has(
    row: dict[str, Any], room: int, expected: str
) -> None:
    row = row | {"DataBytes": np.frombuffer(_BYTES[:room], np.uint8)}
    try:
        found = measurement.frame_of(0, "", row)
    except (ValueError, KeyError) as error:
        assert str(error) == expected
        return
    digits = f"{found.number:0{8 if found.extended else 3}X}"
    mark = f"##{found.flags & 3}" if found.flags & Flag.FD else "#"
    text = f"{digits}{mark}{found.data.hex().upper()} {'TR'[found.is_received]}"
    assert (found.kind or text) == expected
    assert found.channel == (str(row["BusChannel"]) if "BusChannel" in row else None)


def test_groups_of_others_are_read_without_a_source_and_one_odd_frame_refuses_none(
    tmp_path: Path,
) -> None:
    path, day_s = tmp_path / "a.mf4", 86_400.0
    groups: list[tuple[str, dict[str, Any], float]] = [
        ("CAN_DataFrame", _BUS | {"ID": 0x101}, 2.0),
        ("CAN_DataFrame", without(_BUS, "BusChannel"), 1.0),
        ("CAN_DataFrame", _BUS, np.nan),
        ("CAN_DataFrame", _BUS, 1e9 * day_s),
        ("CAN_DataFrame", without(_BUS, "ID"), 1.0),
        ("CAN_ErrorFrame", {"BusChannel": 1}, 0.0),
        ("CAN_RemoteFrame", {"ID": 5}, 0.0),
        ("CAN_OverloadFrame", {"BusChannel": 1}, 0.0),
        ("LIN_Frame", {"ID": 5}, 0.0),
    ]
    with MDF(version="4.10") as file:
        for name, row, at_s in groups:
            samples = np.zeros(1, [*((f"{name}.{key}", "<u4") for key in row),
                                   (f"{name}.DataBytes", "u1", (8,))])  # fmt: skip
            for key, value in row.items():
                samples[f"{name}.{key}"] = value
            file.append(Signal(samples, np.array([at_s]), name=name), common_timebase=True)
            file.groups[-1].channel_group.flags = 2 | 4  # of a bus, and not decoded
        file.save(path)
    found = recording.read(path, None, Progress(quiet=True))
    assert found.frames["id"].tolist() == [0x100, 0x101], "by their time"
    account = found.account
    assert account.left_out == {"error": 1, "remote": 1, "overload": 1} and account.others == 1
    damage = ("2: a stamp of nan s", "3: a stamp of 8.6", "4: it has no ID")
    for said, place in zip(account.damage, damage, strict=True):
        assert said.startswith(f"CAN_DataFrame 1 of group {place}"), said


def test_a_missing_asammdf_is_named_with_its_cure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.mf4").touch()
    monkeypatch.setitem(sys.modules, "asammdf", None)
    done = run("import", tmp_path / "a.mf4", "--dbc", DBC, "-o", tmp_path / "i.mcap")
    assert done.code == 4 and done.err.startswith("MDF needs asammdf: "), done


def refused(path: Path) -> str:
    """Import what cannot be; return the one line that is said."""
    done = run("import", path, "--dbc", DBC, "-o", path.with_name("i.mcap"))
    assert done.code == 2 and done.out == "" and done.err.count("\n") == 1, done
    assert str(path) in done.err and not path.with_name("i.mcap").exists(), done
    return done.err


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_a_measurement_without_bus_logging_is_refused(version: Any, tmp_path: Path) -> None:
    with MDF(version=version) as file:
        file.append(Signal(np.arange(3.0), np.arange(3.0), name="speed"))
        saved = file.save(tmp_path / "a.dat")
    saved.rename(tmp_path / "a.mf4")
    assert "without bus logging of CAN" in refused(tmp_path / "a.mf4")


@pytest.mark.parametrize("kind", ["empty", "foreign", "cut", "half a block", "frames", "link"])
def test_damage_is_one_line_without_a_traceback(kind: str, tmp_path: Path) -> None:
    path = exported(tmp_path)
    data = bytearray(path.read_bytes())
    groups = [at.start() for at in re.finditer(b"##CG", data)]
    block = data.index(b"##DZ")
    if kind == "frames":  # more are declared than there are
        data[groups[-1] + 80 : groups[-1] + 88] = (10**6).to_bytes(8, "little")
    elif kind == "link":
        data[groups[0] + 24 : groups[0] + 32] = (1 << 40).to_bytes(8, "little")
    else:
        data = {"empty": b"", "foreign": b"MDF? no, a text\n" * 99, "cut": data[: len(data) // 2],
                "half a block": data[: block + 99]}[kind]  # fmt: skip
    path.write_bytes(data)
    said = refused(path)
    assert "damaged after" in said and "Traceback" not in said, said


def frames_of_an_export() -> NDArray[Any]:
    """Return 64 frames, a millisecond apart."""
    frames = np.zeros(64, logs.FRAME)
    frames["id"], frames["dlc"], frames["stamp_ns"] = 0x120, 8, 10**6 * np.arange(64)
    return frames


@pytest.mark.parametrize(
    ("block", "field", "value", "said"),
    [
        ("##CG", 80, 10**9, "damaged after 64 frames"),
        *(pytest.param(*case, marks=pytest.mark.deep) for case in (
            ("##CG", 80, 2**64 - 1, "damaged after 64 frames"),
            ("##DG", 24, None, "its reader hangs after 0 frames"),
            ("##CG", 24, None, "its reader hangs after 0 frames"),
            ("##CN", 24, None, "its reader hangs after 0 frames"),
            ("##CN", 32, None, "damaged after 0 frames"),
            ("##FH", 24, None,  # whichever limit comes first: time, or memory, by where it lacks
             "(hangs|than 700 MiB of memory|damaged|crashed by SIG[A-Z]+) after 0 frames"),
            ("##TX", 8, 2**40, "damaged after 0 frames"),
            ("##DZ", 32, 2**40, "damaged after 0 frames"),
        )),
    ],
)  # fmt: skip
def test_a_block_that_declares_too_much_or_names_itself_ends_its_reader(
    block: str, field: int, value: int | None, said: str, tmp_path: Path
) -> None:
    path = written(odd_log(frames_of_an_export()), tmp_path / "t.mf4")
    data = bytearray(path.read_bytes())
    place = data.rindex(block.encode())
    data[place + field : place + field + 8] = (value or place).to_bytes(8, "little")
    path.write_bytes(data)
    limits = child.ReaderLimits(700 << 20, 20 << 20, 4.0)  # memory, files, time without a frame
    with pytest.raises(LogCommandError, match=said):
        recording.read(path, None, Progress(quiet=True), limits)


@pytest.mark.parametrize(
    ("of", "values", "left_out"),
    [
        ("stamp_ns", 86_400 * 10**9 * np.arange(64), ""),
        ("stamp_ns", 10**6 * np.arange(64)[::-1], ""),
        ("dlc", 3, ""),  # what lies behind the length is no data
        ("id", np.where(np.arange(64) < 9, 0x60000004, 0x120), "9 error"),
        ("id", np.where(np.arange(64) < 9, 0x40000120, 0x120), "9 remote"),
    ],
)
def test_frames_of_any_kind_are_those_that_an_export_declares(
    of: str, values: Any, left_out: str, tmp_path: Path
) -> None:
    frames = frames_of_an_export()
    frames["data"], frames[of] = 7, values
    done = run("import", written(odd_log(frames), tmp_path / "m.mf4"), "-o", tmp_path / "i.mcap")
    assert (done.code, done.err) == (0, ""), done
    assert f"left out: {left_out} frames" in done.out or not left_out, done


@pytest.mark.parametrize("kind", ["whole", "a bit", "a group"])
def test_frames_that_are_not_those_of_the_export_are_a_loss(kind: str, tmp_path: Path) -> None:
    path = written(odd_log(frames_of_an_export()), tmp_path / "made.mf4")
    if kind != "whole":
        with MDF(path) as read, MDF(version="4.10") as changed:
            changed.header.comment, bits = read.header.comment, read.get("CAN_DataFrame")
            if kind == "a group":
                bits = bits.cut(0.0, 0.031)
            else:
                bits.samples["CAN_DataFrame.DataBytes"][7, 3] ^= 1
            source = read.groups[1].channel_group.acq_source
            changed.append(bits, acq_name="CAN", acq_source=source)
            changed.save(path, overwrite=True)
    done = run("import", path, "--dbc", DBC, "-o", tmp_path / "i.mcap")
    assert done.code == (0 if kind == "whole" else 3), done
    assert ("not the frames that it declares (64 data frames, CRC-32 " in done.out) == bool(
        done.code
    )
    assert ("not the 64 data frames, CRC-32 " in done.err) == bool(done.code), done
