"""Nodes of another machine with the interface of `executive.nodes.live`, so that commands are one.

A node's memory is mirrored: what a command looks at is fetched, all that it has looked at so far in
one question, and holds for FRESH_S. Rows of the rings come as often as they are asked for, every
one; what was overwritten before is counted, as it is here. The node judges each tuning.
"""

import time
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.ring_layout import EVENT_WORDS, frame_words
from pcpc.executive.nodes import live as here
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.mailbox import LEVELS
from pcpc.tools.live.local_nodes import Nodes
from pcpc.tools.live.remote import answers, fields
from pcpc.tools.live.remote.link import Link

FRESH_S = 0.02
MOST_ROWS = sh.RECORD_RING_WORDS  # more than any ring has
_EVEN = np.zeros(sh.LINE_WORDS, np.int64)  # the count of writers, of what is whole


class Mirror(sh.NodeMemory):
    """What a node publishes, as of the last question; a field that is new is asked for."""

    def __init__(self, link: Link, handle: str, about: dict[str, Any]) -> None:
        self.name, self.description, self.client, self.loop = str(about["name"]), about, None, None
        self._link, self._handle = link, handle
        self._wanted = ["control"]
        self._found: dict[str, NDArray[Any]] = {}
        self._alive, self._until_s = True, 0.0

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name == "seq":
            return _EVEN
        if name not in self._wanted:
            self._wanted.append(name)
            self.forget()
        self._look()
        return self._found[name]

    def alive(self) -> bool:
        """See Shared."""
        self._look()
        return self._alive

    def forget(self) -> None:
        """Ask again at the next look."""
        self._until_s = 0.0

    def _look(self) -> None:
        if time.monotonic() < self._until_s:
            return

        def read(body: Any) -> tuple[bool, dict[str, NDArray[Any]]]:
            alive, found = fields.fields_of(body, self._wanted, self.description)
            answers.check_values(found, self.description)
            return alive, found

        about = {"node": self._handle, "fields": self._wanted}
        self._alive, self._found = self._link.answer(read, "look", **about)
        self._until_s = time.monotonic() + FRESH_S


class Remote(Live):
    """A node that runs elsewhere."""

    def __init__(self, link: Link, handle: str, about: dict[str, Any]) -> None:
        self._mirror, self._link, self._handle = Mirror(link, handle, about), link, handle
        self._asked_s: dict[str, float] = {}
        super().__init__(self._mirror)

    def rows(
        self, ring: str, since: int, columns: Sequence[int] | None = None
    ) -> tuple[NDArray[np.int64], int]:
        """See Live; rows (n, columns) up to the ring's end at the first question, or to a gap.

        It waits where the last time was less than FRESH_S ago.
        """
        broad = len(columns) if columns is not None else self._columns(ring)
        time.sleep(max(0.0, self._asked_s.get(ring, 0.0) - time.monotonic()))
        parts: list[NDArray[np.int64]] = []
        begin, at, end = since, since, since + 1
        while at < end:
            about = {"ring": ring, "since": at, "columns": columns and list(columns)}

            def read(body: Any) -> tuple[NDArray[np.int64], int, int]:
                rows, first, newest = fields.rows_in(body)
                if not 0 <= first <= newest or len(rows) > newest - first:
                    raise ValueError("rows that do not exist")
                return answers.rows_of_width(rows, broad), first, newest

            taken, first, newest = self._link.answer(read, "rows", node=self._handle, **about)
            if not parts:
                begin, at, end = first, first, min(newest, first + MOST_ROWS)
            if first != at or not len(taken):
                break
            parts.append(taken)
            at += len(taken)
        self._asked_s[ring] = time.monotonic() + FRESH_S
        return np.concatenate(parts) if parts else np.empty((0, broad), np.int64), begin

    def tune(self, changes: Mapping[str, float]) -> int:
        """See Live."""
        self.check(changes)
        try:
            about = {"node": self._handle, "values": dict(changes)}
            return self._link.answer(lambda told: int(told["cycle"]), "tune", **about)
        finally:
            self._mirror.forget()

    def lock(self, level: str) -> None:
        """See Live."""
        if level not in LEVELS:
            super().lock(level)
        self._link.ask("lock", node=self._handle, level=level)

    def _columns(self, ring: str) -> int:
        about = self._mirror.description
        own = int(about["record_columns"])
        return {"record": own, "frame": frame_words(about), "event": EVENT_WORDS}[ring]


class RemoteNodes(Nodes):
    """The nodes that run on the machine of a link; see `remote.nodes.Nodes`."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._known: dict[str, Remote] = {}

    def running(self, rig: str = "") -> dict[str, Live]:
        """Return those whose loop runs, of all rigs or one, by name. LiveError: no valid answer."""
        version, handles = self._link.answer(
            lambda told: (told.get("version"), msgspec.convert(told.get("nodes"), list[str])),
            "nodes",
        )
        if version != fields.VERSION:
            raise self._link.error("another version of pcpc runs there; use the same one")
        for handle in handles:
            if handle not in self._known:
                about = self._link.answer(answers.description_in, "describe", node=handle)
                self._known[handle] = Remote(self._link, handle, about)
        found = {handle: self._known[handle] for handle in handles}
        return {one.name: one for one in found.values() if one.is_of(rig)}

    def find(self, node: str = "executive", rig: str = "") -> Live:
        """See `executive.nodes.live.find`."""
        return here.find(node, rig, self.running(rig))

    def find_for(self, words: Sequence[str]) -> Live:
        """See `executive.nodes.live.find_for`."""
        return here.find_for(words, self.running())
