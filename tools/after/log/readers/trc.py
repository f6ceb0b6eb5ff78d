"""PEAK's TRC, all versions from 1.0 to 2.1.

    1.0   number) ms id DLC data           1.2   number) ms bus type id DLC data
    1.1   number) ms type id DLC data      1.3   number) ms bus type id reserved DLC data
    2.x   the columns of `;$COLUMNS=`: N number, O ms, T type, B bus, I id, d Rx or Tx,
          R reserved, L DLC or l length, D data

The begin is `;$STARTTIME=`, days since 30 December 1899.
"""

from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal, InvalidOperation
from typing import IO

from pcpc.drivers.can.wire_layout import LENGTHS, Flag
from pcpc.tools.after.log.readers.account import (
    CLASSIC_BYTES,
    LONG_J1939,
    Account,
    RecordedFrame,
    classic_bytes,
    data_frame,
    ns_of,
    number_of,
)
from pcpc.tools.after.log.readers.dates import unknown_date
from pcpc.tools.after.log.readers.lines import NO_END, foreign_line, frames_of_lines

_COLUMNS = {"1.0": "NOILD", "1.1": "NOTILD", "1.2": "NOBTILD", "1.3": "NOBTIRLD",
            "2.0": "NOTIdlD", "2.1": "NOTBIdRLD"}  # fmt: skip
_DAY_NS, _DAYS_TO_1970 = 86_400 * 10**9, 25569
_STANDARD_DIGITS = 4
_CLASSIC = ("RX", "TX", "DT")
_FLAGS = {
    "FD": Flag.FD,
    "FB": Flag.FD | Flag.BRS,
    "FE": Flag.FD | Flag.ESI,
    "BI": Flag.FD | Flag.BRS | Flag.ESI,
}
_KINDS = {"ERROR": "error", "ER": "error", "RR": "remote", "RTR": "remote"}
_EVENTS = ("WARNG", "ST", "EC", "EV")


def frames(file: IO[bytes], account: Account) -> Iterator[RecordedFrame]:
    """Yield the frames of a file."""
    return frames_of_lines(file, account, _Trc(account))


class _Trc:
    """The lines of a file, and what its header says."""

    def __init__(self, account: Account) -> None:
        self._account = account
        self._columns: Sequence[str] = _COLUMNS["1.0"]
        self._start_ns = 0

    def frame(self, line: str, has_end: bool) -> RecordedFrame | None:
        """Return the frame of a line; None for a comment, a status, a warning."""
        line = line.strip()
        if line.startswith(";"):
            self._read_header(line)
            return None
        words = line.split(None, len(self._columns) - 1)
        if len(words) < 3 or not words[0].rstrip(")").isdigit():
            raise foreign_line(line, "TRC") if has_end else ValueError(NO_END)
        fields = dict(zip(self._columns, words, strict=False))
        type_ = fields.get("T", "").upper()
        if type_ in _EVENTS or (not type_ and fields.get("I") == "FFFFFFFF"):
            self._account.others += 1
            return None
        time_ns = self._start_ns + ns_of(fields["O"]) // 1000
        channel = fields.get("B", "1")
        kind = _KINDS.get(type_) or _KINDS.get(fields.get("D", "").split(" ")[0].upper())
        if kind:
            return RecordedFrame(time_ns, channel=channel, kind=kind)
        if type_ and type_ not in (*_CLASSIC, *_FLAGS):
            raise ValueError(f"no type of TRC: {type_[:20]!r}")
        return self._data_frame(time_ns, channel, fields, has_end)

    def _data_frame(
        self, time_ns: int, channel: str, fields: Mapping[str, str], has_end: bool
    ) -> RecordedFrame | None:
        type_ = fields.get("T", "").upper()
        flags = _FLAGS.get(type_, Flag.NONE)
        length = number_of(fields.get("L", fields.get("l", "")), 10, "a length")
        if "R" in fields and not flags and length >= len(LENGTHS) and length > CLASSIC_BYTES:
            return RecordedFrame(time_ns, channel=channel, kind=LONG_J1939)
        size = length
        if "L" in fields:
            size = classic_bytes(length)
            size = LENGTHS[length] if flags else size  # the DLC is one of 0 to 15
        elif not flags:
            size = min(size, CLASSIC_BYTES)
        words = fields.get("D", "").split()[:size]
        if len(words) < size or not all(len(word) == 2 for word in words):
            raise ValueError(f"{len(words)} of {size} bytes") if has_end else ValueError(NO_END)
        data = bytes(number_of(word, 16, "a byte") for word in words)
        text = fields["I"].rstrip("hH")
        number = number_of(text, 16, "an id")
        way = fields.get("d", type_ or "RX").upper()
        extended = len(text) > _STANDARD_DIGITS
        return data_frame(time_ns, number, extended, data, flags, way != "TX", channel)

    def _read_header(self, line: str) -> None:
        key, _, value = line[1:].replace(" ", "").rstrip(";").partition("=")
        if key == "$FILEVERSION":
            version = ".".join(value.split(".")[:2])
            if version not in _COLUMNS:
                self._account.note(f"TRC of version {value[:20]}, read as {max(_COLUMNS)}")
            self._columns = _COLUMNS.get(version, _COLUMNS[max(_COLUMNS)])
        elif key == "$COLUMNS":
            self._columns = value.split(",")
        elif key == "$STARTTIME":
            try:
                days = Decimal(value.replace(",", ".")) - _DAYS_TO_1970
                self._start_ns = max(0, int(days * _DAY_NS) // 1000 * 1000)
            except (InvalidOperation, ValueError, OverflowError):
                self._account.note(unknown_date(value[:40]))

    def finish(self) -> None:
        """Nothing stands at the end."""
