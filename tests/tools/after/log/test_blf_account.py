"""BLF files with parts that a reader may pass over: each is told, and all else is read."""

import gzip
import struct
from pathlib import Path

import pytest
from foreign import (
    LENGTHS,
    LOBJ,
    blf_container,
    blf_file,
    blf_frame,
    blf_object,
    some_frames,
)

from pcpc.drivers.can.wire_layout import Flag
from pcpc.tools.after.log.recording import ForeignRecording, read
from pcpc.tools.terminal.progress import Progress

FRAMES = some_frames(1, 30)
OBJECTS = [blf_frame(frame) for frame in FRAMES]
PARTS = [blf_container(b"".join(OBJECTS[i : i + 10])) for i in (0, 10, 20)]
WHOLE = blf_file(PARTS, 30)


def recorded(folder: Path, content: bytes, name: str = "a.blf") -> ForeignRecording:
    (folder / name).write_bytes(content)
    return read(folder / name, None, Progress(True))


def classic(dlc: int, flags: int = 0, kind: int = 1, number: int = 0x100) -> bytes:
    """Return the object of a classic frame of these marks."""
    return blf_object(kind, struct.pack("<HBBL8s", 1, flags, dlc, number, bytes(range(8))))


def fd_64(dlc: int, valid: int, data: bytes, flags: int = 0x1000, way: int = 0) -> bytes:
    """Return the object of a frame of CAN FD."""
    numbers = (1, dlc, valid, 0, 0x100, 0, flags, 0, 0, 0, 0, 0, way, 0, 0)
    return blf_object(101, struct.pack("<BBBBLLLLLLLHBBL", *numbers) + data)


def fd_100(dlc: int, valid: int, fd: int) -> bytes:
    """Return the object of a frame in the older form of CAN FD."""
    body = struct.pack("<HBBLLBBB5x64s", 1, 0, dlc, 0x100, 0, 0, fd, valid, bytes(range(64)))
    return blf_object(100, body)


