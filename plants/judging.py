"""A run as an evaluation sees it: the records of its nodes side by side, windows, figures of merit.

A window holds the cycles k with from <= k T < to: a run as long as `to` ends with its last cycle.
To a cycle of one node belongs another node's record of the same instant: that of the same cycle
where no clock runs, else the newest one not stamped later; one older than 2 periods tells nothing.
"""

import math
import sys
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from pcpc.executive.errors import RigError
from pcpc.executive.log import names
from pcpc.executive.log.long_logs import WITHOUT_CLOCK, LongLog
from pcpc.executive.log.reader import NODES, Log
from pcpc.executive.own_laws.law_errors import located_message
from pcpc.plants.statistics import Statistic

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]
Signal = Callable[["Run"], Vector]
Source = str | Signal  # a recorded variable `NODE:NAME`, a signal's name, a function
Place = tuple[str, int]  # file and line
Windows = Mapping[str, tuple[float, float]]

OLDEST_PERIODS = 2.0  # a paced node's record is up to 1 period old, and later by its jitter
EDGE_PERIODS = 1e-6  # rounding of a window's edge
WINDOW, RUN, LATE, EACH = "window", "run", "late", "each"  # what a figure of merit is taken over
_OWN = [str(Path(__file__).with_name(f"{name}.py")) for name in ("judging", "pages", "evaluation")]


def paired_rows(
    log: Log, period_s: float, node: str = "plant", leader: str = "executive"
) -> NDArray[np.int64]:
    """Return the row (n,) of `node` that belongs to each cycle of `leader`; -1 for none."""
    lead, other = log.node[leader], log.node.get(node)
    if other is None or not len(other.cycle):
        return np.full(len(lead.cycle), -1, np.int64)
    if node == leader:
        return np.arange(len(lead.cycle))
    lead_times, other_times, oldest = lead.stamp_ns, other.stamp_ns, 1e9 * OLDEST_PERIODS * period_s
    if log.metadata.get("executive", {}).get("pacing") in WITHOUT_CLOCK:
        lead_times, other_times, oldest = lead.cycle, other.cycle, 0.0
        if np.array_equal(lead_times, other_times[: len(lead_times)]):
            return np.arange(len(lead_times))
    rows = np.searchsorted(other_times, lead_times, side="right").astype(np.int64) - 1
    return np.where((rows >= 0) & (lead_times - other_times[rows] <= oldest), rows, -1)


def edges(period_s: float, begin_s: float, end_s: float) -> tuple[float, float]:
    """Return the first cycle in a window, and the first behind it."""
    first, past = np.ceil(np.array((begin_s, end_s)) / period_s - EDGE_PERIODS)
    return float(first), float(past)


class DeclarationError(RigError):
    """What is wrong in an evaluation, in one line; `place`: of the declaration that says it."""

    def __init__(self, what: str, place: Place | None = None) -> None:
        super().__init__(located_message(place, what) if place else what)
        self.placed = place is not None


def declared_at() -> Place:
    """Return file and line of the evaluation that is being declared."""
    frame = sys._getframe(1)
    while frame.f_back and frame.f_code.co_filename in (*_OWN, "<string>"):
        frame = frame.f_back
    return frame.f_code.co_filename, frame.f_lineno


