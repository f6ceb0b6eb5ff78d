"""A node's memory handed out by a thread of the test, as the main thread of a node does it."""

import select
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.loop.requests import Refusal

_SLICE_S = 0.01
_GRANT_S = 0.001  # a period
_standing: dict[str, "Standing"] = {}


class Standing:
    """A node without a loop; `end` is what its clients see of the end of a process."""

    def __init__(self, name: str, description: Mapping[str, Any]) -> None:
        self.served = sharing.ServedMemory(name, description)
        self.block: sh.NodeMemory = self.served.block
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


def stand(name: str, description: Mapping[str, Any]) -> sh.NodeMemory:
    """Hand out a new memory under `name`, instead of one that stands there."""
    end(name)
    _standing[name] = Standing(name, description)
    return _standing[name].block


def end(name: str) -> None:
    """End what stands under `name`."""
    if name in _standing:
        _standing.pop(name).end()


@contextmanager
def granting(*blocks: sh.NodeMemory) -> Iterator[list[tuple[str, dict[str, float]]]]:
    """Grant what is asked of these nodes, as their loops do; give node and values of each, in turn.

    What was asked stands in their variables from then on.
    """
    granted: list[tuple[str, dict[str, float]]] = []
    over = threading.Event()

    def loop() -> None:
        while not over.wait(_GRANT_S):
            for block in blocks:
                mail, answer = block.mail, block.answer
                if (request := int(mail.request)) != answer.request:
                    asked = slice(int(mail.count))
                    index, value = block["mail_index"][asked], block["mail_value"][asked]
                    names = [block.description["variables"][place][0] for place in index]
                    granted.append((block.name, dict(zip(names, value.tolist(), strict=True))))
                    block["snapshot"][index] = value
                    answer.refusal, answer.request = Refusal.ACCEPTED, request

    for block in blocks:
        block.control.passes = 1
    thread = threading.Thread(target=loop, daemon=True)
    thread.start()
    try:
        yield granted
    finally:
        over.set()
        thread.join()


def end_all() -> None:
    """End all that stands."""
    for name in list(_standing):
        end(name)
