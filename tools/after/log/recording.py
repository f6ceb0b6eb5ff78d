"""Other people's recordings of a CAN bus, read by python-can, with stamps to the ns.

    candump .log    the digits of the text: us, or ns where it has nine of them
    BLF             since the start of the file, ns or 10 us; the start has ms
    ASC             since the start of the measurement, as many digits as it has; the start has ms
    MDF 4           since the start of the file, ns; the start has ns
    others          float seconds, to the nearest us once they no longer resolve ns

Data frames are kept, with CAN FD as `logs.FD_FRAME`; error and remote frames are counted.
Frames come back by stamp. A compressed file ends in .gz behind its own suffix.

A damaged file can make python-can loop for ever, or unpack without end: it may take 10 s of
computing without a frame, unpack to 200 times its size, and hold a frame for each of its bytes.
"""

import gc
import gzip
import logging
import math
import re
import sys
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.can.wire_layout import LENGTHS, flags_of
from pcpc.drivers.errors import Exit, printable
from pcpc.drivers.machine.patience import StalledError, patience
from pcpc.executive.errors import near_file
from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import mdf
from pcpc.tools.terminal.extras import need
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress

if TYPE_CHECKING:
    from can import Message

_NAMES = ("stamp_ns", "id", "dlc", "direction", "flags")
_STEP = 20_000  # frames from one look at the progress to the next
_ERROR_FRAME = 0x20000000  # in the id of a candump line
_STALL_S = 10.0
_UNPACKED, _UNPACKED_PER_BYTE, _FRAMES = 16 << 20, 200, 1000
_BUS_EVENT, _BUS = 2, ("CAN_DataFrame", "CAN_ErrorFrame", "CAN_RemoteFrame")  # of MDF
_BLF_OBJECT, _BLF_CONTAINER, _BLF_ZLIB = 16, 10, 2  # size of a head; a kind; a method
_RESOLVES_NS_S = 2.0**22  # float64 seconds from here on are more than 1 ns apart


@dataclass(frozen=True)
class Recording:
    """What was read: `frames` by stamp (cycle 0), `left_out` and `channels` counted.

    `declared`: number and checksum of other frames, which the file says it has; else "".
    """

    frames: NDArray[Any]
    left_out: Counter[str]
    channels: Counter[str]
    unsorted: int  # frames stamped before the frame ahead of them in the file
    declared: str


class _Candump:
    """The lines of a candump log; keeps what python-can loses: digits, and what is an error."""

    def __init__(self, file: Any) -> None:
        self._file = file
        self.time_ns = 0
        self.is_error = False

    def __iter__(self) -> Iterator[str]:
        for line in self._file:
            words = line.split()
            if words:
                whole, _, digits = words[0].strip("()").partition(".")
                self.time_ns = int(whole) * 10**9 + int((digits + "000000000")[:9])
                number = words[2].partition("#")[0]
                self.is_error = len(number) > 3 and bool(int(number, 16) & _ERROR_FRAME)
            yield line

    def close(self) -> None:
        self._file.close()


def read(path: Path, channel: str | None, progress: Progress) -> Recording:
    """Read a recording, of one channel if it is named; LogCommandError: one line."""
    import can

    if not path.is_file():
        cure = near_file(path) or "; give a .log, .blf, .asc or .mf4 file"
        raise LogCommandError(f"{path}: no such file{cure}")
    if _kind(path) == ".mf4":
        need("MDF needs", "asammdf")
    logging.getLogger("can").setLevel(logging.ERROR)  # what it warns about is told or left out
    counted, number = _FrameCollector(channel), 0
    try:
        _check_unpacked(path)
        most = _FRAMES + path.stat().st_size
        with patience(_STALL_S, lambda: number):
            for number, (message, time_ns) in enumerate(_messages(path), 1):
                counted.take(message, time_ns)
                if number > most:
                    raise ValueError("it holds more frames than bytes: an object without a size?")
                if number % _STEP == 0:
                    progress.show(f"{path}: {number} frames")
    except StalledError:
        what = f"python-can hangs after frame {number}: the file is damaged there"
        raise LogCommandError(f"{path}: {what}; give the whole recording") from None
    except LogCommandError:
        raise
    except NotImplementedError as error:  # a reader that needs another package
        raise LogCommandError(f"{path}: {error}", Exit.ENVIRONMENT) from None
    except OSError as error:
        raise LogCommandError(f"{path}: {error.strerror or error}; is it whole?") from None
    except Exception as error:  # python-can's readers let everything through
        if isinstance(error, ValueError) and "No read support" in str(error):
            known = ", ".join(can.io.player.MESSAGE_READERS)
            what = f"no format is known by this suffix; known: {known}"
        else:
            reason = printable(" ".join(str(error).split())[:300]) or type(error).__name__
            what = f"damaged after {number} frames ({reason}); give the whole recording"
        raise LogCommandError(f"{path}: {what}") from None
    recording = counted.result(path)
    if _kind(path) == ".mf4" and channel is None:
        return replace(recording, declared=_sum_of_others(path, recording.frames))
    return recording


