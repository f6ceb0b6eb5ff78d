"""Recordings of others, whole, cut and flipped: each frame is read, or its loss is told.

Files are made of the same frames in every format (`foreign.py`) and read in this process.
"""

import gzip
import random
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from foreign import START_S, TEXTS, WRITERS, Sent, some_frames

from pcpc.drivers.can import can_id
from pcpc.drivers.can.wire_layout import Flag
from pcpc.tools.after.log.cat import frame_text
from pcpc.tools.after.log.recording import ForeignRecording, read
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress

_UTF16_MARK = b"\xff\xfe"


def recorded(path: Path, content: bytes) -> ForeignRecording:
    """Read a file of this content."""
    path.write_bytes(content)
    return read(path, None, Progress(True))


def frames_of(recording: ForeignRecording) -> list[Sent]:
    """Return the frames that were read, as they were sent."""
    found = []
    for row in recording.frames:
        word, us = int(row["id"]), round(int(row["stamp_ns"]) / 1000) - START_S * 10**6
        data = row["data"][: row["dlc"]].tobytes()
        is_fd = bool(row["flags"] & Flag.FD)
        extended, received = bool(word & can_id.EXTENDED), bool(row["direction"])
        found.append(Sent(us, word & can_id.ID, extended, data, is_fd, received))
    return found


def sample(name: str, seed: int, count: int = 6) -> tuple[list[Sent], bytes, str]:
    """Return frames that a format can hold, the file, and its suffix."""
    suffix, writer, has_fd, has_direction = WRITERS[name]
    frames = some_frames(seed, count, has_fd)
    if not has_direction:
        frames = [frame._replace(received=True) for frame in frames]
    return frames, writer(frames), suffix


@pytest.mark.parametrize("line", [
    b" (1700000000.000100)  can0  123   [2]  11 22", b"  can0  123   [2]  11 22",
    b" (1700000000.000100)  can0  RX - -  123   [2]  11 22", b"(1700000000.000100) can0 123#1122",
])  # fmt: skip
@pytest.mark.parametrize("before", [b"", b"# a note, longer than a line\r\n#\n\n" * 40])
def test_candump_is_known_by_its_lines(line: bytes, before: bytes, tmp_path: Path) -> None:
    for file in ("a.txt", "a"):
        found = recorded(tmp_path / file, before + line + b"\n")
        assert [(one.id, one.spaced) for one in frames_of(found)] == [("123", "11 22")]


@pytest.mark.parametrize(("file", "text", "is_whole"), [
    ("a.log", "(1.0) can0 7FF#\n(1.0) can0 123#1122334455667788", True),
    ("a.log", "(1.0) can0 7FF#\n(1.0) can0 123#11223344556677", False),
    ("a.asc", "base hex\n0.0 1 7FFx Rx d 0\n0.0 CANFD 1 Rx 100 0 0 2 2 11 22 0 0 201000", True),
    ("a.asc", "base hex\n0.0 1 7FFx Rx d 0\n0.0 CANFD 1 Rx 100 0 0 2 2 11 22 0 0", False),
])  # fmt: skip
def test_a_last_line_without_its_end_is_whole_if_it_can_lack_nothing(
    file: str, text: str, is_whole: bool, tmp_path: Path
) -> None:
    found = recorded(tmp_path / file, text.encode())
    assert (found.account.is_whole, len(found.frames)) == (is_whole, 1 + is_whole), found.account


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("seed", range(4))
def test_every_frame_comes_back_plain_and_packed(name: str, seed: int, tmp_path: Path) -> None:
    frames, content, suffix = sample(name, seed, 1 if seed == 0 else 40)
    packed = gzip.compress(content)
    for file, data in (
        (f"a{suffix}", content), (f"a{suffix.upper()}", content),
        (f"a{suffix}.gz", packed), (f"A{suffix.upper()}.GZ", packed), (f"a{suffix}", packed),
    ):  # fmt: skip
        found = recorded(tmp_path / file, data)
        assert frames_of(found) == frames, file
        assert found.account.is_whole and not found.account.notes, (file, found.account)