@dataclass(frozen=True)
class Run:
    """A run, or a stretch of it, by the cycles of the executive or of another `leader`.

    `run["plant:arm.q_rad"]`, `run["error_rad"]`: columns (n,), NaN where the log has no value;
    Mistake for a variable that is not in the log. `first_row`: where a stretch begins in the run.
    """

    log: Log
    period_s: float
    leader: str = "executive"
    first_row: int = 0
    whole: Log | None = None  # of which this is a stretch
    signals: Mapping[str, Signal] = field(default_factory=dict)
    windows: Windows = field(default_factory=dict)
    numbers: Mapping[str, float] = field(default_factory=dict)
    suspects: set[str] = field(
        default_factory=set, compare=False
    )  # what was asked for and not finite
    _made: dict[str, Any] = field(default_factory=dict, init=False, compare=False)

    @cached_property
    def cycle(self) -> NDArray[np.int64]:
        """The cycle numbers, (n,)."""
        return self.log.node[self.leader].cycle

    @cached_property
    def t_s(self) -> Vector:
        """Time of the cycles, (n,), s."""
        return np.asarray(self.cycle * self.period_s, np.float64)

    @property
    def plant_told(self) -> Mask:
        """Which cycles have a record of the plant, (n,)."""
        return self.told("plant")

    def told(self, node: str) -> Mask:
        """Return which cycles have a record of a node, (n,)."""
        return self._rows(node) >= 0

    @cached_property
    def plant_tells(self) -> bool:
        """Whether any cycle of the whole run has a record of the plant."""
        if self.whole is not None:
            node = self.whole.node.get("plant")
            return node is not None and len(node.cycle) > 0
        return bool(self.plant_told.any())

    def __getitem__(self, name: str) -> Vector:
        """Return a signal of the evaluation, or a variable at the leader's cycles.

        `NODE:NAME`, or `NAME` alone: the executive's, else that of the node that has it.

        All NaN for a node without records; Mistake for a variable that its records do not have.
        """
        if name not in self._made:
            known = self.signals.get(name)
            self._made[name] = self._told(name) if known is None else known(self)
        found: Vector = self._made[name]
        return found

    def get(self, name: str) -> Vector:
        """Return `run[name]`, (n,); NaN also for a variable that the records do not have."""
        known = name in self.signals or self.has(name)
        return self[name] if known else np.full(len(self.cycle), math.nan)

    def has(self, name: str) -> bool:
        """Return whether the records have a variable, `NODE:NAME` or `NAME`."""
        return names.find_variable(self.whole or self.log, name) is not None

    def values(self, source: Source, place: Place | None = None) -> Vector:
        """Return the values of a source, (n,) or (n, m), a row a cycle.

        `place`: where the source is declared. Mistake: it does not return a number a cycle.
        """
        returned = self.get(source) if isinstance(source, str) else source(self)
        try:
            values = np.asarray(returned, np.float64)
        except (TypeError, ValueError):
            raise DeclarationError(
                f"expected numbers, got {type(returned).__name__}", place
            ) from None
        if values.shape[:1] != self.cycle.shape:
            what = f"expected a value a cycle, {len(self.cycle)}, got the shape {values.shape}"
            raise DeclarationError(what, place)
        return values

    def _told(self, name: str) -> Vector:
        log = self.whole or self.log
        node, variable = names.find_variable(log, name) or name.partition(":")[::2]
        if node not in NODES:
            if "plant" in log.node or "." not in name:
                raise DeclarationError(names.unknown_name(log, name, self.signals))
            return np.full(len(self.cycle), math.nan)
        rows, record = self._rows(node), self.log.node.get(node)
        if record is None or not len(record.cycle) or not len(record.columns):
            return np.full(len(rows), math.nan)
        if variable not in record.columns and variable not in record.timing:
            raise DeclarationError(names.unknown_name(log, name))
        column = (record.columns if variable in record.columns else record.timing)[variable]
        if variable in record.columns and not np.isfinite(column).all():
            self.suspects.add(name)
        if self._in_step(node):
            return np.where(False, math.nan, column[: len(rows)])  # of the same type as below
        return np.where(rows < 0, math.nan, column[rows])

    def _in_step(self, node: str) -> bool:
        """Return whether record i of a node belongs to cycle i, for each."""
        key = f"{node} in step"
        if key not in self._made:
            rows = self._rows(node)
            self._made[key] = bool(np.array_equal(rows, np.arange(len(rows))))
        found: bool = self._made[key]
        return found

    def _rows(self, node: str) -> NDArray[np.int64]:
        key = f"rows of {node}"
        if key not in self._made:
            self._made[key] = paired_rows(self.log, self.period_s, node, self.leader)
        found: NDArray[np.int64] = self._made[key]
        return found

    def before(self, values: Vector) -> Vector:
        """Return the value (n,) of the cycle before each; NaN where the log has no such cycle."""
        moved = np.append(math.nan, values[:-1])
        return np.where(np.diff(self.cycle, prepend=-2) == 1, moved, math.nan)

    def after(self, values: Vector) -> Vector:
        """Return the value (n,) of the cycle after each; NaN where the log has no such cycle."""
        moved = np.append(values[1:], math.nan)
        return np.where(np.diff(self.cycle, append=-1) == 1, moved, math.nan)

    def step(self, values: Vector) -> Vector:
        """Return the change (n,) since the cycle before."""
        return values - self.before(values)

    def between(self, begin_s: float, end_s: float) -> Mask:
        """Return which cycles are in the window [begin, end), (n,)."""
        first, past = edges(self.period_s, begin_s, end_s)
        return (self.cycle >= first) & (self.cycle < past)

    def window(self, name: str) -> Mask:
        """Return which cycles are in one of `windows`, (n,); do not change it."""
        key = f"window {name}"
        if key not in self._made:
            self._made[key] = self.between(*self.windows[name])
        found: Mask = self._made[key]
        return found

    def setting(self, name: str) -> float:
        """Return a setting of the controller, else of the plant; NaN if unknown."""
        rig = effective_rig(self.log)
        laws = [rig.get("controllers", {}).get(rig.get("controller"), {})]
        laws += rig.get("plant", {}).get("blocks", {}).values()
        values = (law["parameters"][name] for law in laws if name in law.get("parameters", {}))
        return float(next(values, math.nan))


