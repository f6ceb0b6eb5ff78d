"""slcan: its text in Python and in C, and a device on a serial line."""

import ctypes
import os
import pty
import random
import select
import shutil
import subprocess
import threading
import tty
from pathlib import Path
from typing import Any

import can
import pytest
from processes import DEADLINE_S, PCPC, own_bus, pcpc, until

from pcpc.drivers.can import plain_bus
from pcpc.drivers.can.wire_layout import LENGTHS, Flag
from pcpc.drivers.errors import UserError
from pcpc.tools.make.device import slcan
from pcpc.tools.make.generate.device import same_files


class Frame(ctypes.Structure):
    """A frame as codec.h has it."""

    _fields_ = (("id", ctypes.c_uint32), ("n", ctypes.c_uint8), ("data", ctypes.c_uint8 * 8))


class LongFrame(ctypes.Structure):
    """A frame as it is on CAN FD."""

    _fields_ = (
        ("id", ctypes.c_uint32), ("n", ctypes.c_uint8), ("data", ctypes.c_uint8 * 64),
        ("flags", ctypes.c_uint8),
    )  # fmt: skip


class LongLine(ctypes.Structure):
    """The state of a line as it is on CAN FD."""

    _fields_ = (
        ("line", ctypes.c_char * 140), ("n", ctypes.c_uint32), ("open", ctypes.c_bool),
        ("reply", ctypes.c_char),
    )  # fmt: skip


class Line(ctypes.Structure):
    """The state of a line as slcan.h has it."""

    _fields_ = (
        ("line", ctypes.c_char * 28), ("n", ctypes.c_uint32), ("open", ctypes.c_bool),
        ("reply", ctypes.c_char),
    )  # fmt: skip


def library_of(folder: Path, fd: bool) -> Any:
    """Compile slcan.c in a folder, and load it."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler; apt-get install gcc libc6-dev")
    for name, text in same_files(fd).items():
        (folder / name).write_text(text)
    path = folder / "slcan.so"
    words = ["cc", "-O1", "-Wall", "-Werror", "-shared", "-fPIC", "-o", str(path)]
    subprocess.run([*words, str(folder / "slcan.c")], check=True)
    library = ctypes.CDLL(str(path))
    library.slcan_take.restype = ctypes.c_bool
    return library


@pytest.fixture(scope="module")
def in_c(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return library_of(tmp_path_factory.mktemp("slcan"), fd=False)


def long_frames(count: int) -> list[plain_bus.BusFrame]:
    draw = random.Random(10)
    found = [one._replace(flags=draw.choice((0, 4, 5))) for one in frames(count)]
    return [
        one._replace(data=draw.randbytes(draw.choice(LENGTHS))) if one.flags else one
        for one in found
    ]


def frames(count: int) -> list[plain_bus.BusFrame]:
    draw = random.Random(9)
    words = (
        draw.choice((draw.randrange(2**11), 1 << 31 | draw.randrange(2**29))) for _ in range(count)
    )
    return [plain_bus.BusFrame(word, draw.randbytes(draw.randrange(9))) for word in words]


def heard(
    library: Any, line: Any, text: bytes, kind: Any = Frame
) -> tuple[list[plain_bus.BusFrame], bytes]:
    """Return the frames of characters that a device takes, and what it answers."""
    found, said, frame = list[plain_bus.BusFrame](), b"", kind()
    for byte in text:
        if library.slcan_take(ctypes.byref(line), ctypes.c_char(byte), ctypes.byref(frame)):
            flags = getattr(frame, "flags", Flag.NONE)
            found.append(plain_bus.BusFrame(frame.id, bytes(frame.data[: frame.n]), flags))
        said += b"" if line.reply == b"\0" else line.reply
    return found, said


def test_frames_are_the_same_text_in_python_and_in_c(in_c: Any) -> None:
    line, text = Line(), ctypes.create_string_buffer(28)
    assert heard(in_c, line, b"O\r") == ([], b"\r")
    for word, data, _ in frames(500):
        frame = Frame(word, len(data), (ctypes.c_uint8 * 8)(*data))
        count = in_c.slcan_line(ctypes.byref(frame), text)
        said = slcan.line_of(word, data)
        assert text.raw[:count] == said
        assert slcan.frame_of(said[:-1]) == (word, data, Flag.NONE)
        assert heard(in_c, line, said) == ([(word, data, Flag.NONE)], b"")


@pytest.fixture(scope="module")
def in_long_c(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the C of a rig on CAN FD."""
    folder = tmp_path_factory.mktemp("long")
    return library_of(folder, fd=True)


