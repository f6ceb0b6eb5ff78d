"""Which reader reads a file: by what it begins with, else by its suffix; and gzip around it."""

import os
import re
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

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
from pcpc.tools.terminal.extras import need

KNOWN = {
    ".log": "candump", ".asc": "ASC", ".blf": "BLF", ".mf4": "MDF 4", ".trc": "TRC",
    ".csv": "python-can's CSV", ".db": "python-can's SQLite",
}  # fmt: skip
_GZIP_WINDOW, _SUM_BYTES = 31, 8
_GZIP, _HEAD_BYTES = b"\x1f\x8b", 512
_UNPACKED, _UNPACKED_PER_BYTE = 16 << 20, 200
_BOMS = (b"\xef\xbb\xbf",)
_SIGNATURES = (
    (rb"LOGG", ".blf"),
    (rb"MDF     |UnFinMF ", ".mf4"),
    (rb"SQLite format 3\0", ".db"),
    (rb"\s*(date\s|base\s+(hex|dec)\b)", ".asc"),
    (rb";\$FILEVERSION", ".trc"),
    (rb"timestamp,arbitration_id,", ".csv"),
    (rb"\s*\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]{3,8}#", ".log"),
)
_NOT_READ = (
    (rb"version https://git-lfs", "a Git LFS pointer; fetch the file itself by `git lfs pull`"),
    (rb"\*\*\*BUSMASTER", "BUSMASTER's log, which is not read; give it as ASC or BLF"),
    (rb"Time Stamp,ID,Extended", "SavvyCAN's CSV, which is not read; save it as a candump log"),
    (rb"PK\x03\x04|7z\xbc\xaf|BZh|\xfd7zXZ|\x28\xb5\x2f\xfd|Rar!", "an archive; unpack it first"),
    (rb"\x89MCAP", "an MCAP file; give it to `pcpc log info`"),
    (rb"\s*<(!DOCTYPE|html)", "a web page; download the file itself"),
    (rb"\xd4\xc3\xb2\xa1|\xa1\xb2\xc3\xd4|\x0a\x0d\x0d\x0a", "a capture of packets, not read here"),
)  # fmt: skip


@contextmanager
def frames_of(path: Path, account: Account) -> Iterator[Iterator[RecordedFrame]]:
    """Give the frames of a recording, packed or not; NotReadError, or what a library raises."""
    with path.open("rb") as raw:
        most = _UNPACKED + _UNPACKED_PER_BYTE * path.stat().st_size
        if raw.read(2) != _GZIP:
            raw.seek(0)
            yield _frames(path.name, path, raw, account, most)
            return
        raw.seek(0)
        with tempfile.NamedTemporaryFile() as whole:
            _unpack(raw, whole, account, most)
            whole.seek(0)
            with open(whole.name, "rb") as file:
                yield _frames(path.name, Path(whole.name), file, account, most)


def _frames(
    name: str, path: Path, file: IO[bytes], account: Account, most: int
) -> Iterator[RecordedFrame]:
    """Return the frames of an unpacked file `path`, which the user gave as `name`."""
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
    kind = next((kind for pattern, kind in _SIGNATURES if re.match(pattern, head)), None)
    kind = kind or (suffixes[-1] if suffixes else "")
    if kind not in KNOWN:
        known = ", ".join(sorted(KNOWN))
        raise NotReadError(f"no format is known by this suffix; known: {known}, each also with .gz")
    if kind == ".mf4":
        need("MDF needs", "asammdf")
        return measurement.frames(file, account, most)
    if kind == ".db":
        return database.frames(path, account)
    if kind == ".blf":
        return blf.frames(file, account, most)
    readers = {".log": candump, ".asc": asc, ".trc": trc, ".csv": can_csv}
    return readers[kind].frames(file, account)


def _unpack(packed: IO[bytes], whole: IO[bytes], account: Account, most: int) -> None:
    """Write what a gzip file holds, as far as it can be unpacked; NotReadError for too much."""
    stream, is_done = zlib.decompressobj(_GZIP_WINDOW), False
    for piece in _pieces(packed):
        data = piece.lstrip(b"\0") if is_done else piece
        while data:
            try:
                most -= whole.write(stream.decompress(data, 1 << 20))
            except zlib.error as error:
                account.lose("the .gz around it", error)
                return
            if most < 0:
                raise NotReadError("it unpacks to more than 200 times its size")
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
