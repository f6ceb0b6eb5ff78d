"""A part of a run, by its cycles: from the newest keyframe before it, not from the log's start.

    pcpc replay LOG --from 2 --to 3                  recomputed and compared there only
    pcpc replay LOG --from 2 --to 3 --show NAME      the same, and the values as CSV

Any variable can be shown, also one that was not recorded. Values are those at the end of a cycle.
"""

import math
import sys
from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.log import reader as logs
from pcpc.executive.log.frontier import ALL
from pcpc.executive.nodes.replay import Replay


def cycle_of(head: logs.Log, cycle: int | None, time_s: float | None) -> int:
    """Return the cycle that `--cycle` or `--time` gives; UserError for one that is none."""
    if cycle is None and time_s is not None:
        cycle = _cycle_at(head, "--time", time_s)
    elif cycle is None or time_s is not None:
        raise UserError("which cycle? give --cycle N or --time S")
    if not 0 <= cycle < 2**53:
        raise UserError(f"--cycle {cycle}: expected 0 or more")
    return cycle


def cycles_of(head: logs.Log, since_s: float | None, until_s: float | None) -> tuple[int, int]:
    """Return the first and last cycle that `--from` and `--to` give; UserError for none."""
    first = 0 if since_s is None else _cycle_at(head, "--from", since_s)
    last = ALL if until_s is None else _cycle_at(head, "--to", until_s)
    if last < first:
        raise UserError(f"--to {until_s:g} is before --from {since_s:g}")
    return first, last


def _cycle_at(head: logs.Log, option: str, time_s: float) -> int:
    lead = next(iter(head.node.values())).description
    if not 0.0 <= time_s < math.inf:
        raise UserError(f"{option} {time_s:g}: expected 0 s or more")
    if "period_ns" not in lead:
        raise logs.LogError(f"{head.path}: its description is damaged")
    return min(round(time_s / (1e-9 * float(lead["period_ns"]))), 2**53)


def variables_of(replay: Replay) -> list[Any]:
    """Return the variables of a node but those that clocks measure."""
    measured = {*replay.block.description["timing_columns"]}
    return [one for one in replay.plan.table.variables if one.name not in measured]


def chosen_variables(known: dict[str, str], words: Sequence[str]) -> set[str]:
    """Return which of the variables, name -> kind, names and patterns choose; UserError.

    Without any: all but parameters.
    """
    if not words:
        return {name for name, kind in known.items() if kind != "parameter"}
    chosen: set[str] = set()
    for word in words:
        matched = {name for name in known if fnmatchcase(name, word)}
        if not matched:
            raise UserError(f"--show {word}: no such variable{did_you_mean(word, known)}")
        chosen |= matched
    return chosen


class ValuePrinter:
    """Prints the chosen variables of a node, a row of CSV a cycle, as it is recomputed."""

    def __init__(self, words: Sequence[str], first: int) -> None:
        self._words, self._first = words, first
        self._place: list[int] = []

    def begin(self, nodes: Sequence[Any]) -> None:
        """Find which of the nodes has the variables, print the heads; UserError."""
        known = {n.role: {v.name: v.kind for v in variables_of(n.replay)} for n in nodes}
        names = chosen_variables(
            {k: v for one in known.values() for k, v in one.items()}, self._words
        )
        having = [node for node in nodes if names & known[node.role].keys()]
        if len(having) > 1:
            roles = " and ".join(node.role for node in having)
            raise UserError(f"--show: {roles} have such variables; choose one with --node")
        self._node = having[0]
        replay = self._node.replay
        self._node.recorded.alone = self._first
        self._loop, self._period_s = replay.block.loop, 1e-9 * replay.block.description["period_ns"]
        kept = [one for one in variables_of(replay) if one.name in names]
        self._place = [replay.plan.table.index[one.name] for one in kept]
        heads = [f"{one.name} [{one.unit}]" if one.unit else one.name for one in kept]
        print(",".join(["t_s", "cycle", *heads]))
        self._past = self._first

    def look(self) -> None:
        """Print the cycle that the node has just done, if it is one of those asked for."""
        k = int(self._loop.k) - 1 if self._place else -1
        if k >= self._past:
            self._past = k + 1
            values = np.asarray(self._loop.v)[self._place].tolist()
            sys.stdout.write(
                ",".join([f"{k * self._period_s:.9g}", str(k), *map(repr, values)]) + "\n"
            )