def test_frames_of_can_fd_are_the_same_text_in_python_can_too(
    in_long_c: Any, tmp_path: Path
) -> None:
    """python-can's host is at the other end of a pseudo-terminal."""
    pytest.importorskip("serial")
    line, text = LongLine(), ctypes.create_string_buffer(140)
    assert heard(in_long_c, line, b"O\r", LongFrame) == ([], b"\r")
    device, host = pty.openpty()
    tty.setraw(device)
    with can.Bus(interface="slcan", channel=os.ttyname(host), sleep_after_open=0.0) as theirs:
        taken(device)
        for word, data, flags in long_frames(60):
            frame = LongFrame(word, len(data), (ctypes.c_uint8 * 64)(*data), flags)
            count = in_long_c.slcan_line(ctypes.byref(frame), text)
            said = slcan.line_of(word, data, flags)
            assert text.raw[:count] == said
            assert slcan.frame_of(said[:-1]) == (word, data, flags)
            assert heard(in_long_c, line, said, LongFrame) == ([(word, data, flags)], b"")
            os.write(device, said)
            message = theirs.recv(DEADLINE_S)
            assert message is not None and bytes(message.data) == data
            its = message.arbitration_id, message.is_extended_id, message.is_fd
            assert its == (word & 0x1FFFFFFF, bool(word >> 31), bool(flags & Flag.FD))
            assert message.bitrate_switch is bool(flags & Flag.BRS)
            theirs.send(message)
            back = b""
            while not back.endswith(b"\r"):
                back += taken(device)
            assert back == said
    os.close(device)
    os.close(host)


def test_what_is_no_frame_of_can_fd_is_none(in_long_c: Any) -> None:
    wrong = [
        b"d", b"d123", b"d123G", b"d1239" + b"00" * 11, b"D123800", b"b123F" + b"00" * 63,
        b"t1239" + b"00" * 12, b"f1230",
    ]  # fmt: skip
    line = LongLine(open=True)
    for text in [*wrong, b"b123F" + b"00" * 200]:
        assert slcan.frame_of(text) is None or text not in wrong, text
        assert heard(in_long_c, line, text + b"\r", LongFrame) == ([], b"\a"), text
    whole = b"b123F" + b"AB" * 64
    assert heard(in_long_c, line, whole + b"\r", LongFrame)[0] == [(0x123, b"\xab" * 64, 5)]


def test_what_is_no_frame_is_none(in_c: Any) -> None:
    wrong = b"t12", b"t1239", b"t12320G0", b"t12380011", b"T123800", b"x", b"t1230AA", b"V", b"\xff"
    line = Line(open=True)
    for text in wrong:
        assert slcan.frame_of(text) is None or text == b"t1230AA", text
        assert heard(in_c, line, text + b"\r") == ([], b"\a"), text
    assert heard(in_c, line, b"S8\rC\rt1230\rO\r\r") == ([], b"\r\r\a\r"), (
        "closed, it hears nothing"
    )
    assert heard(in_c, line, b"t" * 100 + b"\rt1230\r") == ([(0x123, b"", 0)], b"\a")


def test_a_serial_line_is_carried_to_the_bus_and_back(tmp_path: Path) -> None:
    """A pseudo-terminal has a device's side, here, and a host's, at which the bridge is."""
    device, host = pty.openpty()
    name, bus = os.ttyname(host), own_bus()
    words = [PCPC, "slcan", bus, name, "--bitrate", "500k", "--data-bitrate", "5M"]
    bridge = subprocess.Popen(words)
    try:
        carry_both_ways(device, host, bus)
        os.close(device)
        assert bridge.wait(DEADLINE_S) == 0
    finally:
        bridge.kill()
        bridge.wait()


