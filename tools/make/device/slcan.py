"""`pcpc slcan`: a device on a serial line that speaks slcan, on the rig's bus.

    pcpc slcan BUS /dev/ttyACM0             an adapter, or a board whose UART is one
    pcpc slcan BUS -- sh qemu.sh m7         a program whose stdin and stdout are the line

slcan is text: tIIINDD.. a frame with an id of 11 bits, TIIIIIIIINDD.. with one of 29, each line
ends with CR; d, D one of CAN FD, b, B one that switches its bit rate, N from 9 to F 12 to 64 bytes,
as CANable and python-can have them. Frames pass in their order, none is dropped here: what the line
does not take waits. The line is opened (O) again and again until it answers, then all frames of the
bus go to the device, but its own. A line that does not answer, or takes nothing, is given up.
"""

import os
import select
import signal
import subprocess
import termios
import time
import tty
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import NoReturn

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import can_id, plain_bus
from pcpc.drivers.can.plain_bus import BusFrame, Can, Udp
from pcpc.drivers.can.wire_layout import LENGTHS, Flag
from pcpc.drivers.errors import Exit, UserError
from pcpc.tools.make.device.commands import SlcanRequest

OPENS_EVERY_MS = 50
ANSWER_S = 60.0  # a board may still start, or be switched on by hand
TAKE_S = 10.0
_LONGEST_LINE = 160
_READ_BYTES = 65536
_DATA_RATES = {None: "", 2_000_000: "Y2\r", 5_000_000: "Y5\r"}
_BIT_RATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
_KINDS = {Flag.NONE: "t", Flag.FD: "d", Flag.FD | Flag.BRS: "b"}
_FLAGS = {kind: flags for flags, kind in _KINDS.items()}


def line_of(word: int, data: bytes, flags: int = Flag.NONE) -> bytes:
    """Return a frame as a line of slcan, in which an error passive sender (ESI) is not told."""
    kind = _KINDS[flags & (Flag.FD | Flag.BRS)]
    kind = kind.upper() if word & can_id.EXTENDED else kind
    length = f"{LENGTHS.index(len(data)):X}"
    return f"{kind}{can_id.text_of(word)}{length}{data.hex().upper()}\r".encode()


def frame_of(line: bytes) -> BusFrame | None:
    """Return the frame of a line without its CR; None for another line, as an answer."""
    kind = line[:1].decode("latin-1")
    digits = 3 if kind in _FLAGS else 8 if kind.lower() in _FLAGS else 0
    if not digits or len(line) < digits + 2:
        return None
    try:
        number, n = int(line[1 : digits + 1], 16), LENGTHS[int(line[digits + 1 : digits + 2], 16)]
        data = bytes.fromhex(line[digits + 2 : digits + 2 + 2 * n].decode("ascii"))
    except ValueError:
        return None
    flags = _FLAGS[kind.lower()]
    if len(data) != n or (n > 8 and flags == Flag.NONE):
        return None
    return BusFrame(can_id.word_of(number, digits == 8), data, flags)


def open_port(path: Path, baud: int) -> int:
    """Open a serial line, raw; return its descriptor. UserError if it cannot be."""
    speed = getattr(termios, f"B{baud}", None)
    if speed is None:
        raise UserError(f"--baud {baud}: not a rate of a serial line; 115200 is one")
    try:
        line = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(line)
        attributes = termios.tcgetattr(line)
        attributes[4] = attributes[5] = speed
        termios.tcsetattr(line, termios.TCSANOW, attributes)
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}; give a serial line") from None
    except termios.error:
        raise UserError(f"{path}: no serial line") from None
    return line


