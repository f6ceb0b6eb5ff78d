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

A damaged file can make a library loop for ever, or unpack without end: it may take 10 s of
computing without a frame, and unpack to 200 times its size.
"""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.can.wire_layout import LENGTHS
from pcpc.drivers.errors import Exit, UserError, printable
from pcpc.drivers.machine.patience import StalledError, patience
from pcpc.executive.errors import near_file
from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import mdf
from pcpc.tools.after.log.bus_order import BusOrder, are_distances, bus_order
from pcpc.tools.after.log.readers.account import Account, NotReadError, RecordedFrame
from pcpc.tools.after.log.readers.formats import frames_of
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress

_NAMES = ("stamp_ns", "id", "dlc", "direction", "flags")
_STEP = 20_000  # frames from one look at the progress to the next
_STALL_S = 10.0
_NO_DATE_NS = 365 * 86_400 * 10**9


@dataclass(frozen=True)
class Recording:
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


def read(path: Path, channel: str | None, progress: Progress) -> Recording:
    """Read a recording, of one channel if it is named; LogCommandError: one line."""
    if not path.is_file():
        cure = near_file(path) or "; give a .log, .blf, .asc or .mf4 file"
        raise LogCommandError(f"{path}: no such file{cure}")
    account = Account()
    counted, number = _FrameCollector(channel), 0
    try:
        with patience(_STALL_S, lambda: number), frames_of(path, account) as frames:
            for number, frame in enumerate(frames, 1):
                counted.take(frame, account)
                if number % _STEP == 0:
                    progress.show(f"{path}: {number} frames")
    except NotReadError as error:
        raise LogCommandError(f"{path}: {error}") from None
    except StalledError:
        what = f"a reader hangs after frame {number}: the file is damaged there"
        raise LogCommandError(f"{path}: {what}; give the whole recording") from None
    except UserError:
        raise
    except NotImplementedError as error:  # a reader that needs another package
        raise LogCommandError(f"{path}: {error}", Exit.ENVIRONMENT) from None
    except OSError as error:
        raise LogCommandError(f"{path}: {error.strerror or error}; is it whole?") from None
    except Exception as error:  # asammdf and python-can let everything through
        reason = printable(" ".join(str(error).split())[:300]) or type(error).__name__
        what = f"damaged after {number} frames ({reason}); give the whole recording"
        raise LogCommandError(f"{path}: {what}") from None
    return counted.result(path, account)


class _FrameCollector:
    """Collects data frames, counts those that are left out."""

    def __init__(self, channel: str | None) -> None:
        self._channel = channel
        self._columns: list[list[int]] = [[], [], [], [], []]  # see `_NAMES`
        self._sources: list[int] = []  # a number for each channel and id
        self._known: dict[tuple[str, int], int] = {}
        self._data, self._width = bytearray(), 8
        self.channels: Counter[str] = Counter()

    def take(self, frame: RecordedFrame, account: Account) -> None:
        """Take one frame."""
        name = ""
        if frame.channel is not None:
            name = printable(frame.channel)
            self.channels[name] += 1
            if self._channel not in (None, name):
                return
        if frame.kind:
            account.left_out[frame.kind] += 1
            return
        size = len(frame.data)
        if frame.flags and self._width == 8:
            self._widen()
        word = can_id.word_of(frame.number, frame.extended)
        row = (frame.time_ns, word, size, int(frame.is_received), frame.flags)
        for column, value in zip(self._columns, row, strict=True):
            column.append(value)
        self._sources.append(self._known.setdefault((name, word), len(self._known)))
        self._data += frame.data.ljust(self._width, b"\0")

    def _widen(self) -> None:
        """Give all frames the room of one of CAN FD."""
        narrow = np.frombuffer(self._data, np.uint8).reshape(-1, 8)
        self._width = LENGTHS[-1]
        self._data = bytearray(np.pad(narrow, ((0, 0), (0, self._width - 8))).tobytes())

    def result(self, path: Path, account: Account) -> Recording:
        """Return all of it; LogCommandError if there is no frame."""
        stamps = np.array(self._columns[0], np.int64)
        if not len(stamps):
            raise LogCommandError(f"{path}: {self._nothing(account)}")
        if account.may_be_distances and are_distances(stamps):
            stamps = np.cumsum(stamps)
            account.note("its stamps are distances, as of candump -td: they are added up")
        if stamps.min() < _NO_DATE_NS and not any("from 1970" in note for note in account.notes):
            account.note("no date was read from it: stamps count from 1970")
        order = bus_order(stamps, np.array(self._sources, np.int64))
        frames = np.zeros(len(stamps), logs.FRAME if self._width == 8 else logs.FD_FRAME)
        for name, column in zip(_NAMES, self._columns, strict=True):
            frames[name] = column
        frames["stamp_ns"] = order.stamp_ns
        frames["data"] = np.frombuffer(self._data, np.uint8).reshape(-1, self._width)
        frames = frames[order.order]
        declared = account.declared if self._channel is None else ""
        if declared and declared == mdf.frames_sum(frames, frames["stamp_ns"]):
            declared = ""
        return Recording(frames, account, self.channels, order, declared)

    def _nothing(self, account: Account) -> str:
        """Return what there is instead of a data frame."""
        what = "no CAN frame"
        if self._channel:
            known = ", ".join(sorted(self.channels)) or "none"
            what += f" of channel {self._channel}; it has: {known}"
        elif account.left_out:
            what += f" with data; it has {left_out_text(account)} frames"
        return what + (f"; {account.damage[0]}" if account.damage else "")


def left_out_text(account: Account) -> str:
    """Return which kinds of frames were left out, and how many."""
    return ", ".join(f"{n} {kind}" for kind, n in sorted(account.left_out.items()))