_FORMS: dict[str, Callable[[bytes], bytes]] = {
    "CR and LF": lambda text: text.replace(b"\r\n", b"\n").replace(b"\n", b"\r\n"),
    "LF": lambda text: text.replace(b"\r\n", b"\n"),
    "blank lines": lambda text: text.replace(b"\n", b"\n\n \n"),
    "a mark of UTF-8": lambda text: b"\xef\xbb\xbf" + text,
    "UTF-16": lambda text: _UTF16_MARK + text.decode().encode("utf-16-le"),
    "UTF-16, big": lambda text: text.decode().encode("utf-16-be"),
}


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("form", _FORMS)
def test_a_text_is_read_in_whatever_code_it_is(name: str, form: str, tmp_path: Path) -> None:
    frames, content, suffix = sample(name, 7)
    found = recorded(tmp_path / f"a{suffix}", _FORMS[form](content))
    assert frames_of(found) == frames and found.account.is_whole, found.account


def frame_lines(text: bytes) -> int:
    """Return how many lines of frames begin in a text that is cut."""
    lines = text.split(b"\n")
    return sum(line[:1] in (b"(", b" ") or line[:1].isdigit() for line in lines if line.strip())


@pytest.mark.parametrize("name", WRITERS)
def test_of_a_cut_file_no_frame_is_lost_untold(name: str, tmp_path: Path) -> None:
    frames, content, suffix = sample(name, 3, 3)
    step = 7 if name != "db" else 512
    ends = len(content) - 1 - step * 8
    for size in [*range(0, ends, step), *range(ends, len(content), 1 + step // 9)]:
        try:
            found = recorded(tmp_path / f"a{suffix}", content[:size])
        except LogCommandError as error:
            assert "Traceback" not in str(error)
            continue
        read_ = frames_of(found)
        sent = frames[: len(read_)] if name != "db" else [f for f in frames if f in read_]
        assert read_ == sent, f"other frames than were sent, of {size} bytes"
        begun = len(frames) if name not in TEXTS else frame_lines(content[:size])
        begun = len(frames) if name == "asc" else begun  # it has a mark at its end
        lost = begun - len(read_)
        assert not (lost and found.account.is_whole), f"{lost} frames lost untold, {size} bytes"


@pytest.mark.parametrize("name", WRITERS)
def test_a_flipped_bit_takes_no_frame_untold(name: str, tmp_path: Path) -> None:
    frames, content, suffix = sample(name, 5)
    dice = random.Random(name)
    for _ in range(60):
        changed, at = bytearray(content), dice.randrange(len(content))
        changed[at] ^= 1 << dice.randrange(8)
        try:
            found = recorded(tmp_path / f"a{suffix}", bytes(changed))
        except LogCommandError:
            continue
        account = found.account
        is_told = account.damaged or account.left_out or account.others
        assert is_told or len(found.frames) >= len(frames), (at, bytes(changed), account)


_AT = "(1700000000.000000) can0 "
_ASC = "date 2023-11-14 22:13:20.000\nbase hex  timestamps absolute\n"
_TRC = ";$FILEVERSION=2.1\n;$STARTTIME=45244.92592592592592593\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"
_GOOD = "100#1122"


@pytest.mark.parametrize(
    ("suffix", "text", "expected"),
    [  # what is read, else what becomes of it
        (".log", f"{_AT}100#1122334455667788_B", "100#1122334455667788"),
        (".log", f"{_AT}100#11.22", _GOOD),
        (".log", f"12 {_AT}100#1122", _GOOD),
        (".log", f"# a comment\n{_AT}100#1122", _GOOD),
        (".log", f"{_AT}00000100#1122", "00000100#1122"),
        (".log", f"{_AT}100##31122", "100##31122"),
        (".log", f"{_AT}100##0112233445566778899", "100##0112233445566778899000000"),
        (".log", f"{_AT}100#", "100#"),
        (".log", f"{_AT}100#R4", "remote"),
        (".log", f"{_AT}20000004#0000000000000000", "error"),
        (".log", f"{_AT}00100###8103C000000.0011", "CAN XL"),
        (".log", f"{_AT}100#112", "damaged"),
        (".log", f"{_AT}100#112233445566778899", "damaged"),
        (".log", f"{_AT}800#11", "damaged"),
        (".log", f"{_AT}100##Z11", "damaged"),
        (".log", f"{_AT}100#1122334455667788_G", "damaged"),
        (".log", "(99999999999999.000000) can0 100#1122", "damaged"),
        (".log", "(-1.000000) can0 100#1122", "damaged"),
        (".log", "(x.5) can0 100#1122", "damaged"),
        (".log", " (1700000000.000000)  can0  100   [2]  11 22", _GOOD),
        (".log", " (1700000000.000000)  can0  100   {2}  11 22", _GOOD),
        (".log", " (2023-11-14 22:13:20.000000)  can0  100   [2]  11 22   '..'", _GOOD),
        (".log", " (1700000000.000000)  can0  RX B E  100  [02]  11 22", "100##31122"),
        (".log", " (1700000000.000000)  can0  100   [4]  remote request", "remote"),
        (".log", " (1700000000.000000)  can0  20000004   [1]  00  ERRORFRAME", "error"),
        (".log", " (1700000000.000000)  can0  100 [0012] (00|81:03:00000000) 11", "CAN XL"),
        (".log", " (1700000000.000000)  can0  100   [3]  11 22", "damaged"),
        (".log", " (1700000000.000000)  can0  100   [2]  00010010", "damaged"),
        (".log", f"{_AT}45100#81:00:00000000#1122", "CAN XL"),
        (".log", "DROPCOUNT: dropped 5 CAN frames on 'can0' socket", "damaged"),
        (".log", "(1700000000,5) can0 100#1122", _GOOD),
        (".log", " \x1b[34m(1700000000.0)  can0  100   [2]  11 22\x1b[0m", _GOOD),
        (".log", " (1700000000.0)  can0  100   [2]  00010001 00100010", _GOOD),
        (".log", " (1700000000.0)  can0  100   [2]  22`11   'BA'", _GOOD),
        (".log", " (1700000000.0)  can0  100   [2]  00100010`00010001", _GOOD),
        (".log", " (1700000000.0)  can0  100   [3]  22`11", "damaged"),
        (".log", " (1700000000.0)  can0  100   [1]  000100010", "damaged"),
        (".asc", f"{_ASC}0.0 1 100 Rx d 2 11 22", _GOOD),
        (".asc", f"{_ASC}0,0 1 100 Rx d 2 11 22", _GOOD),
        (".asc", f"{_ASC}0.0 1 MY NAME Rx d 2 11 22  Length = 0 BitCount = 0 ID = 256", "damaged"),
        (".asc", f"{_ASC}0.0 100 Rx d 2 11 22", "damaged"),
        (".asc", f"{_ASC}0.0 J1939TP FEE3p 6 0 0 - Rx d 23 A0 0F A6 60 3B D1 40 1F", "event"),
        (".asc", f"{_ASC}0.0 1  J1939TP FEE3p 6 0 0 - Rx d 23 A0 0F A6 60 3B D1 40 1F", "event"),
        (".asc", f"{_ASC}0.0 1 100 Rx d f 11 22 33 44 55 66 77 88", "100#1122334455667788"),
        (".asc", "date 2023-11-14 22:13:20\nbase dec\n0.0 1 256 Rx d 2 17 34", _GOOD),
        (".asc", f"{_ASC}0.0 1 18FEF100 Rx d 1 11", "18FEF100#11"),
        (".asc", f"{_ASC}0.0 1 SPEED Rx d 2 11 22  Length = 0 BitCount = 0 ID = 256", _GOOD),
        (".asc", f"{_ASC}0.0 1 FEED Rx d 2 11 22  Length = 0 BitCount = 0 ID = 256", _GOOD),
        (".asc", f"{_ASC}0.0 1 E1 Rx d 2 11 22  Length = 0 BitCount = 0 ID = 256", _GOOD),
        (".asc", f"{_ASC}0.0 1 0 Rx d 2 11 22", "000#1122"),
        (".asc", f"{_ASC}0.0 1 EEC1 Rx d 1 11  Length = 0 ID = 217056256x", "0CF00400#11"),
        (".asc", f"{_ASC}0.0 1 SPEED Rx d 2 11 22", "symbolic"),
        (".asc", f"{_ASC}0.0 1 100 TxRq d 2 11 22", "request"),
        (".asc", f"{_ASC}0.0 1 100 Rx r", "remote"),
        (".asc", f"{_ASC}0.0 1 ErrorFrame ECC: 10100010", "error"),
        (".asc", f"{_ASC}0.0 1 Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%", "event"),
        (".asc", f"{_ASC}0.0 CAN 1 Status:chip status error active", "event"),
        (".asc", f"{_ASC}0.0 CANFD Start of measurement", "nothing"),
        (".asc", f"{_ASC}0.0 1 100 Rx d 3 11 22", "damaged"),
        (".asc", f"{_ASC}0.0 1 100 Rx d 2 11 122", "damaged"),
        (".asc", f"{_ASC}0.0 1 100 Rx q 2 11 22", "damaged"),
        (".asc", f"{_ASC}0.0 1 100 Rx d 40 11 22", "damaged"),
        (".asc", f"{_ASC}x.0 1 100 Rx d 2 11 22", "damaged"),
        (".asc", f"{_ASC}0.0 CANFD 1 Rx 100 1 1 2 2 11 22 0 0 207000 0", "100##31122"),
        (".asc", f"{_ASC}0.0 CANFD 1 Rx 100 NAME 0 0 9 9 1 2 3 4 5 6 7 8 9 0 0 201000 0",
         "100##0010203040506070809000000"),
        (".asc", f"{_ASC}0.0 CANFD 1 Rx 100 0 0 2 2 11 22 0 0 200000 0", _GOOD),
        (".asc", f"{_ASC}0.0 CANFD 1 Rx 100 0 0 2 2 11 22", "100##01122"),
        (".asc", f"{_ASC}0.0 CANFD 1 Rx 100 1 0 0 0 0 0 303000 0", "100##1"),
        (".asc", f"{_ASC}0.0 CANFD 1 Rx 100 0 0 2 0 0 0 200010 0", "remote"),
        (".asc", f"{_ASC}0.0 CANFD 1 TxRq 100 0 0 2 2 11 22 0 0 201000 0", "request"),
        (".asc", f"{_ASC}0.0 CANFD 1 Tx ErrorFrame Not Acknowledge", "error"),
        (".asc", f"{_ASC}0.0 CANFD 1 Rx 100 2 0 2 2 11 22 0 0 201000 0", "damaged"),
        (".asc", f"{_ASC}0.0 CANXL 2 Rx CBFF 243215 176 100 N 2 2 11 22 174 00000000", _GOOD),
        (".asc", f"{_ASC}0.0 CANXL 2 Rx FBFF 2 1 100 2 2 11 22 a 12345 00007000", "100##31122"),
        (".asc", f"{_ASC}0.0 CANXL 2 Rx CBFF 2 1 100 2 0 174 00000010", "remote"),
        (".asc", f"{_ASC}0.0 CANXL 2 Rx XLFF 984438 4656 432 msg e0 0 1fe 511 1", "CAN XL"),
        (".trc", f"{_TRC}1 0.000 DT 1 0100 Rx - 2 11 22", _GOOD),
        (".trc", f"{_TRC}1 0.000 DT 1 0100 Rx - 9 11 22 33 44 55 66 77 88", "100#1122334455667788"),
        (".trc", f"{_TRC}1 0.000 FE 1 0100 Rx - 9 11 22 33 44 55 66 77 88 99 AA BB CC",
         "100##2112233445566778899AABBCC"),
        (".trc", f"{_TRC}1 0.000 FB 1 0100 Rx - 1 11", "100##111"),
        (".trc", f"{_TRC}1 0.000 BI 1 0100 Rx - 1 11", "100##311"),
        (".trc", f"{_TRC}1 0.000 RR 1 0100 Rx - 2", "remote"),
        (".trc", f"{_TRC}1 0.000 ER 1 - Rx - 5 04 00 02 00 00", "error"),
        (".trc", f"{_TRC}1 0.000 ST 1 - Rx - 4 00 00 00 08", "event"),
        (".trc", f"{_TRC}1 0.000 DT 1 0100 Rx - 3 11 22", "damaged"),
        (".trc", f"{_TRC}1 0.000 ZZ 1 0100 Rx - 2 11 22", "damaged"),
        (".trc", f"{_TRC}1 0.000 FD 1 0100 Rx - 16 11 22", "damaged"),
        (".trc", ";$FILEVERSION=2.0\n;$COLUMNS=N,O,T,I,d,l,D\n1 0.0 FD 0100 Rx 12 " + "11 " * 12,
         "100##0" + "11" * 12),
        (".trc", ";$FILEVERSION=1.3\n1) 0.0 1 Rx 0100 - 2 11 22", _GOOD),
        (".trc", ";$FILEVERSION=1.2\n1) 0.0 1 Rx 0100 2 11 22", _GOOD),
        (".trc", "1) 0 0100 2 11 22", _GOOD),
        (".trc", "1) 0 0100 3 RTR", "remote"),
        (".trc", "1) 0 0008 4 ERROR 00 19 08 08", "error"),
        (".trc", "1) 0 FFFFFFFF 4 00 00 00 04 BUSLIGHT", "event"),
        (".trc", ";$FILEVERSION=1.3\n1) 0.0 1 Rx 10062123 - 20 " + "D2 " * 20,
         "J1939 of more than 8 bytes"),
        (".csv", "timestamp,arbitration_id,extended,remote,error,dlc,data\n1.5,0x100,0,0,0,2,ESI=",
         _GOOD),
        (".csv", '"1.5","0x100","0","0","0","2","ESI="', _GOOD),
        (".csv", "1.5,0x100,True,False,False,2,ESI=", "00000100#1122"),
        (".csv", "1.5,0x100,yes,0,0,2,ESI=", "damaged"),
        (".csv", "1.5,0x100,0,0,0,12,AAAAAAAAAAAAAAAA", f"100##0{'00' * 12}"),
        (".csv", "1.5,0x100,0,False,TRUE,2,", "error"),
        (".csv", "1.5,0x100,0,1,0,2,", "remote"),
        (".csv", "1.5,0x100,0,0,1,2,", "error"),
        (".csv", "1.5,0x100,0,0,0,3,ESI=", "damaged"),
        (".csv", "nan,0x100,0,0,0,2,ESI=", "damaged"),
    ],
)  # fmt: skip
def test_each_line_is_read_or_left_out_by_name(
    suffix: str, text: str, expected: str, tmp_path: Path
) -> None:
    """Before it stands a frame of id 7FF, so that a file is read in which nothing else is one."""
    other = {
        ".log": "(1700000000.000000) can0 7FF#", ".csv": "1.5,0x7ff,0,0,0,0,",
        ".asc": "0.0 1 7FFx Rx d 0", ".trc": "",
    }[suffix]  # fmt: skip
    other = other.replace("7FFx", "2047x") if "base dec" in text else other
    head = text.rpartition("\n")[0] + "\n" if "\n" in text else ""
    line = text.rpartition("\n")[2]
    if suffix == ".trc":
        other = _OTHER_TRC[next((key for key in _OTHER_TRC if key and key in text), "")]
    content = f"{head}{line}\n{other}\n" if head or suffix != ".csv" else f"{line}\n{other}\n"
    found = recorded(tmp_path / f"a{suffix}", content.encode())
    texts = [frame_text(row) for row in found.frames if int(row["id"]) & can_id.ID != 0x7FF]
    account = found.account
    outcome = [*texts, *account.left_out] + ["damaged"] * account.damaged
    outcome += ["event"] * account.others
    assert outcome == ([] if expected == "nothing" else [expected]), (outcome, account)
    is_lost = expected in ("damaged", "CAN XL", "symbolic", "J1939 of more than 8 bytes")
    assert account.is_whole is not is_lost, account


_OTHER_TRC = {  # by what stands in a file of that version
    "=2.1": "9 0.000 DT 1 07FF Rx - 0", "N,O,T,I,d,l,D": "9 0.0 DT 07FF Rx 0",
    "=1.3": "9) 0.0 1 Rx 07FF - 0", "=1.2": "9) 0.0 1 Rx 07FF 0", "": "9) 0 07FF 0",
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.log", b"***BUSMASTER Ver 3.2.2***\n", "BUSMASTER's log"),
        ("a.mf4", b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        ("a.csv", b"Time Stamp,ID,Extended,Dir,Bus,LEN,D1\n1,2,false,Rx,0,1,3\n", "SavvyCAN's CSV"),
        ("a.csv", b"time;id;data\n1;2;3\n", "not python-can's CSV"),
        ("a.csv", b"No,Offset,Type,ID,Rx/Tx,Length,Data\n1,0,DT,1,Rx,0,\n", "not python-can's CSV"),
        ("a.blf", b"PK\x03\x04 and so on", "an archive; unpack it first"),
        (
            "a.log",
            gzip.compress(gzip.compress(b"(1.5) c 1#", mtime=0), mtime=0),
            "an archive in an archive;",
        ),
        ("a.asc", b"<!DOCTYPE html>\n<html>", "a web page"),
        ("a.blf", b"no BLF", "does not begin with LOGG"),
        ("a.db", b"no table", "no SQLite file of python-can"),
        ("a.log", b"\0\xff nothing\n" * 20, "line 1: no line of candump"),
        ("a.log", b"", "no CAN frame"),
        ("a.xyz", b"what is it", "no format is known by this suffix"),
        ("a.log", b"(1.5) can0 123#R\n", "no CAN frame with data; it has 1 remote frames"),
    ],
)
def test_what_is_no_recording_is_called_by_its_name(
    name: str, content: bytes, said: str, tmp_path: Path
) -> None:
    for file, data in ((name, content), (f"{name}.gz", gzip.compress(content))):
        with pytest.raises(LogCommandError, match=re.escape(said)) as error:
            recorded(tmp_path / file, data)
        assert "\n" not in str(error.value) and "damaged" not in str(error.value)