def _kind(path: Path) -> str:
    """Return the suffix, of a compressed file that before .gz."""
    return Path(path.stem if path.suffix == ".gz" else path.name).suffix.lower()


def _opened(path: Path) -> Any:
    return gzip.open(path) if path.suffix == ".gz" else path.open("rb")


def _check_unpacked(path: Path) -> None:
    """Raise ValueError for a compressed file that unpacks to more than a recording can hold."""
    most = _UNPACKED + _UNPACKED_PER_BYTE * path.stat().st_size
    packed = path.suffix == ".gz"
    if packed:
        with gzip.open(path) as file:
            while data := file.read(1 << 20):
                if (most := most - len(data)) < 0:
                    raise ValueError("it unpacks to more than 200 times its size")
    if _kind(path) != ".blf":
        return
    with _opened(path) as blf:
        head = blf.read(8)
        blf.seek(int.from_bytes(head[4:8], "little"))
        while (head := blf.read(_BLF_OBJECT))[:4] == b"LOBJ":
            size, kind = (int.from_bytes(head[i : i + 4], "little") for i in (8, 12))
            if size < _BLF_OBJECT:
                raise ValueError("an object without a size")
            body = blf.read(min(size - _BLF_OBJECT, most))
            blf.read(size % 4)
            if kind == _BLF_CONTAINER and body[:2] == bytes((_BLF_ZLIB, 0)):
                most -= _inflated_size(body[_BLF_OBJECT:], most)
            if most < 0:
                raise ValueError("it unpacks to more than 200 times its size")


def _inflated_size(data: bytes, most: int) -> int:
    """Return how many bytes a zlib stream has, counted a little beyond `most` at the furthest."""
    stream, size = zlib.decompressobj(), 0
    while data and size <= most and not stream.eof:
        size += len(stream.decompress(data, 1 << 20))
        data = stream.unconsumed_tail
    return size


def _messages(path: Path) -> Iterator[tuple["Message", int]]:
    """Yield messages with their stamps in ns; whatever python-can raises."""
    import can

    if _kind(path) == ".mf4":
        yield from _mdf_messages(path)
        return
    reader: Any = can.LogReader(path)
    if isinstance(reader, can.CanutilsLogReader):
        reader.file = lines = _Candump(reader.file)  # type: ignore[assignment]
        for message in reader:
            message.is_error_frame = message.is_error_frame or lines.is_error
            yield message, lines.time_ns
        return
    start_ns = 0
    if isinstance(reader, can.BLFReader):
        if path.suffix == ".blf" and reader.file_size > path.stat().st_size:
            raise ValueError(f"{path.stat().st_size} of {reader.file_size} bytes")
        start_ns, reader.start_timestamp = round(1e3 * reader.start_timestamp) * 10**6, 0.0
    elif isinstance(reader, can.ASCReader):
        start_ns = _asc_start_ns(path)
    elif isinstance(reader, can.SqliteReader):  # signals do not reach a query; this does
        calls = iter(range(path.stat().st_size))
        vars(reader)["_conn"].set_progress_handler(lambda: next(calls, None) is None, 1000)
    for message in reader:
        yield message, start_ns + _to_ns(message.timestamp)


class _Damage(logging.Handler):
    """Makes an error of what asammdf warns about and leaves out, but for attachments."""

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage().partition("Traceback")[0]
        if "ttach" not in text:
            raise ValueError(text)


def _mdf_messages(path: Path) -> Iterator[tuple["Message", int]]:
    """Yield messages of bus logging; ValueError if some are missing, or whatever is raised."""
    found = declared = 0
    most = _UNPACKED + _UNPACKED_PER_BYTE * path.stat().st_size
    with _opened(path) as file, _mdf_reader(file) as reader:
        version = reader._mdf.version
        for group in reader._mdf.groups if version >= "4" else ():
            head = group.channel_group
            if head.flags & _BUS_EVENT and any(str(c.name) in _BUS for c in group.channels):
                declared += head.cycles_nr
                most -= sum(block.original_size or 0 for block in group.data_blocks)
        if not declared:
            what = f"MDF {version} without bus logging of CAN; give one with it"
            raise LogCommandError(f"{path}: {what}")
        if most < 0:
            raise ValueError("it unpacks to more than 200 times its size")
        start_ns, reader._start_timestamp = _mdf_start_ns(reader._mdf.header), 0.0
        for message in reader:
            found += 1
            yield message, start_ns + _to_ns(message.timestamp)
    if found != declared:
        raise ValueError(f"{found} of {declared} frames")


