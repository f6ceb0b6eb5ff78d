"""What a recorder sees in a node's memory besides the rows of its rings: each a line of OBSERVERS.

An entry of an observer stands under its topic, a new one's under one of its own with a schema in
`log.schemas`; metadata `run` counts them by its word.
"""

import time
from collections.abc import Iterator
from typing import Any, Protocol

from pcpc.executive.log.keyframes import Keyframes
from pcpc.executive.loop.alarms import Alarms
from pcpc.executive.loop.shared import NodeMemory

Seen = tuple[int, int, dict[str, Any]]  # stamp of the machine's clock, cycle, entry


class Observer(Protocol):
    """What looks at a node, of which `block` is the memory, each time that its rings are drained.

    `schema`: of `log.schemas`, where the topic is its own and the node has it. `waits`: a log that
    keeps a part of the run holds it back.
    """

    word: str
    topic: str
    waits: bool

    def __init__(self, block: NodeMemory) -> None: ...

    @property
    def schema(self) -> str | None:
        """Return the name of the schema."""

    def look(self) -> Iterator[Seen]:
        """Yield what is new since the last look."""
        ...


class AlarmNotes:
    """Alarms, among the events."""

    word, topic, waits, schema = "alarm", "events", False, None

    def __init__(self, block: NodeMemory) -> None:
        self._alarms = Alarms(block)

    def look(self) -> Iterator[Seen]:
        """Yield each alarm."""
        for alarm in self._alarms.look():
            entry = {"event": "alarm", "name": alarm.kind, "value": float(alarm.count)}
            yield time.monotonic_ns(), alarm.cycle, entry


OBSERVERS: tuple[type[Observer], ...] = (AlarmNotes, Keyframes)
