"""Other people's recordings of a CAN bus, with stamps to the ns.

    candump .log    the digits of the text: us, or ns where it has nine of them
    BLF             since the start of the file, ns or 10 us; the start has ms
    ASC             since the start of the measurement, as many digits as it has; the start has ms
    TRC             since the start of the file, as many digits as it has
    MDF 4           since the start of the file, ns; the start has ns
    others          float seconds, to the nearest us once they no longer resolve ns

Data frames are kept, with CAN FD as `logs.FD_FRAME`; all else is counted, see `readers/account.py`.
Frames come back in the order of the bus, see `bus_order.py`. A compressed file is read as the one
in it.

A damaged file can make a library loop for ever, crash, or unpack without end, so it is read in a
process of its own, with limits that scale with its size, see `readers/child.py`.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import Exit
from pcpc.drivers.machine.regular_files import open_regular
from pcpc.executive.errors import near_file
from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import mdf
from pcpc.tools.after.log.bus_order import BusOrder, are_distances, bus_order
from pcpc.tools.after.log.readers import child
from pcpc.tools.after.log.readers.account import CLASSIC_BYTES, Account
from pcpc.tools.after.log.readers.child import UNPACKS, WHOLE, ReaderLimits
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress

_NAMES = ("stamp_ns", "id", "dlc", "direction", "flags")
_NO_DATE_NS = 365 * 86_400 * 10**9


@dataclass(frozen=True)
class ForeignRecording:
    """What was read: `frames` in the order of the bus (cycle 0), `channels` counted.

    `declared`: number and checksum of other frames, which the file says it has; else "".
    """

    frames: NDArray[Any]
    account: Account
    channels: Counter[str]
    order: BusOrder
    declared: str

    @property
    def is_whole(self) -> bool:
        """Return whether its data frames are all that the file has, and says it has."""
        return self.account.is_whole and not self.declared


class EndedError(Exception):
    """A reader ended before its file did; the text is what it said last."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