class Bridge:
    """Frames from a bus to a line, `out`, and from the line, `into`, to the bus."""

    def __init__(self, bus: Udp | Can, into: int, out: int, name: str) -> None:
        self.bus, self.into, self.out, self._name = bus, into, out, name
        os.set_blocking(out, False)
        self.opened = False
        self._rest = b""

    def open(self, bit_rate: int | None, data_rate: int | None = None) -> bool:
        """Ask the line to open until it answers; return False if it ended before. UserError."""
        end_s = time.monotonic() + ANSWER_S
        rate = f"S{_BIT_RATES.index(bit_rate)}\r" if bit_rate in _BIT_RATES else ""
        rate += _DATA_RATES[data_rate]
        while not self.opened:
            if time.monotonic() >= end_s:
                self._give_up(f"no answer within {ANSWER_S:g} s")
            self.write(b"\rC\r" * bool(rate) + rate.encode() + b"O\r")
            ready, _, _ = select.select((self.into,), (), (), 1e-3 * OPENS_EVERY_MS)
            if ready and not self.from_line():
                return False
        for _ in self.bus.frames():
            pass  # of before
        return True

    def run(self) -> None:
        """Carry frames both ways until the line ends."""
        poll = select.poll()
        poll.register(self.bus.fileno(), select.POLLIN)
        poll.register(self.into, select.POLLIN)
        while True:
            for ready, _ in poll.poll():
                if ready == self.into:
                    if not self.from_line():
                        return
                else:
                    self.from_bus()

    def from_bus(self) -> None:
        """Write the frames that are there to the line."""
        self.write(b"".join(line_of(*frame) for frame in self.bus.frames()))

    def write(self, text: bytes) -> None:
        """Write to the line; UserError if it takes nothing.

        What its other end no longer hears is over; what that said before is still to be read.
        """
        while text:
            _, ready, _ = select.select((), (self.out,), (), TAKE_S)
            if not ready:
                self._give_up(f"took nothing for {TAKE_S:g} s")
            try:
                text = text[os.write(self.out, text) :]
            except BlockingIOError:
                continue
            except OSError:
                return

    def _give_up(self, what: str) -> NoReturn:
        cure = "start the device, and check that it speaks slcan at this --baud"
        raise UserError(f"{self._name}: {what}; {cure}", Exit.ENVIRONMENT)

    def from_line(self) -> bool:
        """Send what the line said; return False at its end."""
        try:
            text = os.read(self.into, _READ_BYTES)
        except BlockingIOError:
            return True
        except OSError:  # of a pseudo-terminal, nobody has the other end open
            return False
        if not text:
            return False
        self.opened = True
        *lines, self._rest = (self._rest + text).replace(b"\a", b"\r").split(b"\r")
        for line in lines:
            if (frame := frame_of(line)) is not None:
                self.bus.put(*frame)
        self._rest = self._rest[-_LONGEST_LINE:]
        return True


def command(request: SlcanRequest) -> int:
    """Carry out `slcan`; return the exit code, of a program its own. UserError: wrong input."""
    if bool(request.rest) == (request.port is not None):
        raise UserError("pcpc slcan: give a serial line, or -- and a program; `pcpc slcan --help`")
    if request.bitrate not in (None, *_BIT_RATES):
        known = ", ".join(map(str, _BIT_RATES))
        raise UserError(f"--bitrate {request.bitrate:g}: slcan knows {known} bit/s")
    if request.data_bitrate not in _DATA_RATES:
        raise UserError(f"--data-bitrate {request.data_bitrate:g}: slcan knows 2M and 5M")
    signal.signal(signal.SIGTERM, _leave)
    if request.port is not None:
        line = open_port(request.port, request.baud)
        bridge = Bridge(open_bus(request.bus), line, line, str(request.port))
        if bridge.open(request.bitrate, request.data_bitrate):
            bridge.run()
        return Exit.OK
    return with_program(open_bus(request.bus), request.rest)


def _leave(_number: int, _frame: FrameType | None) -> None:
    raise SystemExit(Exit.OK)


def open_bus(text: str) -> Udp | Can:
    """Open a bus by its name; BusError."""
    return plain_bus.open_bus(buses.bus_named(*buses.parse(text)))


def with_program(bus: Udp | Can, words: Sequence[str]) -> int:
    """Run a program whose stdin and stdout are the line; return its exit code. UserError."""
    try:
        program = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    except OSError as error:
        raise UserError(f"{words[0]}: {error.strerror}") from None
    assert program.stdin is not None and program.stdout is not None, "as asked for"
    bridge = Bridge(bus, program.stdout.fileno(), program.stdin.fileno(), words[0])
    try:
        if bridge.open(None):
            bridge.run()
        return program.wait()
    finally:
        if program.poll() is None:
            program.terminate()
            program.wait()
