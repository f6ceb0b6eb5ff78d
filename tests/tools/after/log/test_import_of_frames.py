"""`pcpc log import` without a DBC file, what it says of dates and ends, and its exit code."""

import gzip
import json
import os
from datetime import datetime
from pathlib import Path

import pytest
from json_schemas import holds
from logcommand import DBC, Done, run, run_here

from pcpc.executive.log import reader as logs

_LINES = "(1700000000.000000) can7 100#1122\n(1700000000.010000) can7 00000101##3AA\n"


def imported(folder: Path, name: str, text: str | bytes, *words: str) -> Done:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return run("import", path, "-o", folder / "o.mcap", "--force", *words)


def test_frames_alone_are_imported_shown_and_exported_again(tmp_path: Path) -> None:
    done = imported(tmp_path, "a drive.log", _LINES, "--json")
    counts = holds("log import", done.out)
    assert done.code == 0 and (counts["frames"], counts["rows"]) == (2, 0), counts
    out = tmp_path / "o.mcap"
    assert run("export", "-o-", out).out == _LINES, run("export", "-o-", out)
    assert "for 0.01 s" in run("info", out).out
    node = logs.read(out).node["executive"]
    assert node.frames["cycle"].tolist() == [0, 1] and not logs.read(out).missing
    again = tmp_path / "again.log"
    assert run("export", out, "-o", again).code == 0
    assert imported(tmp_path, "again.log", again.read_bytes()).code == 0
    assert run_here("compare", "--bits", out, out).code == 0


@pytest.mark.parametrize(("end", "code"), [("\x1a", 0), ("\r\n\x1a\r\n", 0), ("\x1a(17", 3)])
def test_the_mark_of_dos_behind_the_last_line_is_no_cut(
    end: str, code: int, tmp_path: Path
) -> None:
    done = imported(tmp_path, "a.log", _LINES + end, "--json")
    assert (done.code, json.loads(done.out)["frames"]) == (code, 2), done


def test_a_node_needs_the_file_that_names_its_frames(tmp_path: Path) -> None:
    done = imported(tmp_path, "a.log", _LINES, "--node", "ECU")
    assert done.code == 2 and "--node ECU: needs --dbc" in done.err, done


@pytest.mark.parametrize(
    ("channel", "shown"),
    [("can7", "can7"), ("0", "can0"), ("x" * 16, "can0"), ("vcan-1.2", "can0"), ("a.b", "a.b")],
)
def test_the_interface_in_a_log_of_others_is_a_name_of_one(
    channel: str, shown: str, tmp_path: Path
) -> None:
    shown = channel if channel == "vcan-1.2" else shown
    imported(tmp_path, "a drive.log", _LINES.replace("can7", channel))
    lines = run("export", "-o-", tmp_path / "o.mcap").out.splitlines()
    assert lines and all(line.split()[1:2] == [shown] for line in lines), lines


def test_of_two_channels_the_interface_is_neither(tmp_path: Path) -> None:
    imported(tmp_path, "a.log", _LINES + _LINES.replace("can7", "can8").replace("00.0", "01.0"))
    assert all(
        " can0 " in line for line in run("export", "-o-", tmp_path / "o.mcap").out.splitlines()
    )


_BODY = "0.1 1 100 Rx d 1 11\n0.2 1 100 Rx d 1 22\n"
_HEAD = "base hex  timestamps absolute\n"
_NOON_S = 1_700_130_030  # of 16 November 2023, 10:20:30 in UTC


@pytest.mark.parametrize(
    ("date", "first_s", "said"),
    [
        ("date Thu Nov 16 10:20:30.125 am 2023\n", _NOON_S + 0.125, ""),
        ("date Thu Nov 16 10:20:30 pm 2023\n", _NOON_S + 43_200, ""),
        ("date Thu Nov 16 12:20:30 am 2023\n", _NOON_S - 36_000, ""),
        ("date Don Nov 16 10:20:30.125 2023\n", _NOON_S + 0.125, ""),
        ("date Mit Okt 18 10:20:30 2023\n", _NOON_S - 29 * 86_400, ""),
        ("date 2023-11-16 10:20:30.125\n", _NOON_S + 0.125, ""),
        ("date 2023-11-16T10:20:30,125\n", _NOON_S + 0.125, ""),
        ("date Wed Nov 15 10:20:30 am 2023\nBegin TriggerBlock Thu Nov 16 10:20:30 am 2023\n",
         _NOON_S, ""),
        ("date Thu Nov 16 10:20:30 am 2023\nBegin TriggerBlock\n", _NOON_S, ""),
        ("date jeu. nov. 16 10:20:30 2023\n", 0, "its date 'jeu. nov. 16 10:20:30 2023' is not"),
        ("date Thu Nov 31 10:20:30 2023\n", 0, "is not understood: stamps count from 1970"),
        ("date Thu Nov 16 14:20:30 pm 2023\n", 0, "is not understood: stamps count from 1970"),
        ("", 0, "no date was read from it: stamps count from 1970"),
    ],
)  # fmt: skip
def test_the_date_of_an_asc_file_is_read_or_its_lack_told(
    date: str, first_s: float, said: str, tmp_path: Path
) -> None:
    end = "End TriggerBlock\n" if "Begin" in date else ""
    done = imported(tmp_path, "a.asc", date + _HEAD + _BODY + end)
    stamps = logs.read(tmp_path / "o.mcap").node["executive"].frames["stamp_ns"]
    offset_s = _local_offset_s(first_s) if first_s else 0.0
    assert abs(stamps[0] / 1e9 - (first_s + 0.1 - offset_s)) < 1e-6, stamps[0]
    assert said in done.out and ("1970" in done.out) is bool(said), done


