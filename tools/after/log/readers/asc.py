"""Vector's ASC, also as BUSMASTER, python-can and others write it.

    date Thu Nov 16 10:20:30.123 am 2023
    base hex  timestamps absolute
    Begin TriggerBlock Thu Nov 16 10:20:30.123 am 2023
       0.100000 1  100             Rx   d 8 10 27 64 00 00 00 00 00  Length = ... ID = 256
       0.110000 CANFD   1 Rx        100  NAME  1 0 8  8 10 27 ...  104812  132   303000 ...
       0.120000 CANXL   1 Rx   FBFF   243215   176  100  NAME  8 8 10 27 ...
    End TriggerBlock

A line counts by what it says of itself: bit 12 of the flags of a CANFD line is that of CAN FD, bit
4 of a remote frame. TxRq asks for a frame, and is none. Relative stamps count from the line before.
"""

import re
from collections.abc import Iterator, Sequence
from typing import IO

from pcpc.drivers.can.wire_layout import LENGTHS, Flag
from pcpc.tools.after.log.readers.account import (
    STANDARD_IDS,
    Account,
    RecordedFrame,
    classic_bytes,
    data_frame,
    ns_of,
    number_of,
)
from pcpc.tools.after.log.readers.dates import date_ns, unknown_date
from pcpc.tools.after.log.readers.lines import NO_END, foreign_line, frames_of_lines

_FD_BIT, _BRS_BIT, _ESI_BIT, _REMOTE_BIT = 0x1000, 0x2000, 0x4000, 0x10
_SKIPPED = {"CBFF": 1, "CEFF": 1, "FBFF": 2, "FEFF": 2}  # words between data and flags
_STAMP = re.compile(r"-?\d+[.,]\d+")
_WAYS = {"rx": True, "tx": False, "txrq": False}
_NUMBER = re.compile(r"\bID = (\d+)(x?)")
_LIKE_CLASSIC = re.compile(r"\s(Rx|Tx)\s+d\s+[0-9a-f]{1,2}\b", re.IGNORECASE)
_LIKE_A_FRAME = re.compile(r"\s(Rx|Tx)\s+(d|r|\S+\s+[01]\s+[01])\s", re.IGNORECASE)


def frames(file: IO[bytes], account: Account) -> Iterator[RecordedFrame]:
    """Yield the frames of a file."""
    return frames_of_lines(file, account, _Asc(account))


