"""What a node publishes, as bytes between a host and a terminal of another machine.

    look    4 int64: id, whether its process is there, 0, 0; then the fields that were asked for, in
            their order, as they lie in memory
    rows    4 int64: id, the number of the first row, rows, the end of the ring; then int64 (n, m)

VERSION is that of the layout: both sides have to have the same.
"""

import hashlib
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.loop import shared as sh
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.rings import put, rows_of

VERSION = hashlib.sha256(repr(sh.PUBLISHED.descr).encode()).hexdigest()[:16]
MOST_BYTES = 256 * 1024  # of rows in one answer
_HEAD = struct.Struct("<4q")


def look(number: int, live: Live, fields: Sequence[str]) -> bytes:
    """Return the answer to a look; LiveError where the node stands still in mid-cycle."""
    found = [
        live.read().array if name == "snapshot" else live.block[name].copy() for name in fields
    ]
    head = _HEAD.pack(number, live.block.alive(), 0, 0)
    return b"".join([head, *(array.tobytes() for array in found)])


def fields_of(
    body: bytes, fields: Sequence[str], about: Mapping[str, Any]
) -> tuple[bool, dict[str, NDArray[Any]]]:
    """Return whether the process is there, and the fields, each in the shape of its structure."""
    _, alive, _, _ = _HEAD.unpack_from(body)
    found, at = {}, _HEAD.size
    for name in fields:
        kind, shape = sh.PUBLISHED[name].subdtype or (sh.PUBLISHED[name], ())
        shape = (len(about["variables"]),) if name == "snapshot" else shape
        count = int(np.prod(shape))
        found[name] = np.frombuffer(body, kind, count, at).reshape(shape)[()]  # of control a record
        at += count * kind.itemsize
    return bool(alive), found


def rows(number: int, live: Live, ring: str, since: int, columns: Sequence[int] | None) -> bytes:
    """Return the answer with rows of a ring; IndexError for a column that it has not."""
    broad = live.block[ring].shape[1] if columns is None else len(columns)
    most = max(MOST_BYTES // (8 * broad), 1)
    taken, first = rows_of(live.block, ring, since, columns, most)
    return _HEAD.pack(number, first, len(taken), put(live.block, ring)) + taken.tobytes()


def rows_in(body: bytes) -> tuple[NDArray[np.int64], int, int]:
    """Return the rows of such an answer, the number of the first, and the end of the ring.

    The rows: (n, columns).
    """
    _, first, count, end = _HEAD.unpack_from(body)
    flat = np.frombuffer(body, np.int64, offset=_HEAD.size)
    return flat.reshape(count, -1) if count else np.empty((0, 0), np.int64), first, end
