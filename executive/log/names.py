"""What a variable's name stands for in a log: `plant:tank.level_m` and `tank.level_m` are the same.

A name without a node is the executive's, where that has it.
"""

from collections.abc import Iterable, Sequence

from pcpc.executive.errors import did_you_mean
from pcpc.executive.log.reader import Log

LEADER = "executive"


def find_variable(log: Log, name: str) -> tuple[str, str] | None:
    """Return node and variable of what was recorded; None for what was not."""
    nodes, variable = _candidates(log, name)
    for node in nodes:
        if variable in log.node[node].columns or variable in log.node[node].timing:
            return node, variable
    return None


def why_unrecorded(log: Log, name: str) -> str:
    """Return what a node's variable is that is not recorded, and what to ask for instead.

    "" for one that no node has.
    """
    nodes, variable = _candidates(log, name)
    for node in nodes:
        about = log.node[node].description
        kind = next((row[2] for row in about.get("variables", ()) if row[0] == variable), "")
        source = about.get("sources", {}).get(variable)
        if kind == "input" and source:
            before = "" if node == LEADER else f"{node}:"
            return f"an input, not recorded; use its source {before}{source}"
        if kind == "parameter":
            return "a parameter, not recorded; events tell its changes"
        if kind:
            return "not recorded"
    return ""


def unknown_name(log: Log, name: str, others: Iterable[str] = ()) -> str:
    """Return what is wrong with a name that `place` does not find, with the cure.

    `others`: what may be meant besides.
    """
    if why := why_unrecorded(log, name):
        return f"{name}: {why}"
    node, colon, variable = name.partition(":")
    if colon and node in log.node:
        one = log.node[node]
        cure = did_you_mean(variable, [*one.columns, *one.timing])
        return f"{node}: no variable {variable}{cure}"
    known = [f"{node}:{key}" for node, one in log.node.items() for key in one.columns]
    known = [key.removeprefix(f"{LEADER}:") for key in known]
    return f"no signal {name}{did_you_mean(name, [*others, *known])}"


def _candidates(log: Log, name: str) -> tuple[Sequence[str], str]:
    """Return the nodes of the log that a name may mean, and the variable."""
    node, colon, variable = name.partition(":")
    if colon:
        return [node] if node in log.node else [], variable
    return sorted(log.node, key=lambda one: one != LEADER), name
