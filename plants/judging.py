"""What the evaluations of all plants share: the records of the nodes side by side, windows, pages.

A window holds the cycles k with from <= k T < to: a run as long as `to` ends with its last cycle.
To a cycle of one node belongs another node's record of the same instant: that of the same cycle
where no clock runs, else the newest one not stamped later; one older than 2 periods tells nothing.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray

from pcpc.executive.errors import did_you_mean
from pcpc.executive.log.long_logs import WITHOUT_CLOCK, LongLog
from pcpc.executive.log.reader import NODES, Log
from pcpc.plants.statistics import RMS, Statistic, over_finite, peak, rms

__all__ = ["over_finite", "peak", "rms"]  # and what is defined here

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]
Made = TypeVar("Made")

OLDEST_PERIODS = 2.0  # a paced node's record is up to 1 period old, and later by its jitter
EDGE_PERIODS = 1e-6  # rounding of a window's edge


def paired_rows(
    log: Log, period_s: float, node: str = "plant", leader: str = "executive"
) -> NDArray[np.int64]:
    """Return the row of `node` that belongs to each cycle of `leader`; -1 for none."""
    lead, other = log.node[leader], log.node.get(node)
    if other is None or not len(other.cycle):
        return np.full(len(lead.cycle), -1, np.int64)
    if node == leader:
        return np.arange(len(lead.cycle))
    ours, theirs, oldest = lead.stamp_ns, other.stamp_ns, 1e9 * OLDEST_PERIODS * period_s
    if log.metadata.get("executive", {}).get("pacing") in WITHOUT_CLOCK:
        ours, theirs, oldest = lead.cycle, other.cycle, 0.0
    rows = np.searchsorted(theirs, ours, side="right").astype(np.int64) - 1
    return np.where((rows >= 0) & (ours - theirs[rows] <= oldest), rows, -1)


def between(cycle: NDArray[np.int64], period_s: float, begin_s: float, end_s: float) -> Mask:
    """Return which cycles are in the window [begin, end)."""
    first, past = edges(period_s, begin_s, end_s)
    return (cycle >= first) & (cycle < past)


def edges(period_s: float, begin_s: float, end_s: float) -> tuple[float, float]:
    """Return the first cycle in a window, and the first behind it."""
    first, past = np.ceil(np.array((begin_s, end_s)) / period_s - EDGE_PERIODS)
    return float(first), float(past)


class UnknownVariable(KeyError):
    """A variable that the node has not, in one line with a proposal."""

    def __str__(self) -> str:
        return str(self.args[0])


@dataclass(frozen=True)
class Run:
    """A run, or a stretch of it, by cycle of the executive or of another `leader`.

    Its columns are (n,), NaN where the log does not tell. `first_row`: of the stretch in the run.
    """

    log: Log
    period_s: float
    leader: str = "executive"
    first_row: int = 0
    whole: Log | None = None  # of which this is a stretch

    @cached_property
    def cycle(self) -> NDArray[np.int64]:
        """The cycles."""
        return self.log.node[self.leader].cycle

    @cached_property
    def t_s(self) -> Vector:
        """Time of the cycles."""
        return np.asarray(self.cycle * self.period_s, np.float64)

    @cached_property
    def plant_told(self) -> Mask:
        """Which cycles have the plant's record."""
        return self._rows("plant") >= 0

    @cached_property
    def plant_tells(self) -> bool:
        """Whether any cycle of the whole run has the plant's record."""
        if self.whole is not None:
            node = self.whole.node.get("plant")
            return node is not None and len(node.cycle) > 0
        return bool(self.plant_told.any())

    def once(self, make: "Callable[[Run], Made]") -> "Made":
        """Return what `make` makes of this run, made once."""
        made: dict[Any, Any] = self.__dict__.setdefault("_made", {})
        if make not in made:
            made[make] = make(self)
        found: Made = made[make]
        return found

    def executive(self, name: str, *, or_nan: bool = False) -> Vector:
        """Return a variable of the executive; UnknownVariable, or NaN, if it has none."""
        return self.of("executive", name, or_nan=or_nan)

    def plant(self, name: str, *, or_nan: bool = False) -> Vector:
        """Return a variable of the plant; UnknownVariable, or NaN, if its record has none."""
        return self.of("plant", name, or_nan=or_nan)

    def named(self, name: str) -> Vector:
        """Return `executive:NAME`, `local:NAME` or `plant:NAME`; NaN if the log has none."""
        node, _, variable = name.partition(":")
        if node not in NODES:
            raise UnknownVariable(f"{name}: no node {node}{did_you_mean(node, NODES)}")
        return self.of(node, variable, or_nan=True)

    def of(self, node: str, name: str, *, or_nan: bool = False) -> Vector:
        """Return a variable of a node at the cycles of the leader; NaN without its record.

        UnknownVariable, or NaN, if the record does not have it.
        """
        rows, record = self._rows(node), self.log.node.get(node)
        if record is None or not len(record.cycle) or not len(record.columns):
            return np.full(len(rows), math.nan)
        found = record.columns.get(name)
        if found is None and not or_nan:
            what = f"{node}: no variable {name}{did_you_mean(name, record.columns)}"
            raise UnknownVariable(what)
        if found is None:
            return np.full(len(rows), math.nan)
        return found if node == self.leader else np.where(rows < 0, math.nan, found[rows])

    def _rows(self, node: str) -> NDArray[np.int64]:
        made: dict[str, NDArray[np.int64]] = self.__dict__.setdefault("_paired", {})
        if node not in made:
            made[node] = paired_rows(self.log, self.period_s, node, self.leader)
        return made[node]

    def before(self, values: Vector) -> Vector:
        """Return the values of the cycle before each; NaN where the log has no such cycle."""
        moved = np.append(math.nan, values[:-1])
        return np.where(np.diff(self.cycle, prepend=-2) == 1, moved, math.nan)

    def after(self, values: Vector) -> Vector:
        """Return the values of the cycle after each; NaN where the log has no such cycle."""
        moved = np.append(values[1:], math.nan)
        return np.where(np.diff(self.cycle, append=-1) == 1, moved, math.nan)

    def step(self, values: Vector) -> Vector:
        """Return the change since the cycle before."""
        return values - self.before(values)

    def between(self, begin_s: float, end_s: float) -> Mask:
        """Return which cycles are in the window [begin, end)."""
        return between(self.cycle, self.period_s, begin_s, end_s)

    def setting(self, name: str) -> float:
        """Return a setting of the controller, else of the plant; NaN if unknown."""
        return setting(self.log, name)