CUT = WHOLE[: len(WHOLE) - len(PARTS[2]) // 2]
LIVE = blf_file(PARTS, 0, 144)


@pytest.mark.parametrize("name", ["a.blf", "A.BLF", "a.blf.gz", "A.Blf.GZ"])
@pytest.mark.parametrize(
    ("content", "most", "said"),
    [
        (CUT, 29, "of 30 objects"),
        (LIVE[: -len(PARTS[2]) // 2], 29, "its head was not finished"),
        (LIVE, 30, "its head was not finished"),
        (blf_file(PARTS, 31), 30, "30 of 31 objects"),
        (blf_file(PARTS, 0, len(WHOLE) + 100), 30, f"{len(WHOLE)} of {len(WHOLE) + 100} bytes"),
        (WHOLE[: len(WHOLE) - len(PARTS[2])], 20, "20 of 30 objects"),
    ],
)
def test_a_recording_that_ends_early_gives_the_same_under_each_name(
    content: bytes, most: int, said: str, name: str, tmp_path: Path
) -> None:
    data = gzip.compress(content) if name.upper().endswith("GZ") else content
    found = recorded(tmp_path, data, name)
    assert 20 <= len(found.frames) <= most, len(found.frames)
    assert any(said in line for line in found.account.damage), found.account
    assert not found.account.is_whole


def test_each_damaged_object_of_a_container_counts(tmp_path: Path) -> None:
    parts = [blf_container(classic(0x33) + classic(8) + classic(2, number=0x900))]
    found = recorded(tmp_path, blf_file(parts, 3))
    assert found.account.damaged == 2 and len(found.frames) == 1, found.account


def _flipped(part: bytes, at: int) -> bytes:
    changed = bytearray(part)
    changed[at] ^= 0xFF
    return bytes(changed)


def _unsized(kind: int) -> bytes:
    return LOBJ.pack(b"LOBJ", 32, 1, 0, kind) + bytes(300)


@pytest.mark.parametrize(
    ("middle", "said"),
    [
        (_flipped(PARTS[1], len(PARTS[1]) // 2), "a container is damaged"),
        (_flipped(PARTS[1], 16), "packed by method"),
        (_flipped(PARTS[1], 0), "no object begins there"),
        (LOBJ.pack(b"LOBJ", 16, 1, 20, 10) + b"1234", "a container is cut"),
        (LOBJ.pack(b"LOBJ", 16, 1, 0, 10), "an object without a size"),
        (blf_container(_flipped(b"".join(OBJECTS[10:20]), 0)), "no object begins there"),
        (blf_container(OBJECTS[10][:8] + bytes(8) + OBJECTS[10][16:]), "an object without a size"),
        (blf_container(_unsized(86)), "an object without a size"),
        (blf_container(_unsized(99)), "an object without a size"),
        (blf_container(OBJECTS[10][:8] + b"\xff" * 4 + OBJECTS[10][12:]), "an object of 42949672"),
        (blf_container(blf_object(1, bytes(16), version=7)), "a head of version 7"),
        (blf_container(blf_object(1, bytes(3))), "requires a buffer"),
        (blf_container(classic(0x33)), "DLC 51"),
    ],
)  # fmt: skip
def test_a_damaged_part_is_told_with_its_place_and_the_others_are_read(
    middle: bytes, said: str, tmp_path: Path
) -> None:
    found = recorded(tmp_path, blf_file([PARTS[0], middle, PARTS[2]], 0))
    place = 144 + len(PARTS[0])
    told = [line for line in found.account.damage if said in line]
    assert told and place - 3 <= int(told[0].split()[1].rstrip(":,")) <= place, found.account
    data = [row["data"][: row["dlc"]].tobytes() for row in found.frames]
    sent = [frame.data for frame in FRAMES]
    assert data[:10] == sent[:10] and data[-10:] == sent[20:], found.account


@pytest.mark.parametrize(
    ("part", "expected"),
    [  # length of the data frame, else why it is none
        *((classic(dlc), min(dlc, 8)) for dlc in (0, 7, 8, 9, 15)),
        *((classic(dlc, kind=86), min(dlc, 8)) for dlc in (8, 15)),
        *((fd_64(dlc, LENGTHS[dlc], bytes(LENGTHS[dlc])), LENGTHS[dlc]) for dlc in (0, 8, 9, 15)),
        (fd_64(9, 12, bytes(9)), 12),  # fewer bytes than it says
        (fd_64(9, 9, bytes(12)), 12),
        (fd_64(15, 8, bytes(8), flags=0), 8),
        *((fd_100(dlc, 64, 1), LENGTHS[dlc]) for dlc in (0, 8, 15)),
        (fd_100(15, 64, 0), 8),
        (classic(8, flags=0x80), "remote"),
        (classic(8, flags=2), "request"),
        (fd_64(8, 8, bytes(8), flags=0x10), "remote"),
        (fd_64(8, 8, bytes(8), way=2), "request"),
        (blf_object(2, bytes(8)), "error"),
        (blf_object(73, bytes(40)), "error"),
        (blf_object(104, bytes(40)), "error"),
        (blf_object(140, b"\2" + bytes(39)), "error"),
        (blf_object(139, b"\2" + bytes(99)), "CAN XL"),
        (blf_object(3, bytes(8)), "overload"),
        (blf_object(96, bytes(40)), "other"),
    ],
)
@pytest.mark.parametrize("packed", [True, False])
def test_each_object_counts_as_what_it_is(
    part: bytes, expected: int | str, packed: bool, tmp_path: Path
) -> None:
    pair = part + OBJECTS[0]
    content = [blf_container(pair)] if packed else [part, OBJECTS[0]]
    found = recorded(tmp_path, blf_file(content, 2))
    account = found.account
    lengths = sorted(found.frames["dlc"].tolist())
    lengths.remove(len(FRAMES[0].data))
    outcome = [*lengths, *account.left_out] + ["other"] * account.others
    assert outcome == [expected] and account.is_whole is not (expected == "CAN XL"), account


@pytest.mark.parametrize("marks", range(4))
def test_the_marks_of_a_frame_of_can_fd_are_kept(marks: int, tmp_path: Path) -> None:
    parts = [fd_64(8, 8, bytes(8), 0x1000 + (marks << 13)), fd_100(8, 8, 1 + (marks << 1))]
    found = recorded(tmp_path, blf_file([blf_container(b"".join(parts))], 2))
    expected = Flag.FD + (marks & 1) * Flag.BRS + (marks >> 1) * Flag.ESI
    assert found.frames["flags"].tolist() == [expected] * 2


@pytest.mark.parametrize("version", [1, 2])
def test_stamps_count_from_the_date_in_ns_or_10_us(version: int, tmp_path: Path) -> None:
    body = struct.pack("<HBBL8s", 1, 0, 0, 0x100, b"")
    for unit, time_ns in ((2, 7), (1, 70_000)):
        head = struct.pack("<LHHQ" if version == 1 else "<LBxHQ8x", unit, 0, 0, 7)
        size = LOBJ.size + len(head) + len(body)
        part = LOBJ.pack(b"LOBJ", LOBJ.size + len(head), version, size, 1) + head + body
        found = recorded(tmp_path, blf_file([blf_container(part)], 1))
        assert found.frames["stamp_ns"][0] == 1_700_000_000 * 10**9 + time_ns