@contextmanager
def reader(path: Path, channel: str | None, limits: ReaderLimits) -> Iterator[IO[bytes]]:
    """Give what a process writes that reads a recording, see `readers/child.py`.

    Whatever happens, it is gone at the end, and its files are; EndedError if it died.
    """
    with tempfile.TemporaryDirectory(prefix="pcpc-import-") as folder:
        stderr_file = Path(folder) / "stderr"
        with (
            stderr_file.open("wb") as stderr,
            subprocess.Popen(
                [sys.executable, "-P", "-m", child.__name__, child.word(path, channel, limits)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=stderr,
                env=os.environ | {"TMPDIR": folder, "OPENBLAS_NUM_THREADS": "1"},
                start_new_session=True,
            ) as process,
        ):
            assert process.stdout is not None
            try:
                yield process.stdout
            except EOFError:
                code, lines = process.wait(), stderr_file.read_text(errors="replace").splitlines()
                raise EndedError(code, lines[-1] if lines else "") from None
            finally:
                process.kill()
                process.wait()  # at an interruption `with` itself waits for no more than 0.25 s


def read(
    path: Path, channel: str | None, progress: Progress, limits: ReaderLimits | None = None
) -> ForeignRecording:
    """Read a recording, of one channel if it is named; LogCommandError: one line."""
    try:
        open_regular(path).close()
        limits = limits or ReaderLimits.of(path)
    except OSError as error:
        is_absent = isinstance(error, FileNotFoundError)
        reason = "no such file" if is_absent else error.strerror
        cure = (is_absent and near_file(path)) or "; give a .log, .blf, .asc or .mf4 file"
        raise LogCommandError(f"{path}: {reason}{cure}") from None
    blocks: list[NDArray[Any]] = []
    try:
        with reader(path, channel, limits) as stream:
            last = _last_word(stream, blocks, limits, path, progress)
    except EndedError as error:
        raise _ended(path, sum(map(len, blocks)), error) from None
    if "error" in last:
        raise LogCommandError(last["error"], Exit(last["code"]))
    account, channels = Account(**last["end"]), Counter[str](last["channels"])
    account.left_out = Counter(account.left_out)
    return _recording(path, channel, blocks, account, channels)


def _last_word(
    stream: IO[bytes],
    blocks: list[NDArray[Any]],
    limits: ReaderLimits,
    path: Path,
    progress: Progress,
) -> dict[str, Any]:
    """Append the blocks of rows; return what comes behind them. EOFError: the reader died."""
    number = size = 0
    while True:
        line = stream.readline()
        if not line.endswith(b"\n"):
            raise EOFError
        head: dict[str, Any] = json.loads(line)
        if "rows" not in head:
            return head
        kind = child.row_type(head["width"])
        block = stream.read(head["rows"] * kind.itemsize)
        if len(block) < head["rows"] * kind.itemsize:
            raise EOFError
        blocks.append(np.frombuffer(block, kind))
        number, size = number + head["rows"], size + len(block)
        if size > limits.bytes:
            raise LogCommandError(f"{path}: {UNPACKS}")
        if number >= child.AT_ONCE:
            progress.show(f"{path}: {number} frames")


def _ended(path: Path, number: int, error: EndedError) -> LogCommandError:
    """Return in a line what became of a reader after `number` frames or a few more."""
    after = f"after {number} frames or a few more"
    there = f"the file is damaged there; {WHOLE}"
    if error.code == -signal.SIGXCPU:
        return LogCommandError(f"{path}: its reader hangs {after}: {there}")
    if error.code == -signal.SIGKILL:
        problem = f"its reader was killed {after}; free memory, and import it again"
        return LogCommandError(f"{path}: {problem}", Exit.ENVIRONMENT)
    if error.code < 0:
        name = signal.Signals(-error.code).name
        return LogCommandError(f"{path}: its reader crashed by {name} {after}: {there}")
    problem = f"its reader ended {after} with exit code {error.code} ({error})"
    return LogCommandError(f"{path}: {problem}; try `pcpc doctor`", Exit.ENVIRONMENT)


def _recording(
    path: Path,
    channel: str | None,
    blocks: list[NDArray[Any]],
    account: Account,
    channels: Counter[str],
) -> ForeignRecording:
    """Return all of it; LogCommandError if there is no frame."""
    count = sum(map(len, blocks))
    if not count:
        raise LogCommandError(f"{path}: {_nothing(account, channel, channels)}")
    is_wide = any(block["data"].shape[1] > CLASSIC_BYTES for block in blocks)
    frames = np.zeros(count, logs.FD_FRAME if is_wide else logs.FRAME)
    source, done = np.zeros(count, np.int64), 0
    for block in blocks:
        part = slice(done, done := done + len(block))
        for name in _NAMES:
            frames[name][part] = block[name]
        frames["data"][part, : block["data"].shape[1]] = block["data"]
        source[part] = block["source"]
    stamps = frames["stamp_ns"].copy()
    if account.may_be_distances and are_distances(stamps):
        stamps = np.cumsum(stamps)
        account.note("its stamps are distances, as of candump -td: they are added up")
    if stamps.min() < _NO_DATE_NS and not any("from 1970" in note for note in account.notes):
        account.note("no date was read from it: stamps count from 1970")
    order = bus_order(stamps, source)
    frames["stamp_ns"] = order.stamp_ns
    frames = frames[order.order]
    declared = account.declared if channel is None else ""
    if declared and declared == mdf.frames_sum(frames, frames["stamp_ns"]):
        declared = ""
    return ForeignRecording(frames, account, channels, order, declared)


def _nothing(account: Account, channel: str | None, channels: Counter[str]) -> str:
    """Return what there is instead of a data frame."""
    absence = "no CAN frame"
    if channel:
        known = ", ".join(sorted(channels)) or "none"
        absence += f" of channel {channel}; it has: {known}"
    elif account.left_out:
        absence += f" with data; it has {left_out_text(account)} frames"
    return absence + (f"; {account.damage[0]}" if account.damage else "")


def left_out_text(account: Account) -> str:
    """Return which kinds of frames were left out, and how many."""
    return ", ".join(f"{n} {kind}" for kind, n in sorted(account.left_out.items()))
