"""What the host shows: a run that goes on, or a finished log. Both look alike to the page.

Variables are called as in Python: `controller.e_rad` of the executive, `plant:barrel.theta_rad` of
another node. A node gives any part of its cycles, of recorded variables; how many of the newest a
running one keeps is bounded.
"""

import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.log import reader as logs
from pcpc.executive.log.description import node_description
from pcpc.executive.log.event_entries import entry_of
from pcpc.executive.loop.ring_layout import EVENT_WORDS, frame_words
from pcpc.executive.nodes import live as nodes
from pcpc.executive.nodes.tap import Rows, Tap
from pcpc.tools.live.history import Cycles, History, Newest, Values
from pcpc.tools.live.host.runs import LiveRuns, run_of
from pcpc.tools.live.host.traffic import Traffic

KEPT_S, KEPT_BYTES = 120.0, 64 << 20  # of each node, whichever is less
FRAMES_KEPT, EVENTS_KEPT = 1 << 19, 1 << 12  # 20 MB: 40 s of 13 frames a cycle at 1 kHz


@dataclass(frozen=True)
class Stretch:
    """Copies of some seconds of a node: its description, cycles, rows as its rings have them."""

    about: Mapping[str, Any]
    rows: Rows
    frames: NDArray[np.int64]
    events: NDArray[np.int64]


class LiveNode:
    """A running node, and its newest cycles, frames and events; `names`: what it records."""

    def __init__(self, live: nodes.Live) -> None:
        self.live, self.tap = live, Tap(live)
        self.description = live.block.description
        self.role = str(self.description["node"])
        self.period_s, self.variables = 1e-9 * live.period_ns, live.variables
        self.names = self.tap.names
        self._places = {name: place for place, name in enumerate(self.names)}
        rows = int(min(KEPT_S / self.period_s, KEPT_BYTES / (10 * len(self.names) + 20)))
        self._history = History(max(rows, 2), len(self.names))
        self._frames = Newest(FRAMES_KEPT, (frame_words(self.description),), np.int64)
        self._events = Newest(EVENTS_KEPT, (EVENT_WORDS,), np.int64)
        self._turn = threading.Lock()  # between what comes and who copies it
        self.traffic = Traffic(live)

    def poll(self) -> list[tuple[int, str, dict[str, Any]]]:
        """Take what the node has recorded since; return its events: cycle, topic, entry."""
        rows, frames, events = self.tap.rows(), self.tap.frames(), self.tap.raw("event")
        with self._turn:
            self._history.add(rows.cycle, rows.stamp_ns, rows.values)
            self._frames.add(frames)
            self._events.add(events)
        self.traffic.add(frames)
        about = node_description(self.description)
        return [(int(row[1]), *entry_of(row, about)) for row in events]

    def clear(self) -> None:
        """Forget the cycles that were."""
        with self._turn:
            self._history.clear()

    def newest(self, last_s: float) -> Stretch:
        """Return copies of the newest seconds that are there."""
        with self._turn:
            cycle = self._history.cycle
            first = (int(cycle[-1]) if len(cycle) else 0) - round(last_s / self.period_s) + 1
            new, history = slice(int(np.searchsorted(cycle, first)), None), self._history
            stamps, values = history.stamp_ns[new].copy(), history.values[new].copy()
            rows = Rows(cycle[new].copy(), stamps, values, self._places)
            frames, events = self._frames.rows, self._events.rows
            frames, events = frames[frames[:, 2] >= first], events[events[:, 1] >= first]
            return Stretch(self.description, rows, frames, events)

    def part(self, names: Sequence[str], first: int, last: int) -> tuple[Cycles, Values]:
        """Return the cycles `first` to `last` that are there, and values (n, names)."""
        return self._history.part([self._places[name] for name in names], first, last)

    def span(self) -> tuple[int, int]:
        """Return the first and the last cycle that are there; (0, -1) for none."""
        return _ends(self._history.cycle)


class LoggedNode:
    """A node as a log has it, which looks like a running one."""

    def __init__(
        self, role: str, node: logs.NodeLog, units: Mapping[str, nodes.LiveVariable]
    ) -> None:
        self.role, self._node, self.variables = role, node, units
        self.description = node.description
        self.period_s = 1e-9 * float(node.description["period_ns"])
        self._columns = {**node.columns, **node.timing}
        self.names = [*self._columns]

    def part(self, names: Sequence[str], first: int, last: int) -> tuple[Cycles, Values]:
        """See LiveNode."""
        begin, end = np.searchsorted(self._node.cycle, (first, last + 1))
        columns = [self._columns[name][begin:end] for name in names]
        return self._node.cycle[begin:end], np.array(columns).T.reshape(end - begin, len(names))

    def span(self) -> tuple[int, int]:
        """See LiveNode."""
        return _ends(self._node.cycle)


def _ends(cycle: Cycles) -> tuple[int, int]:
    return (int(cycle[0]), int(cycle[-1])) if len(cycle) else (0, -1)


