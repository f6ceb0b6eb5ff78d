"""A terminal of another machine: it asks and is answered, one after the other; nothing else comes.

It reads what nodes publish and tunes them, as the same commands do here by `nodes.live`: the client
has the node's description, and the node judges each tuning by itself. A node has a handle, its name
and process, so that a later run of the same name is another one.
"""

import json
from collections.abc import Callable, Mapping
from typing import Any

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.tools.live.host import client_messages as messages
from pcpc.tools.live.remote import fields

RATE, BURST = 200.0, 400.0  # questions a second; at once
MOST_NODES = 64  # that one of them may hold

Running = Callable[[], Mapping[str, Live]]


class Terminal:
    """One of them. `nodes` gives those that run; `write`: whether it may tune."""

    def __init__(self, nodes: Running, write: bool) -> None:
        self._nodes, self._write = nodes, write
        self._held: dict[str, Live] = {}  # also after their end, for their last rows

    def answer(self, word: messages.FromTerminal) -> str | bytes:
        """Return the answer to a question, which repeats its id."""
        try:
            found = self._answer(word)
        except UserError as error:
            found = {"refused": word.id, "why": str(error), "code": int(error.code)}
        return found if isinstance(found, bytes) else json.dumps(found)

    def _answer(self, word: messages.FromTerminal) -> dict[str, Any] | bytes:
        if isinstance(word, messages.Nodes):
            handles = {f"{name}@{live.pid}": live for name, live in self._nodes().items()}
            self._hold(handles)
            return {"done": word.id, "version": fields.VERSION, "nodes": [*handles]}
        live = self._node(word.node)
        match word:
            case messages.Describe():
                return {"done": word.id, "about": live.block.description}
            case messages.Look():
                return fields.look(word.id, live, word.fields)
            case messages.Rows():
                try:
                    return fields.rows(word.id, live, word.ring, word.since, word.columns)
                except IndexError:
                    raise LiveError(f"{word.ring}: no such column") from None
        if not self._write:
            raise UserError("this host is read-only; start it with `pcpc host --write`")
        if isinstance(word, messages.Tune):
            return {"done": word.id, "cycle": live.tune(word.values)}
        live.lock(word.level)
        return {"done": word.id}

    def _hold(self, handles: Mapping[str, Live]) -> None:
        """Keep nodes; where there are too many, those that have ended go."""
        self._held |= {key: live for key, live in handles.items() if key not in self._held}
        for key in [key for key in self._held if key not in handles]:
            if len(self._held) > MOST_NODES:
                del self._held[key]

    def _node(self, handle: str) -> Live:
        if handle not in self._held:
            raise LiveError(f"{handle}: no such node", Exit.ENVIRONMENT)
        return self._held[handle]
