"""What a run's nodes did since the last look: cycles, frames, alarms; read as a tap reads.

load     of the bus, see `tools.start.bus_load`; of the fuller one where a local node is between two
errors   the rig's `watch`, then outputs called e or error, with the largest magnitude of the
         last interval and of all
"""

import re
import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pcpc.drivers.can import can_id
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.executive.loop import faults
from pcpc.executive.loop.alarms import Alarms
from pcpc.executive.nodes.live import CycleValues, Live
from pcpc.executive.nodes.tap import Tap, columns_of
from pcpc.executive.rig.roles import ROLES
from pcpc.tools.start import bus_load

_ERROR = re.compile(r"\.(e|err|error)(_|$|\d)")
_ALARMS = 3


@dataclass(frozen=True)
class FrameRow:
    """A frame as a node receives it: how many a second, and what the check made of them so far."""

    name: str
    node: str
    rate_hz: float
    counts: Mapping[int, int]  # by state of `drivers.can.e2e_states`

    @property
    def wrong(self) -> int:
        """How many were not as they should be."""
        return sum(count for state, count in self.counts.items() if state != FrameState.OK)


class NodeMeter:
    """One node between looks."""

    def __init__(self, live: Live) -> None:
        description = live.block.description
        self.live, self.role = live, str(description["node"])
        self.alarms, recorded = Alarms(live.block), columns_of(description)
        self.names = {int(word): str(name) for word, name in description["frames"].items()}
        watched = [description["watch"]] if description["watch"] in recorded else []
        outputs = (name for name in recorded if live.variables[name].kind == "output")
        self.errors = [*dict.fromkeys([*watched, *(n for n in outputs if _ERROR.search(n))])]
        self.tap = Tap(live, names=self.errors)
        self.worst, self.interval_worst = (
            dict.fromkeys(self.errors, 0.0),
            dict.fromkeys(self.errors, 0.0),
        )
        self.passes, self.rate_hz = int(live.block.control.passes), 0.0
        self.received: dict[int, Counter[int]] = {}  # by id and state, of all looks
        self.seen = bus_load.Kinds()  # of the last one
        self.arrivals: Counter[int] = Counter()
        self.now: CycleValues = live.read()

    def look(self, over_s: float) -> None:
        """Take what came in the last `over_s` seconds."""
        self.now = self.live.read()
        passes = int(self.live.block.control.passes)
        self.rate_hz, self.passes = (passes - self.passes) / over_s, passes
        rows = self.tap.rows()
        for name in self.errors if len(rows) else ():
            self.interval_worst[name] = float(np.max(np.abs(rows[name])))
            self.worst[name] = max(self.worst[name], self.interval_worst[name])
        last = bus_load.FrameCounts(self.tap.frames())
        self.seen, self.arrivals = last.seen, Counter()
        for number, states in last.received.items():
            self.arrivals[number] = states.total()
            self.received.setdefault(number, Counter()).update(states)

    def fault(self) -> str:
        """Return the reason of its fault, "" for none."""
        control = self.live.block.control
        return faults.reason(self.live.block.description, control) if control.fault else ""


class Meter:
    """All nodes of a run that are here."""

    def __init__(self, nodes: Mapping[str, Live]) -> None:
        bus = bus_load.bus_of(next(iter(nodes.values())).block.description)
        self.bitrate, self._data_bit = bus.bits_per_s, bus.data_bit
        self.nodes = [NodeMeter(live) for live in nodes.values()]
        self._last_s, self.over_s = time.monotonic(), 0.0
        self.nodes.sort(key=lambda one: ROLES.index(one.role))
        self.leader = self.nodes[0]
        self.alarm_lines: deque[str] = deque(maxlen=_ALARMS)

    @property
    def running(self) -> bool:
        """Whether its leading node goes on."""
        return self.leader.live.running

    def look(self) -> None:
        """Read all nodes."""
        now_s = time.monotonic()
        self.over_s, self._last_s = max(now_s - self._last_s, 1e-3), now_s
        for one in self.nodes:
            one.look(self.over_s)
            self.alarm_lines.extend(str(alarm) for alarm in one.alarms.look())

    def bits_per_s(self) -> float:
        """Return what the bus carried a second, at most."""
        seen = {one.role: one.seen for one in self.nodes}
        return max(bus_load.on_buses(seen, self._data_bit)) / self.over_s

    def frames(self) -> list[FrameRow]:
        """Return the frames that arrivals, those with something wrong first."""
        rows = [
            FrameRow(
                node.names.get(number & can_id.ID, f"{number & can_id.ID:X}"),
                node.role,
                node.arrivals[number] / self.over_s,
                counts,
            )
            for node in self.nodes
            for number, counts in node.received.items()
        ]
        return sorted(rows, key=lambda row: (-row.wrong, row.name))
