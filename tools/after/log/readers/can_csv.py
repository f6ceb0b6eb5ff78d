"""python-can's CSV: timestamp,arbitration_id,extended,remote,error,dlc,data in base 64.

Nothing in it says CAN FD but more than 8 bytes. Spreadsheets add quotes, True and False.
"""

import base64
import binascii
import csv
from collections.abc import Iterator
from typing import IO

from pcpc.tools.after.log.readers.account import (
    Account,
    NotReadError,
    RecordedFrame,
    data_frame,
    flags_by_size,
    ns_of_float,
    number_of,
)
from pcpc.tools.after.log.readers.lines import NO_END, frames_of_lines

_COLUMNS = 7
_SWITCHES = {"0": False, "1": True, "false": False, "true": True}


def frames(file: IO[bytes], account: Account) -> Iterator[RecordedFrame]:
    """Yield the frames of a file."""
    return frames_of_lines(file, account, _Csv())


class _Csv:
    """The lines of a file."""

    _is_first = True

    def frame(self, line: str, has_end: bool) -> RecordedFrame | None:
        """Return the frame of a line; NotReadError if the first is none of python-can's."""
        words = [word.strip() for word in next(csv.reader([line]))]
        first, self._is_first = self._is_first, False
        if first and words[0] == "timestamp" and len(words) == _COLUMNS:
            return None
        is_head = words[0][:1].isalpha() and not _SWITCHES.keys() & words[2:5]
        if first and (len(words) != _COLUMNS or is_head):
            raise NotReadError("not python-can's CSV; give a candump log, BLF, ASC, TRC or MDF 4")
        if len(words) != _COLUMNS:
            what = f"{len(words)} columns, expected {_COLUMNS}"
            raise ValueError(what if has_end else NO_END)
        try:
            time_ns = ns_of_float(float(words[0]))
            data = base64.b64decode(words[6], validate=True)
        except (ValueError, binascii.Error):
            raise ValueError(f"expected seconds and base 64: {line[:60]!r}") from None
        if any(word.lower() not in _SWITCHES for word in words[2:5]):
            raise ValueError(f"expected 0 or 1, not {','.join(words[2:5])[:40]!r}")
        extended, remote, error = (_SWITCHES[word.lower()] for word in words[2:5])
        if error or remote:
            return RecordedFrame(time_ns, kind="error" if error else "remote")
        number = number_of(words[1], 16, "an id")
        dlc = number_of(words[5], 10, "a length")
        if len(data) != dlc:
            raise ValueError(f"{len(data)} of {dlc} bytes")
        return data_frame(time_ns, number, extended, data, flags_by_size(data))

    def finish(self) -> None:
        """Nothing stands at the end."""
