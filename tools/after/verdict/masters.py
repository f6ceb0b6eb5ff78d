"""What the master of a drive did wrong, as the drive counted it, a line for each kind."""

from collections.abc import Iterable, Mapping

from pcpc.executive.log.reader import NodeLog

PREFIX, HELP = "drive.master.", "how often a "


def counters(names: Iterable[str]) -> list[str]:
    """Return the variables among these that count mistakes."""
    return [name for name in names if name.startswith(PREFIX)]


def counter_lines(values: Mapping[str, float], helps: Mapping[str, str]) -> list[str]:
    """Return what was counted, of the last values of variables and what they are."""
    return [
        f"master: {helps[name].removeprefix(HELP)}: {values[name]:.0f} x ({name})"
        for name in counters(values)
        if values[name] > 0.0
    ]


def mistakes(node: NodeLog) -> list[str]:
    """Return what a node's log tells."""
    names = counters(node.columns)
    last = {name: float(node.columns[name][-1]) for name in names if len(node.columns[name])}
    helps = {row[0]: row[4] for row in node.description.get("variables", ())}
    return counter_lines(last, dict.fromkeys(names, "mistake") | helps)
