"""`pcpc scope`: every cycle of some variables around a trigger, from a running node into a log.

    trigger   a condition as requirements state it; the cycle in which it becomes true
    burst     the cycles from `pre` before the trigger to `post` behind it; no trigger counts until
              it is over, and no cycle is in two of them
    single    one burst               normal   each time, until Ctrl-C, the node's end, --count
    auto      as normal; a burst without a trigger where none came for pre + post

It reads the node's ring of cycles beside the recorder (`executive.nodes.tap`), which the node does
not notice. Rows that the ring lost before they were read are told, and are a loss.
"""

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.laws.units import Unit, unit
from pcpc.executive.loop.ring_layout import OfRecord
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.executive.nodes.tap import Rows, Tap
from pcpc.executive.rig import expressions as ex
from pcpc.tools.after.log.part import LogPart, NodePart
from pcpc.tools.live.answers import Capture, CapturedBurst
from pcpc.tools.live.commands import ScopeRequest
from pcpc.tools.live.local_nodes import Nodes
from pcpc.tools.terminal.outfile import new_file
from pcpc.tools.terminal.picture import check_picture
from pcpc.tools.terminal.progress import Progress

POLL_S = 0.02
_CARRY = 4  # rows before those that are looked at: rate(rate(rate(x))) needs three


@dataclass(frozen=True)
class Burst:
    """Rows of the ring around a cycle with a trigger, or up to one without (`found` False).

    `short`: how many cycles of `pre` there were no rows of, as the ring begins later.
    """

    cycle: int
    found: bool
    rows: NDArray[np.int64]
    short: int = 0


class Trigger:
    """Cuts bursts out of rows that come in any stretches; `pre`, `post` in cycles.

    A trigger counts from cycle `armed` on.
    """

    def __init__(
        self,
        condition: ex.Condition,
        period_s: float,
        pre: int,
        post: int,
        armed: int = 0,
        auto: bool = False,
    ) -> None:
        self.condition, self.period_s, self.pre, self.post = condition, period_s, pre, post
        self.armed, self.auto = armed, auto
        self._open: tuple[int, bool] | None = None  # the burst that is being filled
        self._oldest: int | None = None  # cycle that was seen
        self._begin: int | None = None  # of the next burst at the earliest; None: none before
        self._edges: list[int] = []
        self._held = np.empty((0, 0), np.int64)
        self._carry: ex.Rows | None = None

    def bursts(self, seen: Rows, rows: NDArray[np.int64]) -> Iterator[Burst]:
        """Look at the next cycles, `seen` for the condition and as `rows`; yield what is whole.

        Shape (n, columns of the ring).
        """
        if not len(seen):
            return
        self._oldest = int(seen.cycle[0]) if self._oldest is None else self._oldest
        self._edges += self._rising_edges(seen)
        self._held = np.concatenate((self._held, rows)) if self._held.size else rows
        newest = int(seen.cycle[-1])
        while self._fills_one(newest) and self._open is not None:
            if newest < self._open[0] + self.post:
                break
            yield self._complete_burst(self._open[0] + self.post)
        first = (self._open[0] if self._open else newest - self.post * self.auto) - self.pre
        self._held = self._held[self._held[:, OfRecord.CYCLE] >= max(first, self._begin or 0)]

    def rest(self) -> Burst | None:
        """Return the burst that the end of the node, or of the patience, has cut short."""
        return (
            None
            if self._open is None
            else self._complete_burst(int(self._held[-1, OfRecord.CYCLE]))
        )

    def _fills_one(self, newest: int) -> bool:
        """Return whether a burst is being filled; begin one where there is a trigger."""
        if self._open is None:
            self._edges = [cycle for cycle in self._edges if cycle >= self.armed]
            if self._edges:
                self._open = self._edges[0], True
            elif self.auto and newest >= self.armed + self.pre + self.post:
                self._open = newest - self.post, False
        return self._open is not None

    def _complete_burst(self, last: int) -> Burst:
        assert self._open is not None and self._oldest is not None, "a burst is being filled"
        (cycle, found), self._open = self._open, None
        held, first = self._held[:, OfRecord.CYCLE], cycle - self.pre
        short = max(self._oldest - first, 0) if self._begin is None else 0
        own = (held >= max(first, self._begin or 0)) & (held <= last)
        self._begin = self.armed = last + 1
        return Burst(cycle, found, self._held[own], short)

    def _rising_edges(self, seen: Rows) -> list[int]:
        """Return the cycles in which the condition becomes true; never the first of all."""
        columns = {name: seen[_bare(name)] for name in self.condition.names}
        rows, new = ex.Rows(seen.cycle, columns, self.period_s), 0
        if self._carry is not None:
            rows, new = self._carry.then(rows), len(self._carry)
        self._carry = rows.part(slice(-_CARRY, None))
        holds = self.condition.margin(rows) >= 0.0
        rises = np.concatenate(([False], holds[1:] & ~holds[:-1]))
        rises[:new] = False
        return [int(cycle) for cycle in rows.cycle[rises]]


