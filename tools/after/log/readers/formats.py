"""Which reader reads a file: by what it begins with, else by its suffix; and gzip around it."""

import os
import re
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, NamedTuple

from pcpc.tools.after.log.readers import (
    asc,
    blf,
    can_csv,
    candump,
    database,
    measurement,
    trc,
)
from pcpc.tools.after.log.readers.account import Account, NotReadError, RecordedFrame


class _Format(NamedTuple):
    """A format: what a file of it begins with, and its reader."""

    begin: re.Pattern[bytes]
    frames: Callable[[IO[bytes], Account], Iterator[RecordedFrame]]


_CANDUMP = (  # comments first; then a line of its log, or of its screen
    rb"(?:[ \t]*(?:#[^\n]*)?\r?\n)*+\s*(?:\([^()\n]*\)\s+)?\S+\s+"
    rb"(?:[0-9A-Fa-f]{3,8}#|(?:[RT]X [B-] [E-]\s+)?[0-9A-Fa-f]{3,8}\s+\[[0-9]+\]\s)"
)
_FORMATS = {  # by suffix
    ".blf": _Format(re.compile(rb"LOGG"), blf.frames),
    ".mf4": _Format(re.compile(rb"MDF     |UnFinMF "), measurement.frames),
    ".db": _Format(re.compile(rb"SQLite format 3\0"), database.frames),
    ".asc": _Format(re.compile(rb"\s*(date\s|base\s+(hex|dec)\b)"), asc.frames),
    ".trc": _Format(re.compile(rb";\$FILEVERSION"), trc.frames),
    ".csv": _Format(re.compile(rb"timestamp,arbitration_id,"), can_csv.frames),
    ".log": _Format(re.compile(_CANDUMP), candump.frames),
}
_GZIP_WINDOW, _SUM_BYTES = 31, 8
_GZIP, _HEAD_BYTES = b"\x1f\x8b", 4096
_BOMS = (b"\xef\xbb\xbf",)
_NOT_READ = (
    (rb"version https://git-lfs", "a Git LFS pointer; fetch the file itself by `git lfs pull`"),
    (rb"\*\*\*BUSMASTER", "BUSMASTER's log, which is not read; give it as ASC or BLF"),
    (rb"Time Stamp,ID,Extended", "SavvyCAN's CSV, which is not read; save it as a candump log"),
    (rb"\x1f\x8b", "an archive in an archive; unpack it first"),
    (rb"PK\x03\x04|7z\xbc\xaf|BZh|\xfd7zXZ|\x28\xb5\x2f\xfd|Rar!", "an archive; unpack it first"),
    (rb"\x89MCAP", "an MCAP file; give it to `pcpc log info`"),
    (rb"\s*<(!DOCTYPE|html)", "a web page; download the file itself"),
    (rb"\xd4\xc3\xb2\xa1|\xa1\xb2\xc3\xd4|\x0a\x0d\x0d\x0a", "a capture of packets, not read here"),
)  # fmt: skip


@contextmanager
def frames_of(path: Path, account: Account) -> Iterator[Iterator[RecordedFrame]]:
    """Give the frames of a recording, packed or not; NotReadError, or what a library raises."""
    with path.open("rb") as raw:
        if raw.read(2) != _GZIP:
            raw.seek(0)
            yield _frames(path.name, raw, account)
            return
        raw.seek(0)
        with tempfile.NamedTemporaryFile() as unpacked:
            _unpack(raw, unpacked, account)
            unpacked.seek(0)
            with open(unpacked.name, "rb") as file:
                yield _frames(path.name, file, account)


def _frames(name: str, file: IO[bytes], account: Account) -> Iterator[RecordedFrame]:
    """Return the frames of an unpacked file, which the user gave as `name`."""
    head = file.read(_HEAD_BYTES)
    file.seek(0)
    for mark in _BOMS:
        head = head.removeprefix(mark)
    for pattern, what in _NOT_READ:
        if re.match(pattern, head, re.IGNORECASE):
            raise NotReadError(what)
    suffixes = [suffix.lower() for suffix in Path(name).suffixes]
    if suffixes[-1:] == [".gz"]:
        suffixes.pop()
    suffix = suffixes[-1] if suffixes else ""
    form = next((one for one in _FORMATS.values() if one.begin.match(head)), _FORMATS.get(suffix))
    if form is None:
        known = ", ".join(sorted(_FORMATS))
        raise NotReadError(f"no format is known by this suffix; known: {known}, each also with .gz")
    return form.frames(file, account)


def _unpack(packed: IO[bytes], unpacked: IO[bytes], account: Account) -> None:
    """Write what a gzip file holds, as far as it can be unpacked."""
    stream, is_done = zlib.decompressobj(_GZIP_WINDOW), False
    for piece in _pieces(packed):
        data = piece.lstrip(b"\0") if is_done else piece
        while data:
            try:
                unpacked.write(stream.decompress(data, 1 << 20))
            except zlib.error as error:
                account.lose("the .gz around it", error)
                return
            data, is_done = stream.unconsumed_tail, stream.eof
            if is_done:
                data = stream.unused_data.lstrip(b"\0")
                stream = zlib.decompressobj(_GZIP_WINDOW)
    if not is_done:
        account.lose("the .gz around it", "it is cut")


def _pieces(file: IO[bytes]) -> Iterator[bytes]:
    """Yield a file in pieces, its sum at the end by itself: if that is wrong, all else is there."""
    left = os.fstat(file.fileno()).st_size - _SUM_BYTES
    while left > 0 and (data := file.read(min(left, 1 << 16))):
        left -= len(data)
        yield data
    yield file.read()
