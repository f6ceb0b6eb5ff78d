"""The nodes of this user that run, found again and again, each attached once."""

import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from pcpc.drivers.machine.bystander import keep_off
from pcpc.executive.nodes import live as nodes

AGAIN_S = 0.3  # what was found holds as long


class LiveRuns:
    """Those of one rig, of one run (a node's full name but for its role), or of all.

    This program keeps off the processors of their loops.
    """

    def __init__(self, rig: str = "", run: str = "") -> None:
        self._rig, self._run = rig, run
        self._nodes: dict[str, nodes.Live] = {}
        self._next_s = 0.0
        self._turn = threading.Lock()

    def nodes(self) -> dict[str, nodes.Live]:
        """Return the nodes that run, by name; from any thread."""
        with self._turn:
            if time.monotonic() >= self._next_s:
                lives = nodes.running(self._rig)
                if self._run:
                    lives = {name: one for name, one in lives.items() if run_of(name) == self._run}
                known = {(name, one.pid): one for name, one in self._nodes.items()}
                self._nodes = {name: known.get((name, one.pid), one) for name, one in lives.items()}
                keep_off(one.pid for one in self._nodes.values())
                self._next_s = time.monotonic() + AGAIN_S
            return {name: one for name, one in self._nodes.items() if one.running}


def run_list(lives: Mapping[str, nodes.Live]) -> list[dict[str, Any]]:
    """Return the runs that nodes belong to: name, rig, when it began (s of Unix), states."""
    runs: dict[str, dict[str, Any]] = {}
    for name, live in sorted(lives.items()):
        run, description = run_of(name), live.block.description
        with suppress(KeyError, TypeError, ValueError, IndexError):  # it says nothing sensible
            state = str(description["state_names"][int(live.block.control.state)])
            since_s = 1e-9 * int(description["metadata"]["clock_wall_ns"])
            new = {"run": run, "rig": str(description["rig"]), "since_s": since_s, "nodes": {}}
            runs.setdefault(run, new)["nodes"][str(description["node"])] = state
    return [*runs.values()]


def run_of(name: str) -> str:
    """Return the run of a node, by its full name."""
    return name.rpartition(".")[0]
