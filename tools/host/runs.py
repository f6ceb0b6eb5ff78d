"""The nodes of this user that run, found again and again, each attached once."""

import threading
import time

from pcpc.executive.nodes import live as nodes

AGAIN_S = 0.3  # what was found holds as long


class Runs:
    """Those of one rig, of one run (a node's full name but for its role), or of all."""

    def __init__(self, rig: str = "", run: str = "") -> None:
        self._rig, self._run = rig, run
        self._nodes: dict[str, nodes.Live] = {}
        self._next_s = 0.0
        self._turn = threading.Lock()

    def nodes(self) -> dict[str, nodes.Live]:
        """Return the nodes that run, by name; from any thread."""
        with self._turn:
            if time.monotonic() >= self._next_s:
                found = nodes.running(self._rig)
                if self._run:
                    found = {name: one for name, one in found.items() if run_of(name) == self._run}
                known = {(name, one.pid): one for name, one in self._nodes.items()}
                self._nodes = {name: known.get((name, one.pid), one) for name, one in found.items()}
                self._next_s = time.monotonic() + AGAIN_S
            return {name: one for name, one in self._nodes.items() if one.running}


def run_of(name: str) -> str:
    """Return the run of a node, by its full name."""
    return name.rpartition(".")[0]
