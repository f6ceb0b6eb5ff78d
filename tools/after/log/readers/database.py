"""python-can's SQLite file: a table of messages, seven columns as in its CSV."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from pcpc.tools.after.log.readers.account import (
    Account,
    NotReadError,
    RecordedFrame,
    data_frame,
    flags_by_size,
    ns_of_float,
)

_HEAD_BYTES = 100


def frames(file: IO[bytes], account: Account) -> Iterator[RecordedFrame]:
    """Yield the frames of a file; NotReadError if there is no such table."""
    path = Path(file.name)
    size, head = path.stat().st_size, file.read(_HEAD_BYTES)
    declared = _page_bytes(head) * int.from_bytes(head[28:32], "big")
    if declared > size:
        account.lose("the file", f"{size} of {declared} bytes")
    connection = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)
    connection.text_factory = bytes
    place = 0
    try:
        rows = connection.execute("SELECT * FROM messages ORDER BY rowid")
        for place, row in enumerate(rows, 1):
            try:
                yield _of_row(row)
            except (ValueError, TypeError) as error:
                account.lose(f"row {place}", error)
        declared = connection.execute("SELECT COUNT(*) FROM messages").fetchone()[0]
        if declared != place:
            account.lose("the file", f"{place} of {declared} rows")
    except sqlite3.Error as error:
        if not place:
            what = f"no SQLite file of python-can with a table of messages ({error})"
            raise NotReadError(what) from None
        account.lose(f"row {place + 1}", error)
    finally:
        connection.close()


def _page_bytes(head: bytes) -> int:
    """Return the size of a page; 1 stands for 65,536."""
    size = int.from_bytes(head[16:18], "big")
    return 1 << 16 if size == 1 else size


def _of_row(row: tuple[Any, ...]) -> RecordedFrame:
    """Return the frame of a row; ValueError, TypeError."""
    seconds, number, extended, remote, error, dlc, data = row
    time_ns = ns_of_float(float(seconds))
    if error or remote:
        return RecordedFrame(time_ns, kind="error" if error else "remote")
    content = bytes(data or b"")
    if len(content) != dlc:
        raise ValueError(f"{len(content)} of {dlc} bytes")
    return data_frame(time_ns, int(number), bool(extended), content, flags_by_size(content))
