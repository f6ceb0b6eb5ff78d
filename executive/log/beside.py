"""What the recorder notes of a node beside its messages: of the whole run, whatever the log keeps.

frames    how many of each id were sent, and received in each state of the check
table     the columns that the run is judged by, where the log keeps a part: `long_logs.sidecar`
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log.long_logs import Table, sidecar
from pcpc.executive.loop import shared

_ID_DIRECTION_E2E = ~(0xFF << 32)  # of the word of a frame's row, without its length


class Beside:
    """Counts and table of one node, of which `about` is the description of its block."""

    def __init__(self, about: Mapping[str, Any]) -> None:
        self._about = about
        self._frames: Counter[int] = Counter()
        self._table: Table | None = None
        self._cells: list[int] = []

    def judge_by(self, log: Path, columns: Sequence[str]) -> None:
        """Write `columns` of the whole run to a table beside the log."""
        about = self._about
        cells = {name: shared.RECORD_HEAD + i for i, name in enumerate(about["state_columns"])}
        first = shared.RECORD_HEAD + len(about["state_columns"]) + 1
        cells |= {name: first + i for i, name in enumerate(about["timing_columns"])}
        file = sidecar(log, about["node"]).open("wb")
        self._table = Table(file, [name for name in columns if name in cells])
        self._cells = [0, 1, *(cells[name] for name in self._table.names)]

    def note(self, ring: str, rows: NDArray[np.int64]) -> None:
        """Take rows of a ring."""
        if ring == "frame":
            keys, counts = np.unique(rows[:, 3] & _ID_DIRECTION_E2E, return_counts=True)
            self._frames.update(dict(zip(keys.tolist(), counts.tolist(), strict=True)))
        elif ring == "record" and self._table is not None:
            self._table.append(rows[:, self._cells])

    def frame_counts(self) -> dict[str, int]:
        """Return the frames by `node.sent.ID` and `node.received.ID.STATE`, the id in hex."""
        found = {}
        for key, count in sorted(self._frames.items()):
            number, received, state = key & 0xFFFFFFFF, key >> 40 & 0xFF, key >> 48 & 0xFF
            what = f"received.{number:X}.{state}" if received else f"sent.{number:X}"
            found[f"{self._about['node']}.{what}"] = count
        return found

    def close(self) -> None:
        """End the table."""
        if self._table is not None:
            self._table.close()
