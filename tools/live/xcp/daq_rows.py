"""What lists may send of each cycle: recorded variables, and what changes by tunings alone.

No row has a parameter, but the ring of events has tunings, with the first cycle that they act in.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.loop.events import Event
from pcpc.executive.loop.ring_layout import OfEvent
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.tap import Tap
from pcpc.tools.live.xcp.a2l import A2lVariable


class DaqRows:
    """Successive cycles of a running node. `columns`: of each variable its place, -1 for none."""

    def __init__(self, live: Live, variables: Sequence[A2lVariable]) -> None:
        """Begin with the next cycle; LiveError: it stands still in the middle of one."""
        self._live, self._tap = live, Tap(live)
        places = {name: place for place, name in enumerate(self._tap.names)}
        self._numbers = [
            i for i, one in enumerate(variables) if one.has_event and one.name not in places
        ]
        self._places = {number: place for place, number in enumerate(self._numbers)}
        places |= {variables[number].name: len(places) + i for number, i in self._places.items()}
        self.columns = [places.get(one.name, -1) for one in variables]
        self._values = live.read().array[self._numbers]
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
        tuned = np.repeat(self._values[np.newaxis], len(rows), axis=0)
        while self._changes and len(rows) and self._changes[0][0] <= rows.cycle[-1]:
            cycle, place, value = self._changes.popleft()
            tuned[rows.cycle >= cycle, place] = self._values[place] = value
        return rows.cycle, np.hstack([rows.values, tuned])