def _sum_of_others(path: Path, frames: NDArray[Any]) -> str:
    """Return number and checksum that the comment of an MDF file has, if these are not of them."""
    with _opened(path) as file, _mdf_reader(file) as reader:
        declared = re.search(r"\d+ data frames, CRC-32 [0-9A-F]{8}", reader._mdf.header.comment)
    if declared is None or declared[0] == mdf.frames_sum(frames, frames["stamp_ns"]):
        return ""
    return declared[0]


def _mdf_reader(file: Any) -> Any:
    """Return python-can's reader; ValueError says in a line why there is none."""
    import asammdf  # sets up its log
    import can

    log = logging.getLogger(asammdf.__name__)
    log.setLevel(logging.WARNING)
    log.handlers = [_Damage()]
    try:
        return can.MF4Reader(file)
    except Exception as error:
        reason = str(error) or type(error).__name__
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    gc.collect()  # an MDF that was not read prints a traceback as it is deleted
    sys.unraisablehook = hook
    raise ValueError(reason)


def _mdf_start_ns(header: Any) -> int:
    """Return the wall time of t = 0, which may be in the local zone."""
    start = header.start_time
    zone_s = 0.0 if start.tzinfo else start.timestamp() - start.replace(tzinfo=UTC).timestamp()
    return int(header.abs_time) + round(zone_s) * 10**9


def _asc_start_ns(path: Path) -> int:
    """Return the wall time of an ASC file's t = 0; 0 if its date is not one that python-can reads.

    Raises ValueError for stamps that count from the event before: events that are no frames are
    skipped, so their sum would be wrong.
    """
    import can

    reader: Any = can.LogReader(path, relative_timestamp=False)
    try:
        next(iter(reader), None)
    except ValueError as error:
        if "datetime" not in str(error):
            raise
        return 0
    finally:
        reader.stop()
    if reader.timestamps_format == "relative":
        raise ValueError("its time stamps are relative; convert them to absolute ones")
    return round(1e3 * reader.start_time) * 10**6


def _to_ns(seconds: float) -> int:
    whole = math.floor(seconds)
    if abs(seconds) < _RESOLVES_NS_S:
        return whole * 10**9 + round((seconds - whole) * 1e9)
    return whole * 10**9 + round((seconds - whole) * 1e6) * 1000


class _FrameCollector:
    """Collects frames, counts what is not kept."""

    def __init__(self, channel: str | None) -> None:
        self._channel = channel
        self._columns: list[list[int]] = [[], [], [], [], []]  # see `_NAMES`
        self._data, self._width = bytearray(), 8
        self.left_out: Counter[str] = Counter()
        self.channels: Counter[str] = Counter()

    def take(self, message: "Message", time_ns: int) -> None:
        """Take one message; ValueError if no bus could have carried it."""
        if message.channel is not None:  # as in an error frame of candump
            name = printable(str(message.channel))
            self.channels[name] += 1
            if self._channel not in (None, name):
                return
        if message.is_error_frame or message.is_remote_frame:
            self.left_out["error" if message.is_error_frame else "remote"] += 1
            return
        number, dlc, extended = message.arbitration_id, message.dlc, message.is_extended_id
        if dlc not in LENGTHS[: None if message.is_fd else 9] or len(message.data) != dlc:
            raise ValueError(f"id {number:#x}: {len(message.data)} of {dlc} bytes")
        if not 0 <= number < (1 << 29 if extended else 1 << 11) or not 0 <= time_ns < 2**63:
            raise ValueError(f"id {number:#x} at {time_ns} ns")
        if message.is_fd and self._width == 8:
            self._widen()
        flags = flags_of(message)
        row = (time_ns, can_id.word_of(number, extended), dlc, int(message.is_rx), flags)
        for column, value in zip(self._columns, row, strict=True):
            column.append(value)
        self._data += bytes(message.data).ljust(self._width, b"\0")

    def _widen(self) -> None:
        """Give all frames the room of one of CAN FD."""
        narrow = np.frombuffer(self._data, np.uint8).reshape(-1, 8)
        self._width = LENGTHS[-1]
        self._data = bytearray(np.pad(narrow, ((0, 0), (0, self._width - 8))).tobytes())

    def result(self, path: Path) -> Recording:
        """Return all of it; LogCommandError if there is no frame."""
        stamps = np.array(self._columns[0], np.int64)
        if not len(stamps):
            known = ", ".join(sorted(self.channels)) or "none"
            what = f" of channel {self._channel}; it has: {known}" if self._channel else ""
            raise LogCommandError(f"{path}: no CAN frame{what}")
        order = np.argsort(stamps, kind="stable")
        frames = np.zeros(len(stamps), logs.FRAME if self._width == 8 else logs.FD_FRAME)
        for name, column in zip(_NAMES, self._columns, strict=True):
            frames[name] = column
        frames["data"] = np.frombuffer(self._data, np.uint8).reshape(-1, self._width)
        unsorted = int((np.diff(stamps) < 0).sum())
        return Recording(frames[order], self.left_out, self.channels, unsorted, "")
