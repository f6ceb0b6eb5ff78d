"""What a client may do to a run: tune, undo, stop, reset, lock, begin a fault; all by `nodes.live`.

Also record it, see `host.recordings`. One after the other, for all clients of a server. Each
answer to a change names the cycle from which it holds.
"""

import threading
from collections.abc import Callable, Mapping
from typing import Any

from pcpc.drivers.errors import UserError
from pcpc.executive.nodes import injecting, operating
from pcpc.executive.nodes.live import Live
from pcpc.tools.live import tunings
from pcpc.tools.live.host import client_messages as messages
from pcpc.tools.live.host.recordings import Recordings
from pcpc.tools.live.host.sources import RunSource, full
from pcpc.tools.live.operation import nodes_in_fault

_NOTHING = "no run is shown; choose one if there are several, or start one with `pcpc run RIG`"
_WORDS = {
    "stop": {"supervisor.stop": 1.0},
    "quick_stop": {"supervisor.stop": 2.0},
    "forget_timing": {"timing.reset": 1.0},
}
_OPERATIONS = {"arm": operating.arm, "hold": operating.hold}
_LEVELS = {"lock": "tune", "unlock": "none"}


class Actions:
    """Those of one server; `source` gives the run that is shown."""

    def __init__(
        self, source: Callable[[], RunSource], write: bool, recordings: Recordings | None = None
    ) -> None:
        self._source, self.write = source, write
        self.recordings = recordings or Recordings()
        self._turn = threading.Lock()
        self._tuned = "executive"  # the node that was tuned last

    @property
    def undoes(self) -> int:
        """How many tunings of the run can be undone, whoever made them."""
        nodes = self._source().nodes.values() if self._source().live else ()
        return sum(len(tunings.states(node.live)) - 1 for node in nodes)

    def do(self, wanted: messages.Action) -> dict[str, Any]:
        """Carry one out; return what is told of it. UserError: refused, nothing has changed."""
        if isinstance(wanted, messages.Act) and wanted.what == "clear":
            return self._clear(self._source())
        if not self.write:
            raise UserError("this page is read-only; start `pcpc host` with --write")
        source = self._source()
        if not source.live or not source.nodes:
            raise UserError(_NOTHING)
        if isinstance(wanted, messages.Snapshot):
            return self.recordings.snapshot(source, wanted.last_s)
        with self._turn:
            match wanted:
                case messages.Record():
                    return self.recordings.stop() if wanted.end else self.recordings.start(source)
                case messages.Set():
                    return self._set(source, wanted.values)
                case messages.Undo():
                    return self._undo(source)
                case messages.Handover():
                    executive = self._executive(source)
                    return {"cycle": operating.hand_over(executive, wanted.controller)}
                case messages.Fault():
                    nodes = [node.live for node in source.nodes.values()]
                    cycles = injecting.inject(nodes, wanted.name, wanted.for_s, end=wanted.end)
                    return {"cycle": min(cycles.values())}
            return {"cycle": self._act(source, wanted.what)}

    def _clear(self, source: RunSource) -> dict[str, Any]:
        """Forget the cycles that were, for all clients of this server; the log has them."""
        last = source.span()[1]
        for node in source.nodes.values() if source.live else ():
            node.clear()
        return {"cycle": last + 1}

    def _set(self, source: RunSource, values: Mapping[str, float]) -> dict[str, Any]:
        places = {name: source.place(name) for name in values}
        roles = {role for role, _ in places.values()}
        if len(roles) != 1:
            raise UserError("of two nodes; set one node's at a time")
        (role,) = roles
        cycle = source.nodes[role].live.tune({places[k][1]: v for k, v in values.items()})
        self._tuned = role
        return {"cycle": cycle, "values": dict(values)}

    def _undo(self, source: RunSource) -> dict[str, Any]:
        nodes = {role: node.live for role, node in source.nodes.items()}
        tuned = [role for role, live in nodes.items() if len(tunings.states(live)) > 1]
        role = self._tuned if self._tuned in tuned or not tuned else tuned[0]
        live = nodes[role if role in nodes else next(iter(nodes))]
        changes = tunings.undo_changes(live)
        values = {full(role, name): value for name, value in changes.items()}
        return {"cycle": live.tune(changes), "values": values}

    def _act(self, source: RunSource, action: str) -> int:
        """Carry out one of the actions that have nothing but a name."""
        if action in _WORDS:
            first: Live = next(iter(source.nodes.values())).live
            return first.tune(_WORDS[action])
        if action in _LEVELS:
            for node in source.nodes.values():
                node.live.lock(_LEVELS[action])
            return source.span()[1]
        if action == "reset":
            return self._reset(source)
        if action in _OPERATIONS:
            return _OPERATIONS[action](self._executive(source))
        known = ", ".join((*_WORDS, *_OPERATIONS, "reset", *_LEVELS))
        raise UserError(f"{action}: no such action; known: {known}")

    def _executive(self, source: RunSource) -> Live:
        if "executive" not in source.nodes:
            raise UserError("the executive does not run here")
        live: Live = source.nodes["executive"].live
        return live

    def _reset(self, source: RunSource) -> int:
        faulted = nodes_in_fault(node.live for node in source.nodes.values())
        if not faulted:
            raise UserError("no node is in FAULT")
        return max(live.tune({"supervisor.reset": 1.0}) for live in faulted)
