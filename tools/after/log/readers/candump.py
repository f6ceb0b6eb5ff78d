"""candump's two forms: the log (`-l`, `-L`) and the screen, with any of its stamps.

    (1700000000.000100) can0 123#1122334455667788      a log; ##FLAGS for CAN FD, ### for CAN XL
     (1700000000.000100)  can0  123   [8]  11 22 ...   the screen with -ta; -t A has a date there
      can0  123   [8]  11 22 33 44 55 66 77 88          the screen without stamps

Comments (`#`), numbers before lines, and what `-e`, `-x`, `-a`, `-c` and `-8` add are read over.
The bytes of `-i` are binary, those of `-S` in reverse. What `-d` says of dropped frames is a loss.
The stamps of `-td` are distances: whether a file has them shows only once all of it is read.
"""

import re
from collections.abc import Iterator
from datetime import datetime
from typing import IO

from pcpc.drivers.can.wire_layout import Flag
from pcpc.tools.after.log.readers.account import (
    CLASSIC_BYTES,
    Account,
    RecordedFrame,
    classic_bytes,
    data_frame,
    ns_of,
    number_of,
)
from pcpc.tools.after.log.readers.lines import NO_END, foreign_line, frames_of_lines

_ERROR, _REMOTE, _ID = 0x20000000, 0x40000000, 0x1FFFFFFF
_STANDARD_DIGITS = 3
_STEP_NS = 1_000_000  # between frames that have no stamps
_STAMP = r"(?:\d+[.:)]?\s+)?\((?P<stamp>[^()]*)\)\s+"
_LOG = re.compile(
    rf"\s*{_STAMP}(?P<channel>\S+)\s+(?P<id>[0-9A-Fa-f]{{1,8}})#(?P<rest>\S*)"
    r"(?:\s+(?P<way>[RrTt]))?\s*"
)
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_DROPPED = re.compile(r"DROPCOUNT: dropped (\d+)")
_SWAPPED, _BINARY = "`", re.compile(r"[01]{8}")
_SCREEN = re.compile(
    rf"\s*(?:{_STAMP})?(?P<channel>\S+)\s+(?:(?P<way>[RT]X)\s+(?P<set>[B-]\s+[E-])\s+)?"
    r"(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})\s+[\[{](?P<length>[0-9A-Fa-f]{1,4})[\]}](?P<rest>.*)"
)


def frames(file: IO[bytes], account: Account) -> Iterator[RecordedFrame]:
    """Yield the frames of a file."""
    return frames_of_lines(file, account, _Candump(account))


