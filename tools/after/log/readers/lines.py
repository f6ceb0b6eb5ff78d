"""The lines of a text file, in whatever code they are, and the loop over them of all readers.

UTF-8, with and without a mark at its begin, UTF-16 with one, and cp1252 for each byte that is not
UTF-8. Lines end with CR, LF or both.
"""

import codecs
import io
from collections.abc import Iterator
from typing import IO, Protocol

from pcpc.tools.after.log.readers.account import Account, RecordedFrame

_LONGEST = 1 << 16  # characters of a line: a text without ends is cut there
_MARKS = ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_DOS_END = "\x1a"  # behind the last line
NO_END = "the last line has no end, it may be cut"


class LineParser(Protocol):
    """What reads the lines of a format."""

    def frame(self, line: str, has_end: bool) -> RecordedFrame | None:
        """Return the frame of a line, None for a line that is none; ValueError: damaged."""

    def finish(self) -> None:
        """Note what the end of the file tells."""


def _as_cp1252(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeDecodeError)
    wrong = error.object[error.start : error.end]
    return wrong.decode("cp1252", "replace"), error.end


codecs.register_error("pcpc-cp1252", _as_cp1252)


def text_lines(file: IO[bytes]) -> Iterator[tuple[str, bool]]:
    """Yield each line without its end, and whether it has one."""
    head = file.read(4)
    file.seek(0)
    code = next((code for mark, code in _MARKS if head.startswith(mark)), "")
    if not code:
        zeros = head[1:4:2] == b"\0\0", head[0:4:2] == b"\0\0"
        code = {(True, False): "utf-16-le", (False, True): "utf-16-be"}.get(zeros, "utf-8-sig")
    text = io.TextIOWrapper(file, code, errors="pcpc-cp1252")
    while line := text.readline(_LONGEST):
        yield line.rstrip("\n"), line.endswith("\n")
    text.detach()


def frames_of_lines(
    file: IO[bytes], account: Account, parser: LineParser
) -> Iterator[RecordedFrame]:
    """Yield the frames of all lines; a line that cannot be read is noted, and the next is read."""
    for place, (line, has_end) in enumerate(text_lines(file), 1):
        try:
            frame = parser.frame(line, has_end) if line.strip().strip(_DOS_END) else None
        except ValueError as error:
            account.lose(f"line {place}", error)
            continue
        if frame is not None:
            yield frame
    parser.finish()


def foreign_line(line: str, form: str) -> ValueError:
    """Return what says that a line is none of this form."""
    return ValueError(f"no line of {form}: {line.strip()[:40]!r}")