class _Asc:
    """The lines of a file, and what has to be known of those before."""

    def __init__(self, account: Account) -> None:
        self._account = account
        self._base, self._relative = 16, False
        self._start_ns = self._sum_ns = 0
        self._in_block = self._begun = False
        self._dated_by_block = False
        self._odd_date = ""

    def frame(self, line: str, has_end: bool) -> RecordedFrame | None:
        """Return the frame of a line; None for a header, a comment, an event."""
        words = line.split()
        if words[0].startswith("//"):
            return None
        if not _STAMP.fullmatch(words[0]):
            self._read_header(line, words)
            return None
        time_ns = self._start_ns + ns_of(words[0])
        if self._relative:
            self._sum_ns += ns_of(words[0])
            time_ns = self._start_ns + self._sum_ns
        self._begun = True
        frame = self._of_words(time_ns, words, line if has_end else None)
        if frame is None and not has_end:
            raise ValueError(NO_END)
        if frame is None and "J1939TP" not in words[1:3] and _LIKE_CLASSIC.search(line):
            raise foreign_line(line, "ASC with a channel and an id")
        if frame is None and "Start of measurement" not in line:
            self._account.others += 1
        return frame

    def finish(self) -> None:
        """Note a block that has no end, and a date that nothing else replaces."""
        if self._odd_date and not self._start_ns:
            self._account.note(unknown_date(self._odd_date))
        if self._in_block:
            self._account.lose("at the end", "no `End TriggerBlock`: the recording is cut there")

    def _read_header(self, line: str, words: Sequence[str]) -> None:
        """Read a line without a stamp; ValueError for one that belongs to no ASC file."""
        first, rest = words[0].lower(), line.split(None, 1)[1:]
        block = " ".join(words[:2]).lower()
        if first == "date" and rest:
            self._start(rest[0], not self._dated_by_block)
        elif first == "base" and len(words) > 1 and words[1].lower() in ("hex", "dec"):
            self._base = 16 if words[1].lower() == "hex" else 10
            self._relative = "timestamps relative" in " ".join(words).lower()
        elif block == "begin triggerblock":
            self._in_block = True
            if not self._begun and len(words) > 2:
                self._start(line.split(None, 2)[2], True)
                self._dated_by_block = True
        elif block == "end triggerblock":
            self._in_block = False
        elif "internal events logged" in line.lower():
            pass
        elif self._begun or _LIKE_A_FRAME.search(line):
            raise foreign_line(line, "ASC")

    def _start(self, date: str, wanted: bool) -> None:
        start_ns = date_ns(date)
        if start_ns is None:
            self._odd_date = date.strip()[:40]
        elif wanted:
            self._start_ns = start_ns

    def _of_words(
        self, time_ns: int, words: Sequence[str], line: str | None
    ) -> RecordedFrame | None:
        """Return the frame of a line that begins with a stamp; `line` is None if it has no end."""
        kind = words[1].upper() if len(words) > 1 else ""
        if kind == "CANFD":
            return self._of_canfd(time_ns, words[2:], line is None)
        if kind == "CANXL":
            return self._of_canxl(time_ns, words[2:])
        if not kind.isdigit() or len(words) < 3:
            return None
        channel = str(int(kind) - 1)
        if words[2].lower().startswith("errorframe"):
            return RecordedFrame(time_ns, channel=channel, kind="error")
        way = words[3].lower() if len(words) > 3 else ""
        if way not in _WAYS or len(words) < 5:
            return None
        form = words[4].lower()
        if way == "txrq" or form == "r":
            kind = "request" if way == "txrq" else "remote"
            return RecordedFrame(time_ns, channel=channel, kind=kind)
        if form != "d" or len(words) < 6:
            raise foreign_line(" ".join(words), "ASC")
        size = classic_bytes(number_of(words[5], 16, "a DLC"))
        tail = words[6 : 6 + size]
        data = self._data(tail, size)
        if line is None and len(words) == 6 + size and (self._base == 10 or len(words[-1]) < 2):
            raise ValueError(NO_END)
        number, extended = self._id(words[2], words[6 + size :])
        if number < 0:
            return RecordedFrame(time_ns, channel=channel, kind="symbolic")
        return data_frame(time_ns, number, extended, data, is_received=_WAYS[way], channel=channel)

    def _of_canfd(self, time_ns: int, words: Sequence[str], is_cut: bool) -> RecordedFrame | None:
        """Return the frame of: channel, way, id, perhaps a name, BRS, ESI, DLC, length, data."""
        if len(words) < 3 or not words[0].isdigit() or words[1].lower() not in _WAYS:
            return None
        channel = str(int(words[0]) - 1)
        if words[2].lower().startswith("errorframe"):
            return RecordedFrame(time_ns, channel=channel, kind="error")
        if words[1].lower() == "txrq":
            return RecordedFrame(time_ns, channel=channel, kind="request")
        head = next((i for i in (3, 4) if _is_fd_head(words[i : i + 4])), None)
        if head is None:
            raise foreign_line(" ".join(words), "ASC with BRS, ESI, DLC and length")
        brs, esi, dlc, size = words[head : head + 4]
        tail = words[head + 4 :]
        data = self._data(tail[: int(size)], int(size))
        if is_cut and len(tail) < int(size) + 3:
            raise ValueError(NO_END)
        marks = _FD_BIT
        if len(tail) >= int(size) + 3:
            marks = number_of(tail[int(size) + 2], 16, "flags")
        is_fd = bool(marks & _FD_BIT) or len(data) > 8
        if marks & _REMOTE_BIT and not is_fd:
            return RecordedFrame(time_ns, channel=channel, kind="remote")
        number, extended = self._id(words[2], ())
        if number < 0:
            return RecordedFrame(time_ns, channel=channel, kind="symbolic")
        flags: int = Flag.FD | (Flag.BRS if brs == "1" else 0) | (Flag.ESI if esi == "1" else 0)
        if is_fd:
            data = data.ljust(LENGTHS[int(dlc, 16)], b"\0")
        received = words[1].lower() == "rx"
        return data_frame(
            time_ns, number, extended, data, flags if is_fd else Flag.NONE, received, channel
        )

    def _of_canxl(self, time_ns: int, words: Sequence[str]) -> RecordedFrame | None:
        """Return the frame of: channel, way, form, two times, id, perhaps a name, DLC, length."""
        if len(words) < 6 or not words[0].isdigit() or words[1].lower() not in _WAYS:
            return None
        channel, form = str(int(words[0]) - 1), words[2].upper()
        if words[1].lower() == "txrq" or form not in _SKIPPED:
            kind = "request" if words[1].lower() == "txrq" else "CAN XL"
            return RecordedFrame(time_ns, channel=channel, kind=kind)
        head = next((i for i in (6, 7) if _is_length(words[i : i + 2])), None)
        if head is None:
            raise foreign_line(" ".join(words), "ASC with DLC and length")
        size, tail = int(words[head + 1]), words[head + 2 :]
        at = size + _SKIPPED[form]
        marks = number_of(tail[at], 16, "flags") if len(tail) > at else 0
        if form.startswith("C") and marks & _REMOTE_BIT:
            return RecordedFrame(time_ns, channel=channel, kind="remote")
        flags: int = Flag.NONE
        if form.startswith("F"):
            flags = Flag.FD | (Flag.BRS if marks & _BRS_BIT else 0)
            flags |= Flag.ESI if marks & _ESI_BIT else 0
        number, extended = self._id(words[5], ())
        if number < 0:
            return RecordedFrame(time_ns, channel=channel, kind="symbolic")
        data, received = self._data(tail[:size], size), words[1].lower() == "rx"
        return data_frame(time_ns, number, extended, data, flags, received, channel)

    def _id(self, text: str, rest: Sequence[str]) -> tuple[int, bool]:
        """Return an id and whether it has 29 bits; -1 for a name that nothing explains."""
        extended = text[-1:] in "xX"
        try:
            number = int(text[:-1] if extended else text, self._base)
        except ValueError:
            number = -1
        said = _NUMBER.search(" ".join(rest))
        if said and not text[0].isdigit():  # a name may look like a number: FEED
            number, extended = int(said[1]), bool(said[2])
        return number, extended or number >= STANDARD_IDS

    def _data(self, words: Sequence[str], size: int) -> bytes:
        if len(words) < size:
            raise ValueError(f"{len(words)} of {size} bytes")
        numbers = [number_of(word, self._base, "a byte") for word in words]
        if any(number > 255 for number in numbers):
            raise ValueError(f"a byte of {max(numbers)}; expected 0 to 255")
        return bytes(numbers)


def _is_fd_head(words: Sequence[str]) -> bool:
    """Return whether these are BRS, ESI, DLC and a length that fits it."""
    return set(words[:2]) <= {"0", "1"} and _is_length(words[2:])


def _is_length(words: Sequence[str]) -> bool:
    """Return whether these are a DLC and a length that fits it."""
    if len(words) < 2 or not (words[1].isascii() and words[1].isdigit()):
        return False
    try:
        return int(words[1]) <= LENGTHS[int(words[0], 16)]
    except (ValueError, IndexError):
        return False