class _Candump:
    """The lines of a file, and what has to be known of those before."""

    def __init__(self, account: Account) -> None:
        self._account = account
        self._count = 0
        self._lengths: dict[tuple[int, int], int] = {}  # id, digits: bytes of its last frame
        account.may_be_distances = True

    def frame(self, line: str, has_end: bool) -> RecordedFrame | None:
        """Return the frame of a line; ValueError for what is none."""
        line = _COLOUR.sub("", line)
        if line.lstrip().startswith("#"):
            return None
        if dropped := _DROPPED.match(line):
            raise ValueError(f"candump says that {dropped[1]} frames were dropped")
        if line.startswith("\t"):  # -e explains an error frame
            self._account.others += 1
            return None
        log, screen = _LOG.fullmatch(line), None
        if log is None and (screen := _SCREEN.fullmatch(line)) is None:
            raise foreign_line(line, "candump") if has_end else ValueError(NO_END)
        time_ns = self._time_ns((log or screen)["stamp"])  # type: ignore[index]
        frame = self._of_log(log, time_ns) if log else self._of_screen(screen, time_ns)
        self._count += 1
        if not has_end and log and not frame.kind:
            self._check_whole(frame)
        self._lengths[frame.number, frame.extended] = len(frame.data)
        return frame

    def _time_ns(self, stamp: str | None) -> int:
        if stamp is None:
            self._account.note(
                "its lines have no stamps: the frames stand 1 ms apart, from 1970 on"
            )
            return self._count * _STEP_NS
        seconds = stamp.partition(".")[0]
        if "-" in seconds[1:]:
            self._account.may_be_distances = False
            return _date_ns(stamp)
        if len(seconds) != 3 or (not self._count and ns_of(stamp)):
            self._account.may_be_distances = False
        return ns_of(stamp)

    def _of_log(self, found: "re.Match[str]", time_ns: int) -> RecordedFrame:
        digits, rest, channel = found["id"], found["rest"], found["channel"]
        received = (found["way"] or "R").upper() == "R"
        word = int(digits, 16)
        extended = len(digits) > _STANDARD_DIGITS
        if rest.startswith("##") or ":" in rest:
            return RecordedFrame(time_ns, channel=channel, kind="CAN XL")
        if extended and word & _ERROR:
            return RecordedFrame(time_ns, channel=channel, kind="error")
        if rest[:1] in ("R", "r") or (extended and word & _REMOTE):
            return RecordedFrame(time_ns, channel=channel, kind="remote")
        flags: int = Flag.NONE
        if rest.startswith("#"):
            marks = number_of(rest[1:2], 16, "the flags of CAN FD")
            flags, rest = Flag.FD | marks & (Flag.BRS | Flag.ESI), rest[2:]
        elif rest[-2:-1] == "_":  # the DLC above 8, as -8 shows it
            classic_bytes(number_of(rest[-1], 16, "a DLC"))
            rest = rest[:-2]
        data = _data(rest.replace(".", ""))
        number = word & _ID if extended else word
        return data_frame(time_ns, number, extended, data, flags, received, channel)

    def _of_screen(self, match: "re.Match[str] | None", time_ns: int) -> RecordedFrame:
        assert match is not None
        rest, channel, length = match["rest"], match["channel"], match["length"]
        extended = len(match["id"]) > _STANDARD_DIGITS
        number = int(match["id"], 16)
        if len(length) == 4:
            return RecordedFrame(time_ns, channel=channel, kind="CAN XL")
        if extended and number & _ERROR:
            return RecordedFrame(time_ns, channel=channel, kind="error")
        if rest.strip().startswith("remote request"):
            return RecordedFrame(time_ns, channel=channel, kind="remote")
        flags: int = Flag.NONE
        if len(length) == 2:  # [08], of classic frames it is [8]
            set_ = match["set"] or ""
            flags = Flag.FD | (Flag.BRS if "B" in set_ else 0) | (Flag.ESI if "E" in set_ else 0)
        size = int(length) if flags else classic_bytes(int(length, 16))
        data = _bytes_shown(rest, size)
        received = (match["way"] or "RX") == "RX"
        return data_frame(time_ns, number, extended, data, flags, received, channel)

    def _check_whole(self, frame: RecordedFrame) -> None:
        """Raise ValueError for a last line without its end that may lack bytes."""
        size = len(frame.data)
        full = size == CLASSIC_BYTES and not frame.flags & Flag.FD
        if not full and self._lengths.get((frame.number, frame.extended)) != size:
            raise ValueError(NO_END)

    def finish(self) -> None:
        """Nothing stands at the end."""


def _data(digits: str) -> bytes:
    try:
        return bytes.fromhex(digits)
    except ValueError:
        raise ValueError(f"expected pairs of hexadecimal digits, not {digits[:40]!r}") from None


def _bytes_shown(text: str, size: int) -> bytes:
    """Return the bytes of a line of the screen; ValueError if there are fewer."""
    first = text.split(None, 1)[0] if text.strip() else ""
    is_swapped = size > 1 and _SWAPPED in first
    words = first.split(_SWAPPED)[::-1] if is_swapped else text.split()[:size]
    if len(words) == size and all(_BINARY.fullmatch(word) for word in words):
        return bytes(int(word, 2) for word in words)
    if len(words) != size or not all(len(word) == 2 for word in words):
        raise ValueError(f"{len(words)} of {size} bytes in hexadecimal pairs")
    return _data("".join(words))


def _date_ns(stamp: str) -> int:
    """Return the wall time of a date as -t A writes it, in the local zone."""
    whole, _, digits = stamp.partition(".")
    return round(datetime.fromisoformat(whole).timestamp()) * 10**9 + ns_of(f"0.{digits}")