@dataclass
class RunSource:
    """One run. `number` changes with every run that is shown.

    `parts`: what clients were sent of it since it was polled, as others may want the same.
    `note`: what the page says of it; such a log plays by itself.
    """

    rig: str
    live: bool
    nodes: dict[str, Any] = field(default_factory=dict)
    number: int = 0
    log: logs.Log | None = None
    parts: dict[Any, Any] = field(default_factory=dict)
    note: str = ""

    def place(self, name: str) -> tuple[str, str]:
        """Return role and variable of a name; UserError."""
        role, colon, variable = name.rpartition(":")
        if not colon:
            having = [one for one, node in self.nodes.items() if variable in node.variables]
            role = having[0] if having else "executive"  # which comes first
        if role not in self.nodes or variable not in self.nodes[role].variables:
            raise UserError(f"{name}: no such variable{did_you_mean(name, [*self.names()])}")
        return role, variable

    def curve(self, name: str) -> tuple[str, str]:
        """Return role and variable of what is recorded; UserError."""
        role, variable = self.place(name)
        if variable not in self.nodes[role].names:
            raise UserError(f"{name}: not recorded, so it has no curve")
        return role, variable

    @property
    def version(self) -> tuple[int, int]:
        """What changes with another run, and with a node that comes later."""
        return self.number, len(self.nodes)

    def names(self) -> Iterator[str]:
        """Yield all variables, the executive's first."""
        for role, node in self.nodes.items():
            yield from (full(role, name) for name in node.variables)

    @property
    def period_s(self) -> float:
        """The period of its cycles."""
        return min((node.period_s for node in self.nodes.values()), default=1.0)

    def span(self) -> tuple[int, int]:
        """Return the first and last cycle of any node; (0, -1) for none."""
        spans = [node.span() for node in self.nodes.values()]
        spans = [span for span in spans if span[1] >= span[0]]
        return (min(a for a, _ in spans), max(b for _, b in spans)) if spans else (0, -1)


def complete(source: RunSource) -> int:
    """Return the newest cycle that all nodes have given which still run; -1 for none."""
    ends = [n.span()[1] for n in source.nodes.values() if source.live and n.live.running]
    return min(ends, default=source.span()[1])


def full(role: str, name: str) -> str:
    """Return what the page calls a variable of a node."""
    return name if role == "executive" else f"{role}:{name}"


def _executive_first(roles: Iterable[str]) -> list[str]:
    return sorted(roles, key=lambda role: (role != "executive", role))


def of_log(log: logs.Log) -> RunSource:
    """Return what a finished log shows."""
    by_role: dict[str, Any] = {}
    for role in _executive_first(log.node):
        node = log.node[role]
        known = {row[0]: row for row in node.description.get("variables", [])}
        units = {
            name: nodes.LiveVariable(*known.get(name, (name, "", "", "", "")))
            for name in (*node.columns, *node.timing)
        }
        by_role[role] = LoggedNode(role, node, units)
    rig = next(iter(log.node.values())).description.get("rig", log.path.stem)
    return RunSource(str(rig), False, by_role, 1, log)


class FollowedRun:
    """A run of this user's rigs, or of one: found, followed, and kept after its end.

    `node`: the full name of one of its nodes, where several run; `runs`: nodes that were found
    already. `asks`: where several go on, it shows none until one is chosen. `before`: what is shown
    until a run is found.
    """

    asks = False

    def __init__(
        self,
        rig: str = "",
        node: str = "",
        runs: LiveRuns | None = None,
        before: RunSource | None = None,
    ) -> None:
        self.runs, self._run = runs or LiveRuns(rig, run_of(node)), run_of(node)
        self.source = before or RunSource(rig, True)

    def find(self) -> bool:
        """Look for nodes that have come or gone; return whether another run is shown now."""
        shown = self.source.nodes
        if self.source.live and any(node.live.running for node in shown.values()):
            return self._joined()
        lives = self.runs.nodes()
        runs = {run_of(name) for name, live in lives.items() if live.under_way}
        runs = runs & {self._run} if self._run else runs
        if not runs or (self.asks and len(runs) > 1):
            return False
        run = min(runs)
        live = [one for name, one in lives.items() if run_of(name) == run]
        rig = str(live[0].block.description["rig"])
        self.source = RunSource(rig, True, {}, self.source.number + 1)
        self._take(live)
        return True

    def _joined(self) -> bool:
        """Take up nodes of the run that came later."""
        having = {node.live.name for node in self.source.nodes.values()}
        run = run_of(min(having))
        late = [
            live
            for name, live in self.runs.nodes().items()
            if run_of(name) == run and name not in having
        ]
        self._take(late)
        return bool(late)

    def _take(self, found: Sequence[nodes.Live]) -> None:
        nodes = dict(self.source.nodes)  # anew: other threads read the one that is there
        for live in found:
            with suppress(KeyError, TypeError, ValueError):  # it says nothing sensible of itself
                node = LiveNode(live)
                nodes[node.role] = node
        self.source.nodes = {role: nodes[role] for role in _executive_first(nodes)}

    def poll(self) -> list[tuple[str, int, str, dict[str, Any]]]:
        """Take what the nodes have recorded since; return role, cycle, topic, entry of events."""
        nodes = self.source.nodes.items() if self.source.live else ()
        return [(role, *event) for role, node in nodes for event in node.poll()]
