"""What lists may send of each cycle: the recorded variables, and the parameters of blocks.

No row has a parameter. It changes by tunings alone, and the ring of events has them with the first
cycle that they act in.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.loop.events import Event
from pcpc.executive.loop.ring_layout import OfEvent
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.tap import Tap

_OF_LOOP = "timing", "supervisor"  # whose parameters the loop itself sets back


def is_held(name: str, is_parameter: bool) -> bool:
    """Whether a variable that no row has keeps its value from tuning to tuning."""
    return is_parameter and name.partition(".")[0] not in _OF_LOOP


class DaqRows:
    """Successive cycles of a running node. `columns`: of each variable its place, -1 for none."""

    def __init__(self, live: Live) -> None:
        """Begin with the next cycle; LiveError: it stands still in the middle of one."""
        self._live, self._tap = live, Tap(live)
        held = [i for i, v in enumerate(live.variables.values()) if is_held(v.name, bool(v.range))]
        self._numbers, self._places = held, {number: place for place, number in enumerate(held)}
        names = (*self._tap.names, *(list(live.variables)[number] for number in held))
        places = {name: place for place, name in enumerate(names)}
        self.columns = [places.get(name, -1) for name in live.variables]
        self._values = live.read().array[held]
        self._changes = deque[tuple[int, int, float]]()

    @property
    def missed(self) -> int:
        """How many rows were overwritten before they were read."""
        return self._tap.missed["record"] + self._tap.missed["event"]

    def take(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the cycles since the last look (n,) and their values (n, columns)."""
        rows, before = self._tap.rows(), self._tap.missed["event"]
        events = self._tap.raw("event")
        for _, cycle, _, number, bits in events[events[:, OfEvent.CODE] == Event.TUNING]:
            if number in self._places:
                self._changes.append((int(cycle), self._places[number], bits.view(np.float64)))
        if self._tap.missed["event"] > before:
            self._values = self._live.read().array[self._numbers]
        held = np.repeat(self._values[np.newaxis], len(rows), axis=0)
        while self._changes and len(rows) and self._changes[0][0] <= rows.cycle[-1]:
            cycle, place, value = self._changes.popleft()
            held[rows.cycle >= cycle, place] = self._values[place] = value
        return rows.cycle, np.hstack([rows.values, held])