def carry_both_ways(device: int, host: int, bus: str) -> None:
    said = b""
    while not said.endswith(b"S6\rY5\rO\r"):
        said += taken(device)
    os.close(host)  # the bridge has opened it by now
    os.write(device, b"\r\r\rt7011")
    end = slcan.open_bus(bus)
    os.write(device, b"7F\rT1ABCDEF02AA55\r")
    came = list[plain_bus.BusFrame]()
    until(lambda: came.extend(end.frames()) or len(came) >= 1, "a frame on the bus")
    until(lambda: came.extend(end.frames()) or came[-1][1] == b"\xaa\x55", "the other one")
    assert came[-1] == (1 << 31 | 0x1ABCDEF0, b"\xaa\x55", Flag.NONE)
    os.write(device, b"b123F" + b"C3" * 64 + b"\r")
    until(lambda: came.extend(end.frames()) or came[-1].flags, "one of CAN FD")
    assert came[-1] == (0x123, b"\xc3" * 64, Flag.FD | Flag.BRS)
    for frame in long_frames(40):
        end.put(*frame)
    expected = b"".join(slcan.line_of(*frame) for frame in long_frames(40))
    said = b""
    while len(said) < len(expected):
        said += taken(device).replace(b"\rC\rS6\rY5\rO\r", b"")
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


class Silence:
    """A bus on which `frames` are, once."""

    def __init__(self, frames: list[plain_bus.BusFrame]) -> None:
        self._frames = frames

    def frames(self) -> list[plain_bus.BusFrame]:
        """Return what is there."""
        found, self._frames = self._frames, []
        return found


@pytest.mark.parametrize(("limit", "said"), [
    ("ANSWER_S", r"^sh q\.sh: no answer within 0\.1 s; start the device, and check .* --baud$"),
    ("TAKE_S", r"^sh q\.sh: took nothing for 0\.1 s; start the device, and check .* --baud$"),
])  # fmt: skip
def test_a_line_that_says_or_takes_nothing_is_given_up(
    limit: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(slcan, limit, 0.1)
    (into, never), (unread, out) = os.pipe(), os.pipe()
    bus: Any = Silence(long_frames(3000))
    bridge = slcan.Bridge(bus, into, out, "sh q.sh")
    with pytest.raises(UserError, match=said) as refused:
        if limit == "ANSWER_S":
            bridge.open(500_000)
        else:
            bridge.from_bus()
    assert refused.value.code == 4
    for end in (into, never, unread, out):
        os.close(end)


def test_a_slow_line_gets_all_that_is_written() -> None:
    (into, never), (unread, out) = os.pipe(), os.pipe()
    sent = long_frames(3000)
    bus: Any = Silence(sent)
    wanted = b"".join(slcan.line_of(*frame) for frame in sent)
    said = list[bytes]()

    def read() -> None:
        while sum(map(len, said)) < len(wanted):
            said.append(os.read(unread, 1000))

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    slcan.Bridge(bus, into, out, "x").from_bus()
    reader.join(30)
    assert b"".join(said) == wanted
    for end in (into, never, unread, out):
        os.close(end)


class Bus(Silence):
    """A bus with a frame that is there, and a list of what is put onto it."""

    def __init__(self) -> None:
        super().__init__(long_frames(1))
        self.came: list[tuple[Any, ...]] = []
        self._ready, more = os.pipe()
        os.write(more, b"1")

    def fileno(self) -> int:
        """Return what is always ready."""
        return self._ready

    def put(self, *frame: Any) -> None:
        self.came.append(frame)


def test_what_a_device_said_last_is_carried_though_it_hears_no_more() -> None:
    """Both ends are ready at once: the bus has a frame for a device that has ended."""
    (into, says), (hears, out) = os.pipe(), os.pipe()
    bus: Any = Bus()
    os.write(says, b"t12320102\rt7011")
    os.write(says, b"05\r")
    os.close(says)
    os.close(hears)
    slcan.Bridge(bus, into, out, "x").run()
    assert bus.came == [(0x123, b"\x01\x02", Flag.NONE), (0x701, b"\x05", Flag.NONE)]
    for end in (into, out):
        os.close(end)
