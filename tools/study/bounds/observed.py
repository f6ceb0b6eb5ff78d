"""A run with what no log keeps: parameters and weights, of a rig in virtual time or of a log.

A log is recomputed by the replay's cycle, in which the same states come about bit by bit; that they
did is checked on everything that the log does hold.
"""

import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.log import reader as logs
from pcpc.executive.log.frontier import Frontier
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.nodes.replay import Replay
from pcpc.executive.nodes.rings import kept_cycles
from pcpc.executive.nodes.slices import HEAD, Assembler, K
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.inheritance import inherit_entries
from pcpc.executive.rig.options import rename_earlier_keys
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.executive.rig.yamlfile import Keys
from pcpc.tools.after.opened import Opened
from pcpc.tools.after.trust import Trust

Wider = Callable[[Plan], None]


class BoundsError(UserError):
    """Why a run cannot be held against a theorem."""


def recording(states: Sequence[str]) -> Wider:
    """Return what has a node record its parameters, and the states that match a pattern."""

    def widen(made: Plan) -> None:
        variables = made.table.variables
        for i, one in enumerate(variables):
            wanted = one.kind == "parameter" or any(fnmatchcase(one.name, p) for p in states)
            if wanted and not one.recorded:
                variables[i] = replace(one, recorded=True)

    return widen


def of_rig(rig: Rig, states: Sequence[str]) -> logs.Log:
    """Run a rig in virtual time and return its records; RigError, StepError."""
    run = VirtualRun(rig, None, check=recording(states))
    for _ in run.advance():
        pass
    run.close()
    return run.memory.log()


def given_rates(log: logs.Log, keys: Keys, names: Sequence[str]) -> dict[str, float]:
    """Return what the files of a log's rig give for parameters of the law's entry at `keys`.

    The log carries these files as they were, in the order in which they build on each other; of a
    parameter that they do not give there is nothing. RigError for files that are none of a rig.
    """
    texts = [
        text
        for name, text in log.attachments.items()
        if name.endswith(".yaml") and not name.endswith("rig-resolved.yaml")
    ]
    with tempfile.TemporaryDirectory(prefix="pcpc-bounds-") as folder:
        for i, text in enumerate(texts):
            linked = re.sub(r"(?m)^base:.*$", f"base: {i + 1}.yaml", text)
            Path(folder, f"{i}.yaml").write_text(linked, encoding="utf-8")
        document = yamlfile.load(Path(folder, "0.yaml"))
        rename_earlier_keys(document)
        inherit_entries(document)
    found: Any = document.data
    for key in (*keys, "parameters"):
        found = found.get(key, {}) if isinstance(found, dict) else {}
    return {name: float(found[name]) for name in names if type(found.get(name)) in (int, float)}


class _Node:
    """One node of a log, recomputed piece by piece."""

    def __init__(self, head: logs.Log, rig: Rig, role: Role, states: Sequence[str]) -> None:
        about = head.node[role].description
        if not {"state_columns", "timing_columns"} <= about.keys():
            raise logs.LogError(f"{head.path}: the description of the {role} is damaged")
        self.role, self.path = role, head.path
        self.recorded = Assembler([*about["state_columns"], *about["timing_columns"]])
        pacing = head.metadata[role].get("pacing", "lockstep")
        names = self.recorded.names
        self.replay = Replay(rig, role, pacing, names, about.get("external", []), recording(states))
        self.recorded.most = kept_cycles(self.replay.block)
        self._both = [
            (HEAD + i, self.replay.names.index(name))
            for i, name in enumerate(names)
            if name in self.replay.names
        ]
        self._heads: list[NDArray[np.int64]] = []
        self.values: list[NDArray[np.int64]] = []

    def take(self, piece: logs.Log, whole: int, last: bool) -> None:
        """Recompute what `piece` of the log completes, up to cycle `whole`; BoundsError."""
        if self.role in piece.node:
            self.recorded.add(piece.node[self.role])
        for part in self.recorded.take(whole, last):
            found = self.replay.advance(part, self.recorded.names)
            done = len(found.values)
            theirs, ours = (list(column) for column in zip(*self._both, strict=True))
            if not np.array_equal(part.rows[:done, theirs], found.values[:, ours]):
                what = f"the {self.role} is not recomputed bit by bit"
                raise BoundsError(f"{self.path}: {what}; `pcpc replay` shows where", Exit.NOT_MET)
            self._heads.append(part.rows[:done, :HEAD])
            self.values.append(found.values)

    def node(self, head: logs.NodeLog) -> logs.NodeLog:
        """Return the node with all that was recomputed."""
        heads = np.concatenate(self._heads)
        values = np.concatenate(self.values).view(np.float64)
        columns = dict(zip(self.replay.names, values.T, strict=True))
        return replace(
            head, cycle=heads[:, K], stamp_ns=heads[:, HEAD - 1], columns=columns, timing={}
        )


def of_log(
    path: Path, states: Callable[[Rig], Sequence[str]], trust: Trust
) -> tuple[Rig, logs.Log]:
    """Return a log's rig, and the log recomputed; `states` tells which, of the rig.

    LogError, RigError, BoundsError.
    """
    run = Opened(path, trust)
    head = run.head
    with run.rig() as rig:
        wanted = states(rig)
        nodes = [_Node(head, rig, role, wanted) for role in rig.roles if role in head.node]
    frontier, missing = Frontier(), list[str]()
    for piece, last in logs.pieces(path, see=frontier.see):
        missing += piece.missing
        for node in nodes:
            node.take(piece, frontier.whole[node.role], last)
    if not all(node.values for node in nodes):
        what = "".join(f"; {line}" for line in missing[:1])
        code = Exit.LOSS if missing else Exit.WRONG_INPUT
        raise BoundsError(f"{path}: holds no cycle that can be recomputed{what}", code)
    made: dict[str, logs.NodeLog] = {node.role: node.node(head.node[node.role]) for node in nodes}
    return rig, replace(head, node=made, missing=missing)