def effective_rig(log: Log) -> dict[str, Any]:
    """Return the effective rig; {} if the log has none."""
    if log.rig is not None:
        return dict(log.rig)
    texts = [text for file, text in log.attachments.items() if file.endswith("rig-resolved.yaml")]
    return _parsed_rig(texts[0]) if texts else {}


@lru_cache(maxsize=4)  # every metric asks
def _parsed_rig(rig: str) -> Any:
    return yaml.load(rig, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))


# Figures of merit


@dataclass(frozen=True)
class Merit:
    """A figure of merit of a run: `scale` times a statistic of a source.

    over     WINDOW    the rig's window; EACH: also each further one, as NAME_...
             RUN       the whole run;    LATE: from the end of the rig's window on
             NAME      the rig's further window NAME_from_s to NAME_to_s; absent if it has none
    needs    a number or a further window of the rig; without it there is no such figure
    leader   the node whose cycles count
    """

    statistic: Statistic
    source: Source
    over: str = WINDOW
    scale: float = 1.0
    needs: str = ""
    leader: str = "executive"
    place: Place = field(default_factory=declared_at, compare=False)

    def of(self, run: Run, own: slice) -> Vector:
        """Return the source's values (m,) in a run's own cycles that lie in the window."""
        values = run.values(self.source, self.place)
        return values[own] if self.over == RUN else values[own][run.window(self.over)[own]]


@dataclass(frozen=True)
class Judged:
    """A run of any length with the windows and numbers of its rig."""

    log: Log
    period_s: float
    windows: Windows = field(default_factory=lambda: {RUN: (-math.inf, math.inf)})
    numbers: Mapping[str, float] = field(default_factory=dict)
    signals: Mapping[str, Signal] = field(default_factory=dict)
    suspects: set[str] = field(default_factory=set, init=False, compare=False)  # as of a `Run`
    _runs: dict[str, Run] = field(default_factory=dict, init=False, compare=False)

    def run(self, leader: str = "executive") -> Run:
        """Return the whole run; a short one computes its signals once."""
        if isinstance(self.log, LongLog):
            return self._run(self.log, leader)
        if leader not in self._runs:
            self._runs[leader] = self._run(self.log, leader)
        return self._runs[leader]

    def _run(self, log: Log, leader: str, row: int = 0, whole: Log | None = None) -> Run:
        about = self.signals, self.windows, self.numbers
        return Run(log, self.period_s, leader, row, whole, *about, self.suspects)

    def stretches(self, leader: str) -> Iterator[tuple[Run, slice]]:
        """Yield the run, a long one in stretches, each with the slice of its own cycles."""
        if not isinstance(self.log, LongLog):
            yield self.run(leader), slice(None)
            return
        row = 0
        for part, begin, end in self.log.parts(leader):
            yield self._run(part, leader, row - begin, self.log), slice(begin, end)
            row += end - begin

    def measured(self, merits: Mapping[str, Merit], leader: str = "executive") -> dict[str, float]:
        """Return the figures by name; NaN where the log has no values.

        A long run is evaluated stretch by stretch.
        """
        if not self._reaches(leader):
            return dict.fromkeys(merits, math.nan)
        parts: dict[str, list[Any]] = {name: [] for name in merits}
        long = isinstance(self.log, LongLog)
        for run, rows in self.stretches(leader):
            for name, merit in merits.items():
                values = merit.of(run, rows)
                if not long:
                    parts[name] = [merit.statistic.whole(values)]
                    continue
                if merit.statistic.only_finite:
                    values = values[np.isfinite(values)]
                if len(values):
                    with np.errstate(over="ignore"):  # of a run that diverged
                        parts[name].append(merit.statistic.part(values))
        return {
            name: one.scale * (one.statistic.of(parts[name]) if long else parts[name][0])
            for name, one in merits.items()
        }

    def non_finite(self, one: Merit) -> str:
        """Return the first recorded value of a figure's window that is not finite; "" for none.

        Figures ignore such values.
        """
        for run, rows in self.stretches(one.leader) if self.suspects else ():
            fresh = replace(run)  # it knows what this figure alone asks for
            fresh.values(one.source, one.place)
            for name in sorted(self.suspects.intersection(fresh._made)):
                node = (names.find_variable(self.log, name) or ("",))[0]
                wrong = ~np.isfinite(fresh[name]) & fresh.told(node)
                wrong &= True if one.over == RUN else fresh.window(one.over)
                if len(found := fresh.t_s[rows][wrong[rows]]):
                    return f"{name} is not a finite number at {found[0]:.4g} s"
        return ""

    def _reaches(self, leader: str) -> bool:
        """Return whether the log has a cycle of `leader` in the rig's window."""
        if leader not in self.log.node:
            return False
        cycle = self.log.node[leader].cycle
        first, past = edges(self.period_s, *self.windows.get(WINDOW, self.windows[RUN]))
        row = bisect_left(cycle, first)
        return row < len(cycle) and bool(cycle[row] < past)