def _local_offset_s(utc_s: float) -> float:
    """Return by how much clocks here are ahead of UTC."""
    offset = datetime.fromtimestamp(utc_s).astimezone().utcoffset()
    return offset.total_seconds() if offset else 0.0


def test_relative_stamps_are_added_up_over_all_lines(tmp_path: Path) -> None:
    body = "0.0 Start of measurement\n0.1 1 100 Rx d 0\n0.05 1 Statistic: D 0\n0.1 1 100 Rx d 0\n"
    imported(tmp_path, "a.asc", _HEAD.replace("absolute", "relative") + body)
    stamps = logs.read(tmp_path / "o.mcap").node["executive"].frames["stamp_ns"]
    assert stamps.tolist() == [100_000_000, 250_000_000]


@pytest.mark.parametrize(
    ("name", "text", "code", "frames"),
    [
        ("a.asc", f"{_HEAD}Begin TriggerBlock\n{_BODY}End TriggerBlock\n", 0, 2),
        ("a.asc", f"{_HEAD}Begin TriggerBlock\n{_BODY}", 3, 2),
        ("a.asc", f"{_HEAD}{_BODY}", 0, 2),  # as tools write that know of no blocks
        ("a.asc", f"{_HEAD}{_BODY}"[:-1], 0, 2),
        ("a.asc", f"{_HEAD}{_BODY}"[:-2], 3, 1),
        ("a.asc", f"{_HEAD}{_BODY}0.3 1 10", 3, 2),
        ("a.asc", f"{_HEAD}{_BODY}0.3 1 100 Rx d 1 1", 3, 2),
        ("a.asc", f"{_HEAD}{_BODY}0.3 1 100 Rx d 1 11 Length = 2", 0, 3),
        ("a.asc", f"{_HEAD}{_BODY}what is it\n", 3, 2),
        ("a.log", "(1.0) c 100#1122\n(1.1) c 100#1122", 0, 2),  # as long as the one before
        ("a.log", "(1.0) c 100#1122\n(1.1) c 100#11", 3, 1),
        ("a.log", "(1.0) c 100#1122\n(1.1) c 101#1122", 3, 1),
        ("a.log", "(1.0) c 100#1122\n(1.1) c 101#1122334455667788", 0, 2),
        ("a.log", "(1.0) c 100#1122\n(1.1) c 1", 3, 1),
        ("a.log", "(1.0) c 100#1122\nwhat is it\n(1.1) c 100#1122\n", 3, 2),
        ("a.log", "(1.0) c 100#1122\n(1.1) c 00100###8103C000000.00\n", 3, 1),
        ("a.log", "(1.0) c 100#1122\n(1.1) c 100#R\n", 0, 1),
    ],
)
def test_the_exit_code_tells_whether_a_frame_is_missing(
    name: str, text: str, code: int, frames: int, tmp_path: Path
) -> None:
    done = imported(tmp_path, name, text, "--quiet")
    assert (done.code, done.err.count("\n")) == (code, int(code == 3)), done
    assert done.out.startswith(f"{tmp_path / 'o.mcap'}: {frames} frames"), done
    counts = json.loads(imported(tmp_path, name, text, "--json").out)
    assert bool(counts["damaged"]) is (code == 3 and "CAN XL" not in counts["left_out"]), counts
    assert len(counts["damage"]) == counts["damaged"], counts


def test_many_damaged_lines_are_counted_and_the_first_told(tmp_path: Path) -> None:
    text = "(1.0) c 100#1122\n" + "broken\n" * 20
    done = imported(tmp_path, "a.log", text, "--quiet")
    assert "line 2: no line of candump: 'broken', and 19 more places" in done.err, done
    assert "damaged, not imported: 12 more places" in done.out, done
    counts = json.loads(imported(tmp_path, "a.log", text, "--json").out)
    assert (counts["damaged"], len(counts["damage"])) == (20, 8)


def test_a_packed_file_that_is_cut_or_changed_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    whole = gzip.compress(_LINES.encode() * 2000, mtime=0)
    for data in (whole[: len(whole) // 2], whole[:-8] + bytes(8), whole + b"rubbish"):
        done = imported(tmp_path, "a.log.gz", data, "--quiet")
        assert done.code == 3 and "the .gz around it" in done.out + done.err, done
    assert imported(tmp_path, "a.log.gz", whole + bytes(100), "--quiet").code == 0
    assert imported(tmp_path, "a.log.gz", whole + whole, "--quiet").code == 0


def test_a_channel_that_steers_a_terminal_is_printed_harmless(tmp_path: Path) -> None:
    lines = [f"({i}.5) can\x1b[2J{i % 2} 120#0000000000000000\n" for i in range(4)]
    done = imported(tmp_path, "a.log", "".join(lines))
    assert done.code == 0 and "\x1b" not in done.out + done.err, repr(done)


def test_channels_that_stand_one_behind_the_other_are_merged_by_their_stamps(
    tmp_path: Path,
) -> None:
    text = "".join(f"({1 + i}.5) can{k} 100#\n" for k in range(2) for i in range(20))
    done = imported(tmp_path, "a.log", text)
    assert "in 19 s" in done.out and "clock" not in done.out, done


def test_a_name_that_is_no_text_is_spelt_out_in_the_log(tmp_path: Path) -> None:
    dbc = tmp_path / os.fsdecode(b"c\xffar.dbc")
    dbc.write_bytes(DBC.read_bytes())
    line = "(1.5) can0 120#0000000000000000\n"
    done = imported(tmp_path, os.fsdecode(b"na\xffme.log"), line, "--dbc", str(dbc))
    log = logs.read(tmp_path / "o.mcap")
    assert done.code == 0 and not log.missing, done
    assert (
        log.metadata["executive"]["bus"] == r"na\udcffme.log"
        and r"c\udcffar.dbc" in log.attachments
    )
