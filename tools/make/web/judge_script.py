"""What a page needs to judge a run of a rig as `pcpc simulate` does: `page/judge.js` reads it.

The evaluation's functions run once on `symbols` in place of a log; conditions of requirements are
trees. What neither can be written down is named with the reason, as `why`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, cast

import numpy as np

from pcpc.executive.laws.units import NONE, unit_of_name
from pcpc.executive.log import names
from pcpc.executive.log.long_logs import Columns
from pcpc.executive.log.reader import NODES, Log
from pcpc.executive.nodes.plan import cycles_of
from pcpc.executive.own_laws.law_errors import cause
from pcpc.executive.rig.expressions import Condition, Value
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.requirements import TimedRequirement, text_of
from pcpc.plants import statistics
from pcpc.plants.judging import (
    WINDOW,
    DeclarationError,
    Judged,
    Merit,
    Place,
    Run,
    Source,
    Vector,
    edges,
)
from pcpc.tools.after.verdict.imagined_logs import imagined_log
from pcpc.tools.after.verdict.judge import Judge, beyond
from pcpc.tools.after.verdict.monitors import NEVER, Respond, Until, monitor
from pcpc.tools.after.verdict.requirements import SignalNames
from pcpc.tools.make.web.symbols import Symbol, Trace, Unrecordable, plain

_STATISTICS = {
    id(one): name for name, one in vars(statistics).items() if isinstance(one, statistics.Statistic)
}


def judge_data(rig: Rig, changed: Sequence[str] = ()) -> dict[str, Any]:
    """Return metrics, limits and requirements of a rig and its controller, as plain data for JSON.

    `changed`: settings of the command line, NAME=VALUE. RigError for what `pcpc check` refuses.
    """
    judge = Judge.of(rig)
    log = _silent(imagined_log(rig, "virtual"))
    known = judge.judged(log)
    about = known.period_s, known.windows, known.numbers, known.signals
    traced = _TracedRun(log, *about, trace=Trace())
    return {
        "cycles": cycles_of(rig),
        "reach": _span(traced, WINDOW),
        "unjudged": beyond(rig, list(changed)),
        "metrics": _metrics(judge, traced),
        "signals": _signals(judge, traced),
        "requirements": _requirements(judge, traced),
        "nodes": traced.trace.nodes,
    }


class _Silence:
    """What a page does not know while it judges."""

    def __getattr__(self, name: str) -> Any:
        raise Unrecordable("it reads the log past the variables of a run")

    def _refuse(self, *given: Any) -> Any:
        raise Unrecordable("it reads the log past the variables of a run")

    __len__ = __iter__ = __getitem__ = __bool__ = __array__ = __contains__ = _refuse


def _silent(log: Log) -> Log:
    """Return a log that has names, but nothing to read."""
    silence: Any = _Silence()

    def refuse(name: str) -> Vector:
        raise Unrecordable("it reads the log past the variables of a run")

    nodes = {
        name: replace(
            node,
            cycle=silence,
            stamp_ns=silence,
            frames=silence,
            events=silence,
            tunings=silence,
            columns=Columns(list(node.columns), refuse),
            timing=Columns(list(node.timing), refuse),
        )
        for name, node in log.node.items()
    }
    return replace(log, node=nodes)


@dataclass(frozen=True)
class _Run(Run):
    """A run of which nothing but the names is known."""

    trace: Trace = field(default_factory=Trace)

    @property
    def cycle(self) -> Any:
        """The cycle numbers."""
        return self.trace.symbol("cycle")

    @property
    def t_s(self) -> Any:
        """Time of the cycles, s."""
        return self.cycle * self.period_s

    @property
    def plant_tells(self) -> bool:
        """Whether the rig has a plant."""
        return "plant" in self.log.node

    def setting(self, name: str) -> float:
        """Return a setting of the rig, and note that it was asked for."""
        self.trace.settings.add(name)
        return super().setting(name)

    def told(self, node: str) -> Any:
        """Return that a node records every cycle, or none."""
        if node not in self.log.node:
            return self.trace.number(0.0, "vector", logical=True)
        return self.trace.symbol("told", node, logical=True)

    def get(self, name: str) -> Any:
        """Return a variable, or NaN."""
        known = name in self.signals or self.has(name)
        return self[name] if known else self._nan()

    def values(self, source: Source, place: Place | None = None) -> Any:
        """Return the values of a source."""
        found: Any = self.get(source) if isinstance(source, str) else source(self)
        if not isinstance(found, Symbol) or found.kind == "scalar":
            raise Unrecordable("it does not return a number a cycle that it calculates")
        return found

    def _nan(self) -> Symbol:
        return self.trace.number(math.nan, "vector")

    def _told(self, name: str) -> Any:
        node, variable = names.find_variable(self.log, name) or name.partition(":")[::2]
        if node not in NODES:
            if "plant" in self.log.node or "." not in name:
                raise DeclarationError(names.unknown_name(self.log, name, self.signals))
            return self._nan()
        record = self.log.node.get(node)
        if record is None or not len(record.columns):
            return self._nan()
        if variable in record.columns:
            self.suspects.add(name)
        elif variable not in record.timing:
            raise DeclarationError(names.unknown_name(self.log, name))
        return self.trace.column(f"{node}:{variable}")

    def before(self, values: Any) -> Any:
        """Return the value of the cycle before each."""
        return self._moved_symbol("before", values)

    def after(self, values: Any) -> Any:
        """Return the value of the cycle after each."""
        return self._moved_symbol("after", values)

    def _moved_symbol(self, where: str, values: Any) -> Symbol:
        return self.trace.symbol(where, self.trace.operand(values).index)


@dataclass(frozen=True)
class _TracedRun(Judged):
    """A run of which nothing but the names is known, with its windows."""

    trace: Trace = field(default_factory=Trace)

    def run(self, leader: str = "executive") -> _Run:
        """Return the run, which has computed nothing yet."""
        return _Run(
            self.log,
            self.period_s,
            leader,
            signals=self.signals,
            windows=self.windows,
            numbers=self.numbers,
            trace=self.trace,
        )

    def stretches(self, leader: str) -> Any:
        """Refuse: there is nothing to yield."""
        raise Unrecordable("it goes through the log on its own")

    def measured(self, merits: Mapping[str, Merit], leader: str = "executive") -> Any:
        """Return the figures by name."""
        return {name: self.figure(one, self.run(leader)) for name, one in merits.items()}

    def figure(self, one: Merit, run: _Run) -> Symbol:
        """Return what stands for a figure of merit."""
        if run.leader not in self.log.node:
            return self.trace.number(math.nan)
        name = _STATISTICS.get(id(one.statistic))
        source = run.values(one.source, one.place)
        if name is None or (name in ("CORRELATION", "SETTLING")) != (source.kind == "pair"):
            raise Unrecordable("its statistic is not one of pcpc.plants.evaluation")
        what = run.leader, name, source.index, *_span(self, one.over)
        return one.scale * cast(Any, self.trace.symbol("merit", *what, kind="scalar"))


def _span(judged: Judged, window: str) -> list[float | str]:
    """Return the first cycle of a window, and the first behind it."""
    return [plain(edge) for edge in edges(judged.period_s, *judged.windows[window])]


def _metrics(judge: Judge, traced: _TracedRun) -> list[dict[str, Any]]:
    """Return the figures of merit that a run may have, with the controller's limits."""
    config = judge.rig.config
    limits, ids = dict(config.expected), config.limit_ids()
    found = []
    for name, merit in judge.evaluation.taken(traced.numbers).items():
        one: dict[str, Any] = {"name": name}
        if (unit := unit_of_name(name)) is not None:
            one["unit"] = unit.text
        run = traced.run(merit.leader if isinstance(merit, Merit) else "executive")
        traced.trace.settings.clear()
        try:
            if isinstance(merit, Merit):
                one["value"] = traced.figure(merit, run).index
                one["leader"] = merit.leader
                one["window"] = _span(traced, merit.over)
                one["asked"] = [
                    [asked, ":".join(names.find_variable(traced.log, asked) or ())]
                    for asked in sorted(run.suspects)
                ]
            else:
                one["value"] = traced.trace.of(partial(merit, traced)).index
        except (Exception, Unrecordable) as error:
            one["why"] = (
                str(error) if isinstance(error, Unrecordable | DeclarationError) else cause(error)
            )
        one["settings"] = sorted(traced.trace.settings)
        found.append(one)
    told = {one["name"] for one in found}
    found += [
        {"name": name, "value": traced.trace.number(math.nan).index}
        for name in limits
        if name not in told
    ]
    for one in found:
        if one["name"] in limits:
            one["limit"] = [plain(float(edge)) for edge in limits[one["name"]]]
            one["order"] = list(limits).index(one["name"])
            one["id"] = ids.get(one["name"], "")
    return found


