"""Rows of a node's rings, copied by a client that the node does not know of."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.loop import shared as sh

MOST_CYCLES = 1000  # between two looks at the rings of nodes in one process


def kept_cycles(block: sh.NodeMemory) -> int:
    """Return how many cycles a node's ring of frames holds, at most MOST_CYCLES.

    Each frame is there twice in each of them: as it came, and as a fault on purpose has made it.
    """
    frames = max(1, int(block.loop.rx.n + block.loop.tx.n))
    return max(1, min(MOST_CYCLES, int(block.loop.rings.frame_rows) // (2 * frames)))


def put(block: sh.NodeMemory, ring: str) -> int:
    """Return how many rows the node has put into a ring so far."""
    return int(block.ends(ring).head)


def rows_of(
    block: sh.NodeMemory,
    ring: str,
    since: int,
    columns: Sequence[int] | None = None,
    most: int | None = None,
) -> tuple[NDArray[np.int64], int]:
    """Return rows from number `since` on, (n, columns), and the number of the first.

    It is greater than `since` where older ones were overwritten. At most `most`. Only rows that
    were whole when they were copied: the one after the newest may be in the middle of being
    written, over the oldest.
    """
    rows, end = block[ring], put(block, ring)
    begin = max(since, end - len(rows) + 1)
    end = end if most is None else min(end, begin + most)
    copied = rows[np.arange(begin, end) % len(rows)]
    whole = max(begin, put(block, ring) - len(rows) + 1)
    copied = copied[whole - begin :]
    return copied if columns is None else copied[:, list(columns)], min(whole, end)
