"""`pcpc log import` of damaged BLF files: told in one line."""

import struct
import zlib
from pathlib import Path

import pytest
from logcommand import DBC, Done, run

LOBJ = struct.Struct("<4sHHLL")  # mark, size of the head, its version, size, kind


def can_message(size: int = 48, kind: int = 1) -> bytes:
    """Return an object of a BLF file; a true one of kind 1 has 48 bytes."""
    head = LOBJ.pack(b"LOBJ", 32, 1, size, kind) + struct.pack("<LHHQ", 2, 0, 0, 10**9)
    return head + struct.pack("<HBBL8s", 1, 0, 8, 0x120, bytes(8))


def container(data: bytes) -> bytes:
    """Return a compressed container of objects."""
    body = struct.pack("<H6xL4x", 2, len(data)) + zlib.compress(data)
    return LOBJ.pack(b"LOBJ", 16, 1, 16 + len(body), 10) + body + bytes((16 + len(body)) % 4)


def blf(folder: Path, *objects: bytes) -> Path:
    """Write a BLF file of these objects."""
    path, content = folder / "drive.blf", b"".join(objects)
    head = b"LOGG" + struct.pack("<L", 144) + bytes(8)
    head += struct.pack("<QQLL", 144 + len(content), 144 + len(content), len(objects), 0)
    path.write_bytes(head.ljust(144, b"\0") + content)
    return path


def imported(path: Path) -> Done:
    return run("import", path, "--dbc", DBC, "-o", path.with_name("o.mcap"), "--force", "--quiet")


def test_a_true_file_of_these_parts_is_read(tmp_path: Path) -> None:
    done = imported(blf(tmp_path, container(can_message() * 100)))
    assert done.code == 0 and "100 frames" in done.out, done


@pytest.mark.parametrize("kind", [1, 86, 99])
def test_an_object_without_a_size_is_told_and_the_others_are_read(
    kind: int, tmp_path: Path
) -> None:
    """A reader that trusts the size yields it for ever, or looks at it for ever."""
    odd = can_message(size=0, kind=kind)
    parts = container(can_message() * 3 + odd + bytes(300)), container(can_message() * 2)
    done = imported(blf(tmp_path, *parts))
    assert done.code == 3 and done.err.count("\n") == 1 and "drive.blf" in done.err, done
    assert "an object without a size" in done.err and "5 frames" in done.out, done


def test_a_container_without_a_size_is_told_and_what_follows_is_read(tmp_path: Path) -> None:
    done = imported(blf(tmp_path, LOBJ.pack(b"LOBJ", 16, 1, 0, 10), container(can_message())))
    assert done.code == 3 and "an object without a size" in done.err, done
    assert "1 frames" in done.out, done


def test_a_channel_that_steers_a_terminal_is_printed_harmless(tmp_path: Path) -> None:
    lines = [f"({i}.5) can\x1b[2J{i % 2} 120#0000000000000000" for i in range(4)]
    path = tmp_path / "drive.log"
    path.write_text("\n".join(lines) + "\n")
    done = imported(path)
    assert "\x1b" not in done.out + done.err, repr(done)
