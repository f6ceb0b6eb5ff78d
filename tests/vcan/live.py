"""`pcpc` commands on vcan0 as a user starts them; candump and python-can, which look on."""

import itertools
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import can

from pcpc.executive.log import reader as logs

ROOT = Path(__file__).resolve().parents[2]
PCPC = str(Path(sys.executable).with_name("pcpc"))
RIG = "plants/atb1000/rigs/slew10.yaml"
DBC = ROOT / "plants" / "atb1000" / "atb1000.dbc"
CHANNEL = "vcan0"
CMD, FB_A = 0x0A0, 0x120
N_HEARD, N_CORRUPT = 200, 2  # frames read by python-can, corrupt ones sent: a third is a fault
MARK = 0x7FF  # id of the frame that ends a candump: no node sends it
PATIENCE_S = 400.0  # only waited for when a node does not come up

Frame = tuple[int, bytes]  # id, data


class Command:
    """A `pcpc` command on the rig, started; its log goes into `folder`."""

    def __init__(self, folder: Path, word: str, settings: Sequence[str], *options: str) -> None:
        self.folder = folder
        self.words = [PCPC, word, RIG, "--quiet", "--no-figure", *options]
        if "--only=plant" not in options:  # whose log is the executive's
            self.words += ["--json", "-o", str(folder)]
        self.words += itertools.chain.from_iterable(("--set", setting) for setting in settings)
        self.process = subprocess.Popen(
            self.words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    @property
    def running(self) -> bool:
        """True until the command has ended."""
        return self.process.poll() is None

    @property
    def children(self) -> list[int]:
        """Process ids of the nodes and the recorder, in the order of their start."""
        pid = self.process.pid
        return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]

    def done(self) -> "Done":
        """Wait for the end and return what came of it; a command that hangs is ended."""
        try:
            out, err = self.process.communicate(timeout=PATIENCE_S)
        finally:
            if self.running:
                self.process.terminate()
                self.process.wait()
        return Done(self.folder, self.words, self.process.returncode, out, err)


@dataclass(frozen=True)
class Done:
    """What came of a command."""

    folder: Path
    words: Sequence[str]
    code: int
    out: str
    err: str

    def __str__(self) -> str:
        return f"{' '.join(self.words)}\nexit code {self.code}\n{self.out}\n{self.err}"

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The summary that --json printed."""
        try:
            return dict(json.loads(self.out))
        except ValueError:
            raise AssertionError(f"no summary came:\n{self}") from None

    @cached_property
    def log(self) -> logs.Log:
        """The log, read once."""
        return logs.read(self.folder / "log.mcap")


@dataclass(frozen=True)
class Observed:
    """A run; what candump saw of it; the first N_HEARD of CMD and FB_A that python-can heard."""

    run: Done
    candump: Path
    python_can: list[Frame]

    @cached_property
    def frames(self) -> list[Frame]:
        """Candump's frames in the order of the bus."""
        return frames_in(self.candump)


@dataclass(frozen=True)
class Pair:
    """Executive and plant, each started by itself, and the executive that came second."""

    executive: Done
    plant: Done
    refused: Done
    executive_pid: int


def until(met: Callable[[], Any], what: str) -> None:
    """Wait for an event of another process; AssertionError with `what` if it does not come."""
    end_s = time.monotonic() + PATIENCE_S
    while not met():
        assert time.monotonic() < end_s, f"not within {PATIENCE_S:g} s: {what}"
        time.sleep(0.05)


def somebody_hears_all_frames() -> bool:
    """Return True if a socket without filter is bound to vcan0: candump's, no node's."""
    with open("/proc/net/can/rcvlist_all") as receivers:
        return any(line.split()[:1] == [CHANNEL] for line in receivers)


@contextmanager
def candump_into(path: Path) -> Iterator[None]:
    """Write every frame that is sent inside the `with` to `path`, as lines of `candump -L`."""
    command = ["candump", "-L", "-r", str(16 << 20), CHANNEL]
    mark = f" {MARK:03X}#\n"
    with path.open("w") as out, subprocess.Popen(command, stdout=out) as candump:
        try:
            until(somebody_hears_all_frames, "candump listens")
            yield
            cansend(MARK, b"")
            until(lambda: path.read_text().endswith(mark), "candump has written all")
        finally:
            candump.terminate()
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))


def frames_in(candump: Path) -> list[Frame]:
    """Return the frames of a log of candump in the order of the bus."""
    words = [line.split()[2].split("#") for line in candump.read_text().splitlines()]
    return [(int(number, 16), bytes.fromhex(data)) for number, data in words]


def cansend(can_id: int, data: bytes) -> None:
    """Send one frame with can-utils' tool."""
    subprocess.run(["cansend", CHANNEL, f"{can_id:03X}#{data.hex()}"], check=True)


def crc8_j1850(data: bytes) -> int:
    """Return the CRC bit by bit, as SAE J1850 defines it."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x1D) & 0xFF if crc & 0x80 else crc << 1
    return crc ^ 0xFF


@contextmanager
def python_can(*ids: int) -> Iterator[can.BusABC]:
    """Open python-can's own SocketCAN bus for these ids."""
    filters = [can.typechecking.CanFilter(can_id=i, can_mask=0x7FF, extended=False) for i in ids]
    with can.Bus(interface="socketcan", channel=CHANNEL, can_filters=filters) as bus:
        yield bus


def heard(bus: can.BusABC, command: Command) -> Iterator[Frame]:
    """Yield what python-can receives until the command ends."""
    while True:
        message = bus.recv(1.0)
        if message is not None:
            yield message.arbitration_id, bytes(message.data)
        elif not command.running:
            return