def _signals(judge: Judge, traced: _TracedRun) -> dict[str, int]:
    """Return the nodes of the evaluation's signals; those that are not recorded are left out."""
    found = {}
    for name in judge.evaluation.signals:
        try:
            found[name] = traced.run().values(name).index
        except (Exception, Unrecordable):
            continue  # the metrics that ask for it tell why
    return found


def _requirements(judge: Judge, traced: _TracedRun) -> list[dict[str, Any]]:
    """Return the requirements of the controller."""
    entries = list(judge.required().values())
    known = SignalNames(traced.log, judge.evaluation.signals)
    found: list[dict[str, Any]] = []
    for entry, one in zip(entries, judge.check_requirements(traced.log), strict=True):
        about: dict[str, Any] = {"text": text_of(entry), "id": entry.id or ""}
        traced.trace.settings.clear()
        try:
            about |= (
                {"missing": one} if isinstance(one, str) else _timed_requirement(one, known, traced)
            )
        except (Exception, Unrecordable) as error:
            about["why"] = (
                str(error) if isinstance(error, Unrecordable | DeclarationError) else cause(error)
            )
        about["settings"] = sorted(traced.trace.settings)
        found.append(about)
    return found


def _timed_requirement(
    timed: TimedRequirement, known: SignalNames, traced: _TracedRun
) -> dict[str, Any]:
    """Return a requirement that can be judged; cycles in place of times."""
    watch = monitor(timed, traced.period_s)
    reader = _Conditions(known, traced.run())
    first, past = watch.window
    event = timed.event
    about: dict[str, Any] = {
        "form": type(watch).__name__, "holds": reader.condition(timed.holds),
        "window": [first, _cycle(past)], "begin": _cycle(watch.begin),
        "within": watch.within, "ends": timed.within_s is not None,
        "lasts": watch.lasts if isinstance(watch, Respond) else 0,
    }  # fmt: skip
    if isinstance(watch, Until) and timed.until is not None:
        about["until"] = reader.condition(timed.until)
    if event is not None and event.becomes is not None:
        about["becomes"] = reader.condition(event.becomes)
    elif event is not None and event.changes is not None:
        about["changes"] = reader.value(event.changes)
    if (shot := timed.overshoot) is not None:
        about["overshoot"] = {
            "value": reader.value(shot.value), "over": reader.value(shot.over),
            "limit": shot.limit, "relative": shot.relative,
        }  # fmt: skip
    return about