class Scope:
    """One capture, from arming to its last burst."""

    def __init__(self, request: ScopeRequest) -> None:
        self.request, self.progress = request, Progress(request.quiet)
        self.live, condition, self.names = _selection(request)
        period_ns = self.live.period_ns
        pre, post = (round(1e9 * span_s) // period_ns for span_s in (request.pre_s, request.post_s))
        self.count = 1 if request.mode == "single" else request.count
        seen = {*self.names, *map(_bare, condition.names)}
        self.tap = Tap(self.live, past=True, names=seen)
        armed = 0 if request.past else int(self.live.block.control.cycle) + 1
        auto = request.mode == "auto"
        self.trigger = Trigger(condition, 1e-9 * period_ns, pre, post, armed, auto)
        self.bursts: list[CapturedBurst] = []
        self.is_cut_short = False  # the node ended within a burst
        self.short = ""  # what to say where the first burst begins late

    def run(self, path: Path) -> None:
        """Capture until all bursts are there, the node or the patience has ended, or Ctrl-C."""
        part = LogPart(path)
        log = part.node(self.live.block.description, self.names)
        try:
            self.progress.say(f"{self.live.name}: waiting for the trigger {self.request.trigger}")
            self._capture(log)
        except KeyboardInterrupt:
            if not self.bursts:
                raise
        finally:
            part.close({log.channels.name: {"record": self.tap.missed["record"]}})

    def _capture(self, log: NodePart) -> None:
        within = self.request.within_s
        deadline_s = np.inf if within is None else time.monotonic() + within
        while self.count is None or len(self.bursts) < self.count:
            over = not self.live.running or time.monotonic() > deadline_s  # before the last look
            seen = self.tap.rows()
            for burst in self.trigger.bursts(seen, log.rows(seen)):
                self._tell(log, burst)
                if len(self.bursts) == self.count:
                    return
            if over:
                if rest := self.trigger.rest():
                    self.is_cut_short = True
                    self._tell(log, rest)
                return
            if self.tap.stuck:
                what = "its ring buffer is full: no recorder reads it; start the rig by `pcpc run`"
                raise LiveError(f"{self.live.name}: {what}", Exit.ENVIRONMENT)
            time.sleep(POLL_S)

    def _tell(self, log: NodePart, burst: Burst) -> None:
        """Write a burst, and its trigger as an event; say so."""
        log.add("record", burst.rows)
        stamps = burst.rows[burst.rows[:, OfRecord.CYCLE] >= burst.cycle, OfRecord.STAMP_NS]
        stamp = log.channels.stamp(int(stamps[0]), burst.cycle)
        entry = {"event": "no trigger"}
        if burst.found:
            entry = {"event": "trigger", "name": self.request.trigger}
        log.write_event(stamp, burst.cycle, entry | {"value": 0.0})
        first, last = (int(burst.rows[i, OfRecord.CYCLE]) for i in (0, -1))
        self.bursts.append(
            {
                "cycle": burst.cycle,
                "t_s": float(f"{1e-9 * burst.cycle * self.live.period_ns:.12g}"),
                "first": first,
                "last": last,
                "rows": len(burst.rows),
                "trigger": burst.found,
            }
        )
        if burst.short:
            self.bursts[-1]["missing_before"] = burst.short
            self.short = self._too_long(burst)
        what = "trigger" if burst.found else "no trigger"
        where = f"cycle {burst.cycle}, {self.bursts[-1]['t_s']:g} s"
        self.progress.say(f"{what} at {where}; {len(burst.rows)} cycles, {first} to {last}")

    def _too_long(self, burst: Burst) -> str:
        """Return why a burst begins later than `--pre` before its trigger."""
        held_s = 1e-9 * (self.trigger.pre - burst.short) * self.live.period_ns
        begin = burst.cycle - self.trigger.pre + burst.short
        why = "the node's ring buffer holds no more" if begin else "the run began there"
        return f"--pre {self.request.pre_s:g}s: only {held_s:.6g} s, from cycle {begin} on: {why}"


def command(request: ScopeRequest) -> int:
    """Capture; return the exit code. LiveError: wrong input, or no such node."""
    check_picture("--plot", request.plot)
    scope = Scope(request)
    with new_file(request.output, request.force) as path:
        scope.run(path)
        missed = scope.tap.missed["record"]
        if not scope.bursts:
            is_over = not scope.live.running
            why = "the node ended" if is_over else f"not within {request.within_s:g} s"
            lost = f", {missed} cycles lost" if missed else ""
            raise LiveError(f"{request.trigger}: {why}, no trigger{lost}", Exit.NOT_MET)
    if request.plot is not None:
        from pcpc.tools.after.log import plot  # here, because it takes time
        from pcpc.tools.after.log.commands import PlotRequest

        words = [str(request.output), *scope.names]
        plot.draw(PlotRequest(words=words, output=request.plot, quiet=True))
    rows = sum(one["rows"] for one in scope.bursts)
    if request.json:
        told: Capture = {"file": str(request.output), "lost": missed, "bursts": scope.bursts}
        print(json.dumps(told))
    else:
        ended = ", the last one cut short" if scope.is_cut_short else ""
        bursts = f"{len(scope.bursts)} burst{'s' * (len(scope.bursts) > 1)}"
        print(f"{request.output}: {bursts}, {rows} cycles{ended}")
        if scope.short:
            print(scope.short)
    if missed:
        lost = f"{missed} cycles lost: they were overwritten before they were read"
        print(lost, file=sys.stderr if request.json else sys.stdout)
    return Exit.LOSS if missed else Exit.OK


def _selection(request: ScopeRequest) -> tuple[Live, ex.Condition, list[str]]:
    """Return the node, the trigger and the variables that are asked for; UserError."""
    try:
        wanted = ex.condition(request.trigger, lambda name: None).names
        split = [name.rpartition(":")[::2] for name in (*request.names, *sorted(wanted))]
        if not all(name for _, name in split):
            raise UserError("'': names no variable; `pcpc get` shows all")
        roles = {role for role, _ in split} - {""}
        words = [name for _, name in split]
        there = Nodes()
        named = request.node or min(roles, default="")
        live = there.find(named) if named else there.find_for(words)
        if roles - {role := str(live.block.description["node"])}:
            other = min(roles - {role})
            raise UserError(f"{other}: a scope covers one node, here {live.name}")
        condition = ex.condition(request.trigger, lambda name: _unit(live, _bare(name)))
    except ex.ExpressionError as error:
        raise UserError(f"--trigger: {error}") from None
    if not condition.names:
        raise UserError(f"--trigger: {request.trigger} names no variable")
    about = live.block.description
    recorded = [*about["state_columns"], *about["timing_columns"]]
    chosen: dict[str, None] = {}
    for word in words[: len(request.names)]:
        found = [name for name in live.select([word]) if name in recorded]
        if not found:
            raise UserError(_why_unrecorded(live, word))
        chosen |= dict.fromkeys(found)
    return live, condition, list(chosen)


def _bare(name: str) -> str:
    """Return a variable's name without its node."""
    return name.rpartition(":")[2]


def _unit(live: Live, name: str) -> Unit | None:
    about = live.block.description
    if name not in (recorded := (*about["state_columns"], *about["timing_columns"])):
        if name in live.variables:
            raise ex.ExpressionError(_why_unrecorded(live, name))
        raise ex.ExpressionError(f"no variable {name}{did_you_mean(name, recorded)}")
    return unit(live.variables[name].unit)


def _why_unrecorded(live: Live, name: str) -> str:
    source = live.block.description["sources"].get(name)
    cure = f"; take its source {source}" if source else ""
    kind = live.variables[name].kind if name in live.variables else "nothing of it"
    return f"{name}: {kind}, not recorded every cycle{cure}"
