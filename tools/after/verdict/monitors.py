"""Requirements watched row by row: events, obligations, the first violation, the smallest margin.

A monitor is fed the recorded cycles in order, in stretches of any length, and keeps what is open:
numbers, or the rows since the first event that is not over. Robustness as of signal temporal logic:

    hold      min of the margin, from `within` after each event to the next one               (1)
    respond   max over k1 in [k0, k0 + within] of the min over [k1, k1 + for]                 (2)
    until     max over k1 in [k0, k0 + within] of min(until at k1, min of always before k1)   (3)

A requirement's margin is the smallest over its events. Only recorded cycles count. What the end of
the record leaves undecided is open.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.rig.expressions import ComparedValue, Condition, Rows, Vector
from pcpc.executive.rig.requirements import LIMIT, PAST, Event, Overshoot, TimedRequirement
from pcpc.plants.judging import EDGE_PERIODS, edges

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
NEVER = 1 << 62  # a cycle
_TIME = "time.t_s"
_LONGEST = 10**11  # cycles that are looked ahead, a few years at 1 kHz


def extremes(values: Vector, first: Indices, past: Indices, pick: Any) -> Vector:
    """Return `pick`, np.minimum or np.maximum, over values[first:past] for each pair.

    `values`: (n,); the others: (pairs,).
    """
    size = past - first
    chosen = values[first]
    level, width = values, 1
    while (size >= 2 * width).any():
        level, width = pick(level[:-width], level[width:]), 2 * width  # over `width` from each on
        own = size >= width
        chosen[own] = pick(level[first[own]], level[past[own] - width])
    return chosen


@dataclass
class Monitor:
    """What became of a requirement; `first`: cycle and values of the first violation."""

    timed: TimedRequirement
    period_s: float
    first: tuple[int, ComparedValue] | None = None
    margin: float = math.inf
    least: tuple[int, ComparedValue] | None = None  # cycle and values of the smallest margin
    events: int = 0
    judged: int = 0
    rows: int = 0
    last: int = -1
    _carry: Rows | None = None
    _step: float = math.nan  # of the reference of an overshoot, at the last event

    def __post_init__(self) -> None:
        first, past = edges(self.period_s, *self.timed.window_s)
        self.window = int(first), NEVER if past == math.inf else int(past)
        self.within = self._cycles(self.timed.within_s or 0.0)

    def _cycles(self, duration_s: float) -> int:
        """Return the cycles in a closed interval, less its first one."""
        return math.floor(duration_s / self.period_s + EDGE_PERIODS)

    @property
    def begin(self) -> int:
        """The cycle with which its time begins; NEVER: values decide that, or it does not come."""
        event, first = self.timed.event or Event(), self.window[0]
        if event.changes is not None:
            return NEVER
        if event.becomes is not None:
            return _time_of(event.becomes, first, self.period_s)
        return max(first, int(edges(self.period_s, event.at_s, 0.0)[0]))

    @property
    def open(self) -> int:
        """How many obligations were not over at the end."""
        return self.events - self.judged

    def take(self, rows: Rows) -> None:
        """Look at the next recorded cycles."""
        if not len(rows):
            return
        self.rows, self.last = self.rows + len(rows), int(rows.cycle[-1])
        new = 0 if self._carry is None else 1
        rows = self._carry.then(rows) if self._carry else rows
        self._carry = rows.part(slice(-1, None))
        event = self._events(rows, new)
        if self.timed.overshoot is not None:
            rows = self._overshoot_rows(rows, event, self.timed.overshoot)
        self.events += int(event.sum())
        self._watch(rows, new, event)

    def end(self, cut: bool) -> None:
        """Conclude; `cut`: the run went on behind the last record."""

    def _watch(self, rows: Rows, new: int, event: Mask) -> None:
        raise NotImplementedError

    def _events(self, rows: Rows, new: int) -> Mask:
        """Return in which rows an obligation begins; the first `new` ones are known already."""
        first, past = self.window
        event, cycle = self.timed.event, rows.cycle
        if event is not None and event.becomes is not None:
            begins = _rising(event.becomes.margin(rows) >= 0.0)
        elif event is not None and event.changes is not None:
            x = np.broadcast_to(event.changes.at(rows), len(rows))
            begins = np.concatenate(([False], _differ(x[1:], x[:-1])))
        else:
            begins = _rising(cycle >= self.begin)
        begins[:new] = False
        return begins & (cycle >= first) & (cycle < past)

    def _overshoot_rows(self, rows: Rows, event: Mask, shot: Overshoot) -> Rows:
        """Return the rows with how far the value is past its reference, and how far it may be."""
        x, over = (np.broadcast_to(one.at(rows), len(rows)) for one in (shot.value, shot.over))
        jump = np.diff(over, prepend=over[:1])
        event &= np.isfinite(jump) & (jump != 0.0)
        which = np.maximum.accumulate(np.where(event, np.arange(len(rows)), -1))
        step = np.where(which < 0, self._step, jump[which])
        self._step = float(step[-1])
        limit = shot.limit * np.abs(step) if shot.relative else np.full(len(rows), shot.limit)
        more = {PAST: np.sign(step) * (x - over), LIMIT: limit}
        return replace(rows, columns={**rows.columns, **more})

    def _note(self, cycle: int, margin: float, compared: ComparedValue) -> None:
        """Keep the smallest margin."""
        if margin < self.margin or self.least is None:
            self.margin, self.least = margin, (cycle, compared)

    def _note_violation(self, cycle: int, compared: ComparedValue) -> None:
        """Keep the first violation."""
        if self.first is None or cycle < self.first[0]:
            self.first = cycle, compared


def _time_of(event: Condition, first: int, period_s: float) -> int:
    """Return with which cycle, from `first` on, a condition on time alone becomes true, or NEVER.

    What holds for a thousandth of the time from `first` on is found, as `5 s < time.t_s < 6 s` is.
    """
    if {name.rpartition(":")[2] for name in event.names} != {_TIME}:
        return NEVER

    def holds(cycle: Indices) -> Mask:
        times = dict.fromkeys(event.names, np.asarray(cycle * period_s, np.float64))
        return np.asarray(event.margin(Rows(cycle, times, period_s)) >= 0.0)

    cycle = max(first - 1, 0) + np.unique(np.geomspace(1, _LONGEST, 1 << 15).astype(np.int64)) - 1
    rising = np.flatnonzero(_rising(holds(cycle)) & (cycle >= first))
    if not len(rising):
        return NEVER
    low, high = int(cycle[max(rising[0] - 1, 0)]), int(cycle[rising[0]])
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(np.array([middle]))[0] else (middle, high)
    return high


def _rising(holds: Mask) -> Mask:
    return np.concatenate((holds[:1], holds[1:] & ~holds[:-1]))


def _differ(a: Vector, b: Vector) -> Mask:
    return np.asarray((a != b) & ~(np.isnan(a) & np.isnan(b)))


@dataclass
class Hold(Monitor):
    """(1): `holds` from `within` after an event to the next event, or the end."""

    _since: int = -1  # the cycle of the last event
    _counted: int = -1  # the last one that has been judged in some cycle

    def _watch(self, rows: Rows, new: int, event: Mask) -> None:
        holds, cycle = self.timed.holds, rows.cycle
        since = np.maximum.accumulate(np.where(event, cycle, self._since))
        self._since = int(since[-1])
        forced = (since >= 0) & (cycle - since >= self.within) & (cycle < self.window[1])
        forced[:new] = False
        if not forced.any():
            return
        begun = since[forced]  # in ascending order
        events = 1 + int(np.count_nonzero(begun[1:] != begun[:-1]))
        self.judged += events - int(begun[0] == self._counted)
        self._counted = int(begun[-1])
        margin = np.where(forced, holds.margin(rows), math.inf)
        i = int(np.argmin(margin))
        self._note(int(cycle[i]), float(margin[i]), holds.said(rows, i))
        if margin[i] < 0.0 and self.first is None:
            i = int(np.argmax(margin < 0.0))
            self._note_violation(int(cycle[i]), holds.said(rows, i))

    def end(self, cut: bool) -> None:
        """Count the last obligation as open if it was not over."""
        past = self.window[1]
        unfinished = cut if past == NEVER else self.last < past - 1
        if unfinished and self.judged and self._counted == self._since and self.first is None:
            self.judged -= 1


@dataclass
class Respond(Monitor):
    """(2): at most `within` after each event `holds` begins to hold, for `lasts_s`."""

    _kept: Rows | None = None
    _margin: Vector = field(default_factory=lambda: np.empty(0))
    _pending: list[int] = field(default_factory=list)  # cycles of events

    def __post_init__(self) -> None:
        super().__post_init__()
        self.lasts = self._cycles(self.timed.lasts_s or 0.0)

    def _watch(self, rows: Rows, new: int, event: Mask) -> None:
        self._pending += rows.cycle[event].tolist()
        margin, rows = self.timed.holds.margin(rows)[new:], rows.part(slice(new, None))
        self._kept = self._kept.then(rows) if self._kept else rows
        self._margin = np.concatenate((self._margin, margin))
        over = np.asarray(self._pending, np.int64) <= self.last - self.within - self.lasts
        self._decide(int(over.sum()))
        first = self._pending[0] if self._pending else self.last
        unused = max(int(np.searchsorted(self._kept.cycle, first)) - 1, 0)  # one for rate(x)
        self._kept, self._margin = self._kept.part(slice(unused, None)), self._margin[unused:]

    def end(self, cut: bool) -> None:
        """Decide what can be."""
        self._decide(len(self._pending))

    def _decide(self, count: int) -> None:
        """Judge the first `count` pending events by the rows that are there."""
        if not count or self._kept is None:
            return
        begins, self._pending = np.array(self._pending[:count]), self._pending[count:]
        cycle, margin = self._kept.cycle, self._margin
        begin, end = (
            np.searchsorted(cycle, begins),
            np.searchsorted(cycle, begins + self.within, "right"),
        )
        ends = np.searchsorted(cycle, cycle + self.lasts, "right")
        all_over = extremes(margin, np.arange(len(cycle)), ends, np.minimum)
        whole = cycle + self.lasts <= self.last
        hoped = extremes(all_over, begin, end, np.maximum)
        sure = extremes(np.where(whole, all_over, -math.inf), begin, end, np.maximum)
        held = sure >= 0.0
        broken = ~held & (hoped < 0.0) & (begins + self.within <= self.last)
        self.judged += int((held | broken).sum())
        margins = np.where(held, sure, np.where(broken, hoped, math.inf))
        i = int(np.argmin(margins))
        if held[i] or broken[i]:
            row = int(begin[i] + np.argmax(margin[begin[i] : ends[end[i] - 1]] == margins[i]))
            self._tell(row, float(margins[i]))
        if broken.any():
            bad = np.flatnonzero(margin < 0.0)
            row = int(bad[np.searchsorted(bad, end[broken] - 1)].min())
            self._note_violation(int(cycle[row]), self.timed.holds.said(self._kept, row))

    def _tell(self, row: int, margin: float) -> None:
        assert self._kept is not None, "there are rows"
        self._note(int(self._kept.cycle[row]), margin, self.timed.holds.said(self._kept, row))


@dataclass
class Until(Monitor):
    """(3): `holds` from the begin until `until` does, which comes `within`, if that is given."""

    _begin: int = -1
    _before: float = math.inf  # the smallest margin of `holds` so far
    _best: float = -math.inf
    _done: bool = False  # fulfilled
    _over: bool = False

    def _watch(self, rows: Rows, new: int, event: Mask) -> None:
        holds, until, cycle = self.timed.holds, self.timed.until, rows.cycle
        assert until is not None, "the form has it"
        if event.any():
            self._begin = int(cycle[np.argmax(event)])
        if self._begin < 0 or self._over:
            return
        due = NEVER if self.timed.within_s is None else self._begin + self.within
        watched = (cycle >= self._begin) & (cycle <= due)
        watched[:new] = False
        hold_margins, ends = holds.margin(rows), until.margin(rows)
        before = np.minimum.accumulate(np.concatenate(([self._before], hold_margins[watched])))
        self._before = float(before[-1])
        end_margins = np.full(len(rows), -math.inf)
        end_margins[watched] = np.minimum(ends[watched], before[:-1])
        self._conclude(rows, watched, hold_margins, end_margins, until)
        if self.last >= due:
            self._over = True
            if not self._done and self.first is None:
                row = int(np.flatnonzero(cycle <= due)[-1])
                self._note_violation(int(cycle[row]), until.said(rows, row))

    def _conclude(
        self, rows: Rows, watched: Mask, hold_margins: Vector, end_margins: Vector, until: Condition
    ) -> None:
        """Keep the best end so far, and which came first: an end, or a violation."""
        cycle, holds = rows.cycle, self.timed.holds
        i = int(np.argmax(end_margins))
        if watched.any() and (end_margins[i] > self._best or self.least is None):
            self._best = self.margin = float(end_margins[i])
            deciding = until if until.margin(rows)[i] == end_margins[i] else holds
            self.least = int(cycle[i]), deciding.said(rows, i)
        done, bad = (
            np.flatnonzero(end_margins >= 0.0),
            np.flatnonzero(watched & (hold_margins < 0.0)),
        )
        first_end = int(cycle[done[0]]) if len(done) else NEVER
        if len(bad) and not self._done and cycle[bad[0]] < first_end:
            self._note_violation(int(cycle[bad[0]]), holds.said(rows, int(bad[0])))
        self._done = self._done or (len(done) > 0 and self.first is None)

    def end(self, cut: bool) -> None:
        """Judge what was decided."""
        self.judged = int(self._done or self.first is not None)
        if not self.judged:
            self.margin, self.least = math.inf, None


def monitor(timed: TimedRequirement, period_s: float) -> Monitor:
    """Return what watches a requirement."""
    if timed.until is not None:
        return Until(timed, period_s)
    return (Hold if timed.lasts_s is None else Respond)(timed, period_s)
