"""What the evaluations of all plants share: the records of the nodes side by side, windows, pages.

A window holds the cycles k with from <= k T < to: a run as long as `to` ends with its last cycle.
The plant's record of the same instant belongs to an executive cycle: that of the same cycle where
no clock runs, else the newest one not stamped later; one older than 2 periods tells nothing.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray

from pcpc.executive.errors import did_you_mean
from pcpc.executive.log.long_logs import LongLog
from pcpc.executive.log.reader import Log
from pcpc.plants.statistics import RMS, Statistic, over_finite, peak, rms

__all__ = ["over_finite", "peak", "rms"]  # and what is defined here

if TYPE_CHECKING:
    pass

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]
Made = TypeVar("Made")

OLDEST_PERIODS = 2.0  # a paced plant's record is up to 1 period old, and later by its jitter
EDGE_PERIODS = 1e-6  # rounding of a window's edge


def plant_rows(log: Log, period_s: float) -> NDArray[np.int64]:
    """Return the row of the plant's record that belongs to each executive cycle; -1 for none."""
    executive, plant = log.node["executive"], log.node.get("plant")
    if plant is None or not len(plant.cycle):
        return np.full(len(executive.cycle), -1, np.int64)
    ours, theirs, oldest = executive.stamp_ns, plant.stamp_ns, 1e9 * OLDEST_PERIODS * period_s
    if log.metadata.get("executive", {}).get("pacing") in ("lockstep", "virtual"):
        ours, theirs, oldest = executive.cycle, plant.cycle, 0.0
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
    def rows(self) -> NDArray[np.int64]:
        """The plant's row of each cycle, see `plant_rows`."""
        return plant_rows(self.log, self.period_s)

    @cached_property
    def plant_tells(self) -> bool:
        """Whether any cycle of the whole run has the plant's record."""
        if self.whole is not None:
            node = self.whole.node.get("plant")
            return node is not None and len(node.cycle) > 0
        return bool((self.rows >= 0).any())

    def once(self, make: "Callable[[Run], Made]") -> "Made":
        """Return what `make` makes of this run, made once."""
        made: dict[Any, Any] = self.__dict__.setdefault("_made", {})
        if make not in made:
            made[make] = make(self)
        found: Made = made[make]
        return found

    def executive(self, name: str, *, or_nan: bool = False) -> Vector:
        """Return a variable of the executive; UnknownVariable, or NaN, if it has none."""
        return self._column("executive", name, or_nan)

    def plant(self, name: str, *, or_nan: bool = False) -> Vector:
        """Return a variable of the plant at the executive's cycles; NaN without its record.

        UnknownVariable, or NaN, if the plant's record does not have it.
        """
        node = self.log.node.get("plant")
        if node is None or not len(node.cycle):
            return np.full(len(self.cycle), math.nan)
        found = self._column("plant", name, or_nan)
        if self.leader == "plant":
            return found
        return np.where(self.rows < 0, math.nan, found[self.rows])

    def _column(self, role: str, name: str, or_nan: bool) -> Vector:
        node = self.log.node[role]
        found = node.columns.get(name)
        if found is not None:
            return found
        if or_nan or not len(node.columns):
            return np.full(len(node.cycle), math.nan)
        raise UnknownVariable(f"{role}: no variable {name}{did_you_mean(name, node.columns)}")

    def named(self, name: str) -> Vector:
        """Return `executive:NAME` or `plant:NAME`; NaN if there is none."""
        node, _, variable = name.partition(":")
        which = self.executive if node == "executive" else self.plant
        return which(variable, or_nan=True)

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


def step(values: Vector) -> Vector:
    """Return the change since the cycle before; NaN in the first."""
    return np.diff(values, prepend=math.nan)


def known(figures: Mapping[str, float]) -> dict[str, float]:
    """Return the figures without those that are NaN."""
    return {name: value for name, value in figures.items() if not math.isnan(value)}
