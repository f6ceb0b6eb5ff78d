"""The variables of a log as series over time, by name, with unit; those of all its nodes together.

executive   controller.e_rad            names as they are
plant       plant.barrel.theta_rad      with `plant.` before
time        wall time, ns, k T from the start in lockstep and virtual time; t = 0 s is the first
            record of the executive (of the plant without)
"""

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.errors import did_you_mean
from pcpc.executive.log import reader as logs
from pcpc.executive.log.names import why_unrecorded
from pcpc.tools.after.log.commands import Window
from pcpc.tools.after.opened import Opened
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress

EVER_S = (-math.inf, math.inf)
LARGE_BYTES = 50_000_000  # takes about 2 s to read
_PREFIXES = tuple(f"{role}." for role in logs.NODES if role != "executive")


@dataclass(frozen=True)
class Series:
    """One variable; `topic` is where it is recorded. `time_ns`, `cycle`, `values` are (n,)."""

    name: str
    unit: str
    help: str
    topic: str
    time_ns: NDArray[np.int64]
    cycle: NDArray[np.int64]
    values: NDArray[np.float64]


def read_log(path: Path, progress: Progress) -> logs.Log:
    """Read a log and tell what is missing in it; LogCommandError if it is none."""
    try:
        if path.stat().st_size > LARGE_BYTES:
            progress.show(f"reading {path}")
        log = Opened(path).log
    except (logs.LogError, OSError) as error:
        reason = f"{path}: {error.strerror}" if isinstance(error, OSError) else str(error)
        raise LogCommandError(f"{reason}; give a log that pcpc wrote") from None
    for line in log.missing:
        progress.say(f"{path}: {line}")
    return log


def wall_offset_ns(log: logs.Log, node: str) -> int:
    """Return wall time minus stamp of a node; a clock that the log does not tell counts as 0."""
    facts = log.metadata[node]
    return int(facts.get("clock_wall_ns", 0)) - int(facts.get("clock_monotonic_ns", 0))


def start_ns(log: logs.Log) -> int:
    """Return the wall time of t = 0; that of the first frame in a log without records."""
    for name, node in log.node.items():
        stamps = node.stamp_ns if len(node.stamp_ns) else node.frames["stamp_ns"]
        if len(stamps):
            return int(stamps[0]) + wall_offset_ns(log, name)
    return 0


def all_series(log: logs.Log, only: Collection[str] | None = None) -> dict[str, Series]:
    """Return all variables by name, in the order of recording; `only`: these, the others unread."""
    by_name: dict[str, Series] = {}
    for name, node in log.node.items():
        described = {row[0]: row for row in node.description.get("variables", [])}
        time_ns = node.stamp_ns + wall_offset_ns(log, name)
        prefix = "" if name == "executive" else f"{name}."
        for kind, columns in (("state", node.columns), ("timing", node.timing)):
            topic = logs.topic(name, kind)
            for column in columns:
                if only is not None and prefix + column not in only:
                    continue
                unit, text = (described[column][i] if column in described else "" for i in (1, 4))
                values = columns[column]
                one = Series(prefix + column, unit, text, topic, time_ns, node.cycle, values)
                by_name[one.name] = one
    return by_name


def choose(
    known: Iterable[str], patterns: Iterable[str], where: str, of: Iterable[logs.Log]
) -> list[str]:
    """Return the names that match, in the order of the patterns.

    A name of another node than the executive is also found as `plant:NAME`, and without its prefix
    (`plant.`, `local.`) where nothing else matches. Raises LogCommandError for a pattern that
    matches none; `of`: the logs that `known` are from.
    """
    names, sources = list(known), list(of)
    chosen: dict[str, None] = {}
    for word in patterns:
        pattern = word.replace(":", ".", 1).removeprefix("executive.")
        matching = [name for name in names if fnmatchcase(name, pattern)]
        further = [prefix + pattern for prefix in _PREFIXES]
        matching = matching or [n for n in names if any(fnmatchcase(n, other) for other in further)]
        if not matching:
            if why := next(filter(None, (why_unrecorded(log, word) for log in sources)), ""):
                raise LogCommandError(f"{where}: {word}: {why}")
            bare = [_bare(name) for name in names]
            raise LogCommandError(f"{where}: no variable {word}{did_you_mean(pattern, bare)}")
        chosen |= dict.fromkeys(matching)
    return list(chosen)


def _bare(name: str) -> str:
    """Return a name without the prefix of its node."""
    return next((name.removeprefix(p) for p in _PREFIXES if name.startswith(p)), name)


def window_s(window: Window) -> tuple[float, float]:
    """Return the times of --start and --end, those of EVER_S where they are not given."""
    begin_s, end_s = EVER_S
    return (
        begin_s if window.start_s is None else window.start_s,
        end_s if window.end_s is None else window.end_s,
    )


def label(unit: str) -> str:
    """Return a unit as it stands behind a name."""
    return f"[{unit or '1'}]"


def rows_of(base: Series, other: Series, by_cycle: bool) -> NDArray[np.int64]:
    """Return the row of `other` that belongs to each row of `base`, -1 for none.

    It is the one of the same cycle, or the newest one not stamped later. Shape (n,).
    """
    if other.topic == base.topic:
        return np.arange(len(base.cycle))
    base_keys, other_keys = (base.cycle, other.cycle) if by_cycle else (base.time_ns, other.time_ns)
    if not len(other_keys):
        return np.full(len(base_keys), -1, np.int64)
    rows = np.searchsorted(other_keys, base_keys, side="right").astype(np.int64) - 1
    if by_cycle:
        rows[(rows >= 0) & (other_keys[rows] != base_keys)] = -1
    return rows


def without_clock(log: logs.Log) -> bool:
    """Return whether equal cycle numbers of both nodes mean the same instant."""
    return log.metadata[next(iter(log.node))].get("pacing") in ("lockstep", "virtual")
