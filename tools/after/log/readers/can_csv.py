"""python-can's CSV: timestamp,arbitration_id,extended,remote,error,dlc,data in base 64."""

import base64
import binascii
from collections.abc import Iterator
from typing import IO

from pcpc.tools.after.log.readers.account import (
    Account,
    NotReadError,
    RecordedFrame,
    data_frame,
    ns_of_float,
    number_of,
)
from pcpc.tools.after.log.readers.lines import NO_END, frames_of_lines

_COLUMNS = 7


def frames(file: IO[bytes], account: Account) -> Iterator[RecordedFrame]:
    """Yield the frames of a file."""
    return frames_of_lines(file, account, _Csv())


class _Csv:
    """The lines of a file."""

    _is_first = True

    def frame(self, line: str, has_end: bool) -> RecordedFrame | None:
        """Return the frame of a line; NotReadError if the first is none of python-can's."""
        words = [word.strip() for word in line.split(",")]
        first, self._is_first = self._is_first, False
        if first and words[0] == "timestamp" and len(words) == _COLUMNS:
            return None
        if first and len(words) != _COLUMNS:
            raise NotReadError("not python-can's CSV; give a candump log, BLF, ASC, TRC or MDF 4")
        if len(words) != _COLUMNS:
            what = f"{len(words)} columns, expected {_COLUMNS}"
            raise ValueError(what if has_end else NO_END)
        try:
            time_ns = ns_of_float(float(words[0]))
            data = base64.b64decode(words[6], validate=True)
        except (ValueError, binascii.Error):
            raise ValueError(f"expected seconds and base 64: {line[:60]!r}") from None
        if words[4] == "1" or words[3] == "1":
            return RecordedFrame(time_ns, kind="error" if words[4] == "1" else "remote")
        number = number_of(words[1], 16, "an id")
        dlc = number_of(words[5], 10, "a length")
        if len(data) != dlc:
            raise ValueError(f"{len(data)} of {dlc} bytes")
        return data_frame(time_ns, number, words[2] == "1", data)

    def finish(self) -> None:
        """Nothing stands at the end."""