def _cycle(one: int) -> int | str:
    return "Infinity" if one == NEVER else one


@dataclass(frozen=True)
class _Conditions:
    """Conditions and values of requirements as nodes of a trace."""

    known: SignalNames
    run: _Run

    def condition(self, one: Condition) -> dict[str, Any]:
        """Return a condition."""
        if one.op in ("and", "or"):
            return {"word": one.op, "of": [self.condition(part) for part in one.of]}
        (a, b), (value, limit), shown = one.of, one.sides, one.unit or NONE
        return {
            "sign": one.op, "a": self.value(a), "b": self.value(b), "what": value.text,
            "value": self.value(value), "limit": self.value(limit),
            "factor": float(shown.factor), "unit": shown.text,
        }  # fmt: skip

    def value(self, one: Value) -> int | str:
        """Return the node of a value; of what an overshoot is made of, its name."""
        trace = self.run.trace
        if one.number is not None:
            return trace.number(float(one.number)).index
        if one.op != "column":
            return trace.node(one.op, *(self.value(part) for part in one.of))
        name, factor = one.of
        if name not in self.run.signals and names.find_variable(self.run.log, name) is None:
            return str(name)
        node, variable = self.known.place(name)
        found = trace.column(f"{node}:{variable}") if node else self.run.values(name)
        return (found if factor == 1.0 else found * np.float64(factor)).index
