"""Up to which cycle a log, cut or damaged, holds all that a node's cycles took in.

A drain of the recorder moves a node's cycles first, then its frames, then its events, and each is
taken later than the one before it: once a cycle follows frames or events in the file, all that
belongs to the cycles before it is there. At the end of a whole log everything is; after damage
nothing more is known.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log import reader as logs
from pcpc.executive.log.inventory import LEFT_OUT, TOPICS
from pcpc.executive.log.mcap_reader import Scan
from pcpc.executive.log.mcap_records import MESSAGE_HEAD, message_dtype

ALL = 2**62
_DATA_IS_WHOLE = ("the summary at the end", "the checksum of all data", LEFT_OUT)  # begin notes


class Frontier:
    """`whole`: by node the last cycle of which all is known to be in the log; -1 for none."""

    def __init__(self) -> None:
        self.whole: dict[str, int] = dict.fromkeys(logs.NODES, -1)
        self._newest: dict[str, int] = dict.fromkeys(logs.NODES, -1)
        self._followed: dict[str, bool] = dict.fromkeys(logs.NODES, False)
        self._notes = 0

    def see(self, scanned: Scan, channel: int, rows: NDArray[np.uint8]) -> None:
        """Take a run of messages of one channel as it comes; -1: the file is over.

        `rows`: (n, bytes of a message).
        """
        damage = [note for note in scanned.missing if not note.startswith(_DATA_IS_WHOLE)]
        if len(damage) > self._notes and self._notes >= 0:
            self._notes = -1
        if self._notes < 0:
            return
        if channel < 0:
            if any(record.name == "run" for record in scanned.metadata):
                self.whole = dict.fromkeys(logs.NODES, ALL)
            return
        node, kind = TOPICS.get(scanned.topic(channel), ("", ""))
        if kind == "state":
            self._cycles(node, rows)
        elif kind in ("can/frames", "events", "tunings"):
            self._followed[node] = True

    def _cycles(self, node: str, rows: NDArray[np.uint8]) -> None:
        if self._followed[node]:
            self.whole[node], self._followed[node] = self._newest[node], False
        data: Any = rows[-1:].view(message_dtype(rows.shape[1] - MESSAGE_HEAD))
        low, newest = int(data["sequence"].flat[0]), self._newest[node]
        wraps = (newest >> 32) + (newest >= 0 and low < newest & 0xFFFFFFFF)
        self._newest[node] = (max(wraps, 0) << 32) + low
