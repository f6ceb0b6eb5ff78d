"""The snapshot ring: messages wait in memory, and reach the file only when something happens.

    record: {keep: 30s, on: fault}     in a rig file; `on` is one or a list of
                                       fault   a node faults or dies
                                       change  a variable under `note:` changes
                                       skip    periods were skipped
                                       tuning  a parameter changed while running

When it happens, what is held (the last `keep`) is written, and what follows for as long again. Of
the rest of the run only events and tunings are in the log. Such a log shows, plots and plays, but
does not begin with the start of the run, so it cannot be recomputed.
"""

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log.mcap_writer import BulkWriter
from pcpc.executive.loop.events import Event

CODES = {
    "fault": Event.FAULT,
    "change": Event.CHANGE,
    "skip": Event.SKIP,
    "tuning": Event.TUNING,
}


class Sink:
    """Hands all messages on."""

    discarded = 0

    def __init__(self, writer: BulkWriter) -> None:
        self._writer = writer

    def add(self, messages: Sequence[NDArray[Any]]) -> None:
        """Take the messages of one batch, each array (n,)."""
        self._writer.add(messages)

    def write(self, messages: Sequence[NDArray[Any]]) -> None:
        """Take messages that are never held back, each array (n,)."""
        self._writer.add(messages)

    def note_event(self, code: int, when_ns: int) -> None:
        """Take note of an event and its log time."""

    def note_death(self) -> None:
        """Take note of a node's death, just after its last message."""

    def close(self) -> None:
        """End."""


class SnapshotRing(Sink):
    """Holds the messages of the last `keep_ns` back until an event of the kinds `on`."""

    def __init__(self, writer: BulkWriter, keep_ns: int, on: Sequence[str]) -> None:
        super().__init__(writer)
        self._keep_ns, self._codes = keep_ns, {CODES[name] for name in on}
        self._held: deque[NDArray[Any]] = deque()
        self._newest_ns = 0
        self._open_ns = (0, -1)  # log times between which messages go to the file

    def add(self, messages: Sequence[NDArray[Any]]) -> None:
        """Hand on what lies in the open stretch of time, hold the rest; each array (n,)."""
        self._writer.add([self._split(m) for m in messages if len(m)])
        while self._held and self._held[0]["log_time"].max() + self._keep_ns < self._newest_ns:
            self.discarded += len(self._held.popleft())

    def _split(self, messages: NDArray[Any]) -> NDArray[Any]:
        """Return the messages in the open stretch; hold the others."""
        times = messages["log_time"].astype(np.int64)
        self._newest_ns = max(self._newest_ns, int(times.max()))
        inside = (times >= self._open_ns[0]) & (times <= self._open_ns[1])
        if not inside.all():
            self._held.append(messages[~inside])
        return messages[inside]

    def note_event(self, code: int, when_ns: int) -> None:
        """Open the stretch around `when_ns` if `code` is one of those waited for."""
        if code not in self._codes:
            return
        first, last = when_ns - self._keep_ns, when_ns + self._keep_ns
        if first <= self._open_ns[1]:
            first, last = min(first, self._open_ns[0]), max(last, self._open_ns[1])
        self._open_ns = first, last
        held, self._held = self._held, deque()
        for messages in held:
            self._writer.add([self._split(messages)])

    def note_death(self) -> None:
        """As a fault at the newest log time."""
        self.note_event(CODES["fault"], self._newest_ns)

    def close(self) -> None:
        """Count what is still held: nothing happened since."""
        self.discarded += sum(map(len, self._held))
        self._held.clear()
