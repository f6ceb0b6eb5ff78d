"""A node's memory handed out by a thread of the test, as the main thread of a node does it."""

import select
import threading
from collections.abc import Mapping
from typing import Any

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing

_SLICE_S = 0.01
_standing: dict[str, "Standing"] = {}


class Standing:
    """A node without a loop; `end` is what its clients see of the end of a process."""

    def __init__(self, name: str, description: Mapping[str, Any]) -> None:
        self.served = sharing.Served(name, description)
        self.block: sh.Shared = self.served.block
        self.served.open()
        self._over = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while not self._over:
            select.select(self.served.sockets(), [], [], _SLICE_S)
            self.served.serve()

    def end(self) -> None:
        """Let name and clients go."""
        self._over = True
        self._thread.join()
        self.served.close()


def stand(name: str, description: Mapping[str, Any]) -> sh.Shared:
    """Hand out a new memory under `name`, instead of one that stands there."""
    end(name)
    _standing[name] = Standing(name, description)
    return _standing[name].block


def end(name: str) -> None:
    """End what stands under `name`."""
    if name in _standing:
        _standing.pop(name).end()


def end_all() -> None:
    """End all that stands."""
    for name in list(_standing):
        end(name)
