"""slcan: its text in Python and in C, and a device on a serial line."""

import ctypes
import os
import pty
import random
import select
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from processes import PCPC, ROOT, own_bus, pcpc, until

from pcpc.tools.make.device import slcan

FIXED = ROOT / "tools" / "make" / "generate" / "c"


class Frame(ctypes.Structure):
    """A frame as codec.h has it."""

    _fields_ = (("id", ctypes.c_uint32), ("n", ctypes.c_uint8), ("data", ctypes.c_uint8 * 8))


class Line(ctypes.Structure):
    """The state of a line as slcan.h has it."""

    _fields_ = (
        ("line", ctypes.c_char * 28), ("n", ctypes.c_uint32), ("open", ctypes.c_bool),
        ("reply", ctypes.c_char),
    )  # fmt: skip


@pytest.fixture(scope="module")
def in_c(tmp_path_factory: pytest.TempPathFactory) -> Any:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler; apt-get install gcc libc6-dev")
    path = tmp_path_factory.mktemp("slcan") / "slcan.so"
    words = ["cc", "-O1", "-shared", "-fPIC", "-o", str(path), str(FIXED / "slcan.c")]
    subprocess.run(words, check=True)
    library = ctypes.CDLL(str(path))
    library.slcan_take.restype = ctypes.c_bool
    return library


def frames(count: int) -> list[slcan.Frame]:
    draw = random.Random(9)
    words = (
        draw.choice((draw.randrange(2**11), 1 << 31 | draw.randrange(2**29))) for _ in range(count)
    )
    return [(word, draw.randbytes(draw.randrange(9))) for word in words]


def heard(library: Any, line: Line, text: bytes) -> tuple[list[slcan.Frame], bytes]:
    """Return the frames of characters that a device takes, and what it answers."""
    found, said, frame = list[slcan.Frame](), b"", Frame()
    for byte in text:
        if library.slcan_take(ctypes.byref(line), ctypes.c_char(byte), ctypes.byref(frame)):
            found.append((frame.id, bytes(frame.data[: frame.n])))
        said += b"" if line.reply == b"\0" else line.reply
    return found, said


def test_frames_are_the_same_text_in_python_and_in_c(in_c: Any) -> None:
    line, text = Line(), ctypes.create_string_buffer(28)
    assert heard(in_c, line, b"O\r") == ([], b"\r")
    for word, data in frames(500):
        frame = Frame(word, len(data), (ctypes.c_uint8 * 8)(*data))
        count = in_c.slcan_line(ctypes.byref(frame), text)
        said = slcan.line_of(word, data)
        assert text.raw[:count] == said
        assert slcan.frame_of(said[:-1]) == (word, data)
        assert heard(in_c, line, said) == ([(word, data)], b"")


def test_what_is_no_frame_is_none(in_c: Any) -> None:
    wrong = b"t12", b"t1239", b"t12320G0", b"t12380011", b"T123800", b"x", b"t1230AA", b"V", b"\xff"
    line = Line(open=True)
    for text in wrong:
        assert slcan.frame_of(text) is None or text == b"t1230AA", text
        assert heard(in_c, line, text + b"\r") == ([], b"\a"), text
    assert heard(in_c, line, b"S8\rC\rt1230\rO\r\r") == ([], b"\r\r\a\r"), (
        "closed, it hears nothing"
    )
    assert heard(in_c, line, b"t" * 100 + b"\rt1230\r") == ([(0x123, b"")], b"\a")


def test_a_serial_line_is_carried_to_the_bus_and_back(tmp_path: Path) -> None:
    """A pseudo-terminal has a device's side, here, and a host's, at which the bridge is."""
    device, host = pty.openpty()
    name, bus = os.ttyname(host), own_bus()
    words = [PCPC, "slcan", bus, name, "--bitrate", "500k"]
    bridge = subprocess.Popen(words)
    try:
        carry_both_ways(device, host, bus)
        os.close(device)
        assert bridge.wait(20) == 0
    finally:
        bridge.kill()
        bridge.wait()


def carry_both_ways(device: int, host: int, bus: str) -> None:
    said = b""
    while not said.endswith(b"S6\rO\r"):
        said += taken(device)
    os.close(host)  # the bridge has opened it by now
    os.write(device, b"\r\r\rt7011")
    end = slcan.open_bus(bus)
    os.write(device, b"7F\rT1ABCDEF02AA55\r")
    came = list[slcan.Frame]()
    until(lambda: came.extend(end.frames()) or len(came) >= 1, "a frame on the bus")
    until(lambda: came.extend(end.frames()) or came[-1][1] == b"\xaa\x55", "the other one")
    assert came[-1] == (1 << 31 | 0x1ABCDEF0, b"\xaa\x55")
    for word, data in frames(40):
        end.put(word, data)
    expected = b"".join(slcan.line_of(word, data) for word, data in frames(40))
    said = b""
    while len(said) < len(expected):
        said += taken(device).replace(b"\rC\rS6\rO\r", b"")
    assert said == expected


def taken(device: int) -> bytes:
    ready, _, _ = select.select((device,), (), (), 60.0)
    assert ready, "nothing came"
    return os.read(device, 4096)


def test_what_cannot_be_a_line_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for words, what in (
        (["slcan", "udp_multicast"], "give a serial line"),
        (["slcan", "udp_multicast", "/dev/null"], "no serial line"),
        (["slcan", "udp_multicast", "/dev/no-such-line"], "No such file"),
        (["slcan", "udp_multicast", "--", "./no-such-program"], "No such file"),
        (["slcan", "udp_multicast", "/dev/null", "--bitrate", "33333"], "slcan knows 10000, "),
    ):
        done = pcpc(*words, cwd=tmp_path)
        assert done.code == 2 and what in done.err, done