def setting(log: Log, name: str) -> float:
    """Return a setting of the controller, else of the plant, from the log's rig; NaN if unknown."""
    rig = _rig(log)
    laws = [rig.get("controllers", {}).get(rig.get("controller"), {})]
    laws += rig.get("plant", {}).get("blocks", {}).values()
    values = (law["parameters"][name] for law in laws if name in law.get("parameters", {}))
    return float(next(values, math.nan))


def _rig(log: Log) -> dict[str, Any]:
    """Return the effective rig; {} if the log has none."""
    texts = [text for file, text in log.attachments.items() if file.endswith("rig-resolved.yaml")]
    return _parsed(texts[0]) if texts else {}


@lru_cache(maxsize=4)  # every metric asks
def _parsed(rig: str) -> Any:
    return yaml.load(rig, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))


# Figures of merit

Signal = Callable[[Run], Vector]


@dataclass(frozen=True)
class Measure:
    """A figure of a run: `scale` times a statistic of a signal, over a window or the whole run.

    The signal is a function of a run, or of a stretch of it with a cycle more at both ends: what it
    says of a cycle may depend on the neighbours.
    """

    signal: Signal
    statistic: Statistic = RMS
    window_s: tuple[float, float] | None = None
    scale: float = 1.0


def measured(
    log: Log, period_s: float, measures: Mapping[str, Measure], leader: str = "executive"
) -> dict[str, float]:
    """Return the figures of a run of any length by name; NaN where the log does not tell.

    The signals are those of the cycles of `leader`. A short run is looked at as a whole, a long one
    stretch by stretch.
    """
    if not isinstance(log, LongLog):
        run = Run(log, period_s, leader)
        return {
            name: one.scale * one.statistic.whole(_own(run, one, slice(None)))
            for name, one in measures.items()
        }
    left: dict[str, list[Any]] = {name: [] for name in measures}
    for run, own in stretches(log, period_s, leader):
        for name, one in measures.items():
            values = _own(run, one, own)
            if one.statistic.only_finite:
                values = values[np.isfinite(values)]
            if len(values):
                with np.errstate(over="ignore"):  # of a run that diverged
                    left[name].append(one.statistic.part(values))
    return {name: one.scale * one.statistic.of(left[name]) for name, one in measures.items()}


def reaches(log: Log, period_s: float, window_s: tuple[float, float], leader: str) -> bool:
    """Return whether the log has a cycle of `leader` in the window."""
    if leader not in log.node:
        return False
    cycle = log.node[leader].cycle
    first, past = edges(period_s, *window_s)
    row = bisect_left(cycle, first)
    return row < len(cycle) and bool(cycle[row] < past)


def _own(run: Run, one: Measure, own: slice) -> Vector:
    """Return the signal of a measure in a run's own cycles, and of those in the window."""
    values = one.signal(run)[own]
    return values if one.window_s is None else values[run.between(*one.window_s)[own]]


def stretches(log: LongLog, period_s: float, leader: str) -> Iterator[tuple[Run, slice]]:
    """Yield stretches of a long run with the slice of their own cycles."""
    row = 0
    for part, begin, end in log.parts(leader):
        yield Run(part, period_s, leader, row - begin, log), slice(begin, end)
        row += end - begin


def known(figures: Mapping[str, float]) -> dict[str, float]:
    """Return the figures without those that are NaN."""
    return {name: value for name, value in figures.items() if not math.isnan(value)}
