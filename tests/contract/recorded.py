"""A recorded run, and in what another record of it differs."""

import json
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import Rig, load_rig


class Refused(Exception):
    """Why a rig cannot go this way."""


class Given(NamedTuple):
    """What a rig is loaded from."""

    path: Path
    controller: str | None = None
    settings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Recorded:
    """A run in virtual time and its log."""

    given: Given
    path: Path

    @cached_property
    def rig(self) -> Rig:
        """The rig, loaded once."""
        return load_rig(*self.given)

    @cached_property
    def log(self) -> logs.Log:
        """The records, with their frames."""
        return logs.read(self.path)

    @property
    def cycles(self) -> int:
        """How many cycles the executive did."""
        return len(self.log.node["executive"].cycle)


def record(given: Given, path: Path) -> Recorded:
    """Return the run of a rig, recorded at a path."""
    run = Recorded(given, path)
    simulate(run.rig, path)
    return run


def differences(one: logs.Log, other: logs.Log) -> list[str]:
    """Return in what two records differ: nodes, cycles, states' bits, frames, events, tunings."""
    if list(one.node) != list(other.node):
        return [f"nodes {list(one.node)}, {list(other.node)}"]
    found = []
    for role, mine in one.node.items():
        theirs = other.node[role]
        found += [f"{role}: {what}" for what in _columns_differing(mine, theirs)]
        for what, rows in (("frames", _frames), ("events", _events), ("tunings", _tunings)):
            more, less = rows(mine) - rows(theirs), rows(theirs) - rows(mine)
            if more or less:
                found.append(f"{role}: {what} {list(more)[:2]}, {list(less)[:2]}")
    return found


def loaded_words(given: Given) -> list[str]:
    """Return a command's words for what a rig is loaded from."""
    chosen = ["--controller", given.controller] if given.controller else []
    return [str(given.path), *chosen, *(word for one in given.settings for word in ("--set", one))]


def columns_differing(
    one: logs.Log, other: logs.Log, but: Collection[str] = (), whole: bool = True
) -> list[str]:
    """Return in what states of two runs differ; in all cycles, or in those that both have."""
    found = []
    for role, mine in one.node.items():
        theirs = other.node[role]
        rows = min(len(mine.cycle), len(theirs.cycle))
        if not rows or (whole and len(mine.cycle) != len(theirs.cycle)):
            found.append(f"{role}: {len(mine.cycle)} cycles, {len(theirs.cycle)}")
        found += [
            f"{role}: {name}"
            for name, values in mine.columns.items()
            if name not in but and values[:rows].tobytes() != theirs.columns[name][:rows].tobytes()
        ]
    return found


def _columns_differing(mine: logs.NodeLog, theirs: logs.NodeLog) -> list[str]:
    if not np.array_equal(mine.cycle, theirs.cycle):
        return [f"{len(mine.cycle)} cycles, {len(theirs.cycle)}"]
    if list(mine.columns) != list(theirs.columns):
        return [f"columns {set(mine.columns) ^ set(theirs.columns)}"]
    return [
        name
        for name, values in mine.columns.items()
        if values.tobytes() != theirs.columns[name].tobytes()
    ]


def _frames(node: logs.NodeLog) -> Counter[Any]:
    names = ("cycle", "id", "dlc", "direction", "e2e")
    return Counter((*(int(f[n]) for n in names), f["data"].tobytes()) for f in node.frames)


def _events(node: logs.NodeLog) -> Counter[Any]:
    return Counter(json.dumps({k: e[k] for k in e if k != "t_ns"}) for e in node.events)


def _tunings(node: logs.NodeLog) -> Counter[Any]:
    return Counter((t["cycle"], t["name"], float(t["value"]).hex()) for t in node.tunings)
