"""What a log holds, held against what its recorder counted: nothing is gone, nothing stands twice.

    cycles       of a node's columns rise from message to message, of its frames and tunings they
                 never fall: a message that stands twice, or behind later ones, is left out
    counts       metadata `run` has the rows of each ring that the recorder took, written.NODE.RING,
                 and of a log that keeps a part of the run how many messages it `discarded`
    recovered    a log written anew, whose recorder did not come to count, says what was missing

So a log that another tool cut, thinned or put together tells it, however well that tool closed it.
"""

from collections import Counter
from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log.schemas import ENTRY_KINDS
from pcpc.executive.rig.roles import ROLES

Rows = NDArray[np.uint8]  # (messages, bytes of each record)

KINDS = ("state", "timing", "can/frames", "events", "tunings")
OTHER_ENTRIES = {  # topics of JSON that not every log has; what the recorder counts of them
    name: word for name, word in ENTRY_KINDS.items() if name not in KINDS
}
_LEAST = {"state": 1, "timing": 1, "can/frames": 0, "tunings": 0}  # cycles from message to message
SEQUENCE = slice(11, 15)  # its bytes in a message record
_HALF = 1 << 31
CHUNK_HEAD = 28  # bytes of a chunk: its times, its size and the CRC-32 of what is in it
_CHUNKS = 1 << 16  # the last of nine hours
LEFT_OUT = "left out, because they stand twice"  # begins notes that tell of no loss


def topic(node: str, kind: str) -> str:
    """Return the topic of `kind` (state, timing, can/frames, events, tunings) for a node."""
    return f"/{kind}" if node == "executive" else f"/{node}/{kind}"


TOPICS = {topic(node, kind): (node, kind) for node in ROLES for kind in KINDS}


class Inventory:
    """Counts the messages of a log by topic and leaves out those that stand twice."""

    def __init__(self) -> None:
        self.kept: Counter[str] = Counter()
        self.left_out: Counter[str] = Counter()
        self.impossible: Counter[str] = Counter()  # frames that no reader keeps, by topic
        self.cycles: dict[str, int] = {}  # the last one that was taken out, by topic of columns
        self.said: set[str] = set()  # of the log as a whole, to be told once
        self._chunks: dict[bytes, None] = {}
        self._newest: dict[str, tuple[int, bool]] = {}  # cycle, and whether messages fell behind it

    def has_chunk(self, head: bytes) -> bool:
        """Return whether a chunk of this head was there already, which is left out then."""
        if head in self._chunks:
            self.left_out["chunks"] += 1
            return True
        self._chunks[head] = None
        if len(self._chunks) > _CHUNKS:
            del self._chunks[next(iter(self._chunks))]
        return False

    def new_rows(self, name: str, rows: Rows) -> Rows:
        """Return the messages of a topic that are neither there already nor out of order.

        Both (messages, bytes of each record).
        """
        kind = TOPICS.get(name, ("", ""))[1]
        if kind in _LEAST and len(rows):
            keep = self._in_order(name, rows, _LEAST[kind])
            if not keep.all():
                self.left_out[f"messages of {name}"] += len(rows) - int(keep.sum())
                rows = rows[keep]
        self.kept[name] += len(rows)
        return rows

    def _in_order(self, name: str, rows: Rows, least: int) -> NDArray[np.bool_]:
        """Return which messages are by `least` later than those before; cycle numbers wrap."""
        low = np.ascontiguousarray(rows[:, SEQUENCE]).view("<u4")[:, 0].astype(np.int64)
        newest, behind = self._newest.get(name, (int(low[0]) - 1, False))
        rises = not behind and int(low[0]) - newest >= least and int(low[-1]) - newest < _HALF
        if rises and (low[1:] - low[:-1] >= least).all():  # as a rule
            self._newest[name] = int(low[-1]), False
            return np.ones(len(rows), np.bool_)
        ahead = (low - newest + _HALF) % (2 * _HALF) - _HALF
        top = np.maximum.accumulate(np.concatenate(([0], ahead)))
        later = ahead - top[:-1]
        turns = np.concatenate(([-1 if behind else 1], np.sign(later)))
        last_turn = np.maximum.accumulate(np.where(turns != 0, np.arange(len(turns)), 0))
        rising = turns[last_turn] > 0  # what has fallen behind stays out until it is ahead again
        self._newest[name] = (newest + int(top[-1])) % (2 * _HALF), not rising[-1]
        return np.asarray(rising[1:] & (later >= least))

    def notes(
        self, metadata: Mapping[str, Mapping[str, str]], files: Collection[str], closed: bool
    ) -> list[str]:
        """Return what is missing in a log that was read to its end, or stands twice, in words.

        `closed`: nothing was found wrong with the file. Of logs without a node nothing is known.
        """
        if not any(node in metadata or f"{node}.json" in files for node in ROLES):
            return []
        lines = [
            f"{LEFT_OUT}, or behind later ones: {count} {name}"
            for name, count in sorted(self.left_out.items())
        ]
        if "run" in metadata:
            return lines + self._count_differences(_numbers(metadata["run"]), metadata)
        notes = metadata.get("recovered")
        if notes is None and closed:
            return [*lines, "the recorder's counts (metadata run): whether all is there is unknown"]
        return lines + [text for key, text in (notes or {}).items() if key.startswith("missing ")]

    def _count_differences(self, run: Mapping[str, int], metadata: Collection[str]) -> list[str]:
        """Return how the messages differ from the counts of the recorder."""
        columns: dict[str, int] = {}  # and frames: messages expected by topic
        entries: list[str] = []
        for node in ROLES:
            written = {key: run.get(f"written.{node}.{key}", 0) for key in ("record", "frame")}
            state, timing, frames, *others = (topic(node, kind) for kind in KINDS)
            columns |= {state: written["record"], frames: written["frame"]}
            for name, word in OTHER_ENTRIES.items():
                columns[topic(node, name)] = run.get(f"written.{node}.{word}", 0)
            if f"variables:{timing}" in metadata or self.kept[timing]:  # imported logs have none
                columns[timing] = written["record"]
            low = run.get(f"written.{node}.event", 0)
            high = low + run[alarms] if (alarms := f"written.{node}.alarm") in run else None
            count = sum(self.kept[name] for name in others)
            entries += _differs(" and ".join(others), count, low if high is None else high, high)
        if gone := run.get("discarded", 0):
            total = sum(self.kept[name] for name in columns)
            meant = sum(columns.values()) - gone
            return _differs("cycles and frames", total, meant, meant) + entries
        return [
            line
            for name, count in columns.items()
            for line in _differs(name, self.kept[name], count, count)
        ] + entries


def _numbers(counts: Mapping[str, str]) -> dict[str, int]:
    """Return the counts that are some; others count as none."""
    return {k: int(text) for k, text in counts.items() if text.isdecimal() and len(text) < 19}


def _differs(name: str, count: int, low: int, high: int | None) -> list[str]:
    """Return a line if messages are missing, or are more than `high`, where that is known."""
    if count < low:
        return [f"{name}: {low - count} of {low} messages"]
    if high is not None and count > high:
        return [f"{name}: {count} messages where the recorder wrote {high}"]
    return []
