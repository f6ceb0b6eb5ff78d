"""What became of a rig's requirements in a log of any length, pacing and completeness."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any

import msgspec
import numpy as np

from pcpc.executive.errors import did_you_mean
from pcpc.executive.laws.units import Unit, unit, unit_of_name
from pcpc.executive.log import names
from pcpc.executive.log.long_logs import WITHOUT_CLOCK
from pcpc.executive.log.reader import Log
from pcpc.executive.rig import schema
from pcpc.executive.rig.expressions import BARELY, ExpressionError, Rows
from pcpc.executive.rig.requirements import (
    RequirementError,
    TimedRequirement,
    text_of,
    timed_requirement,
)
from pcpc.executive.rig.roles import PLANTS
from pcpc.plants.judging import Judged, Run
from pcpc.tools.after.verdict.findings import Finding, FindingKind
from pcpc.tools.after.verdict.monitors import NEVER, Hold, Monitor, monitor
from pcpc.tools.terminal.answer import Number

Bound = list[TimedRequirement | str]  # a node that is missing
NEVER_HAPPENED = "its event never happened"
LEADER = "executive"  # whose cycles count
END_S = 0.1  # before the last cycle a paced run may end: a stall skips its last cycles


@dataclass(frozen=True)
class JudgedRequirement:
    """What became of a requirement.

    held       True, False, or None: nothing of it could be judged, `reason` says why
    first_...  where it was first violated, what was compared there, value, limit, in `unit`
    margin     the smallest robustness in `margin_unit`, in `margin_cycle`; negative: violated
    events     how many obligations there were; `open`: those not over at the end
    unrecorded cycles without a record of all that is asked
    """

    name: str
    held: bool | None
    reason: str = ""
    first_cycle: int | None = None
    first_s: Number | None = None
    what: str = ""
    value: Number | None = None
    limit: Number | None = None
    unit: str = ""
    margin: Number | None = None
    margin_unit: str = ""
    margin_cycle: int | None = None
    margin_s: Number | None = None
    events: int = 0
    judged: int = 0
    open: int = 0
    unrecorded: int = 0
    text: str = ""  # all of it, as a line
    id: str | msgspec.UnsetType = msgspec.UNSET  # with which its name begins

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", f"{self.name}: {self._words()}")

    def __str__(self) -> str:
        return self.text

    @property
    def first(self) -> str:
        """Where it was first violated, and by what."""
        unit_text = f" {self.unit}" if self.unit else ""
        return (
            f"cycle {self.first_cycle}, {self.first_s} s: {self.what} = "
            f"{_number(self.value)}{unit_text}, limit {_number(self.limit)}{unit_text}"
        )

    @property
    def smallest(self) -> str:
        """The smallest margin, and when that was."""
        unit = f" {self.margin_unit}" if self.margin_unit else ""
        return f"{_number(self.margin)}{unit} at {self.margin_s} s"

    @property
    def finding(self) -> Finding:
        """What speaks for or against the run."""
        own_id = self.id or ""
        return Finding(
            FindingKind.REQUIREMENT,
            self.reason if self.held is None else self._words(),
            self.held,
            self.name.removeprefix(f"{own_id} ") if own_id else self.name,
            own_id,
            self.value,
            unit=self.unit,
            margin=self.margin,
            first_cycle=self.first_cycle,
            first_s=self.first_s,
        )

    def json(self) -> dict[str, Any]:
        """Return it as summary.json has it."""
        return {key: value for key, value in vars(self).items() if value is not msgspec.UNSET}

    def _words(self) -> str:
        of = f", {self.judged} of {self.events} events judged" if self.open else ""
        of += f", cycles without a record: {self.unrecorded}" if self.unrecorded else ""
        if self.held is None:
            return f"not judged: {self.reason}"
        if self.held:
            return f"met, margin {self.smallest}{of}"
        return f"violated first at {self.first}, smallest margin {self.smallest}{of}"


JudgedRequirements = Annotated[list[JudgedRequirement], msgspec.Meta(min_length=1)]


def _number(value: float | None) -> str:
    return "nan" if value is None else f"{value:.4g}"


class SignalNames:
    """What names stand for in a log with the signals of an evaluation."""

    def __init__(self, log: Log, signals: Mapping[str, Any]) -> None:
        self.log, self.signals = log, signals

    @cached_property
    def _units(self) -> dict[tuple[str, str], str]:
        return {
            (node, name): text
            for node, one in self.log.node.items()
            for name, text, *_ in one.description.get("variables", [])
        }

    def place(self, name: str) -> tuple[str, str]:
        """Return node and variable of a recorded variable; "", name of a signal.

        ExpressionError for what is neither.
        """
        if (found := names.find_variable(self.log, name)) is not None:
            self._check_whose(name, *found)
            return found
        if name in self.signals:
            return "", name
        if why := names.why_unrecorded(self.log, name):
            raise ExpressionError(f"{name} is {why}")
        raise ExpressionError(f"no variable {name}{did_you_mean(name, self._known_names())}")

    def _check_whose(self, name: str, node: str, variable: str) -> None:
        """Raise ExpressionError for a variable that several plants have, of none by name."""
        having = [
            one
            for one, record in self.log.node.items()
            if one in PLANTS and variable in record.columns
        ]
        if node in PLANTS and ":" not in name and len(having) > 1:
            what = f"{name} is one of {', '.join(having)}; say whose, as {having[-1]}:{name}"
            raise ExpressionError(what)

    def unit(self, name: str) -> Unit | None:
        """Return the unit of a name, None for one that nobody tells; ExpressionError."""
        node, variable = self.place(name)
        if not node:
            return unit_of_name(name)
        text = self._units.get((node, variable))
        return None if text is None else unit(text)

    def _known_names(self) -> Iterator[str]:
        for node, one in self.log.node.items():
            before = "" if node == LEADER else f"{node}:"
            yield from (f"{before}{name}" for name in (*one.columns, *one.timing))
        yield from self.signals

    def absent(self, entry: schema.Requirement) -> str:
        """Return a node that a requirement asks for and the log does not have; "" for none."""
        asked_nodes = [LEADER]
        for name in timed_requirement(entry, lambda name: None).names:
            node, colon, _ = name.partition(":")
            own = names.find_variable(self.log, name) or names.why_unrecorded(self.log, name)
            asked_nodes.append(node if colon else LEADER if own else "plant")
        return next((node for node in asked_nodes if node not in self.log.node), "")

    def rows(self, asked: frozenset[str], run: Run, own_rows: slice) -> Rows:
        """Return the own cycles of a stretch that have a record of all that is asked."""
        places = {name: self.place(name) for name in asked}
        nodes = {node for node, _ in places.values()}
        nodes = set(self.log.node) if "" in nodes else nodes
        recorded = np.logical_and.reduce([run.told(node) for node in nodes])[own_rows]
        columns = {
            name: run.values(f"{node}:{variable}" if node else name)[own_rows][recorded]
            for name, (node, variable) in places.items()
        }
        return Rows(run.cycle[own_rows][recorded], columns, run.period_s)


def bound_requirements(entries: Sequence[schema.Requirement], known: SignalNames) -> Bound:
    """Return requirements that can be judged; of others the node that the log does not have.

    RequirementError, with the number of the entry, for names and units that are wrong.
    """
    bound: Bound = []
    for number, entry in enumerate(entries):
        try:
            bound.append(known.absent(entry) or timed_requirement(entry, known.unit))
        except RequirementError as error:
            error.number = number
            raise
    return bound


def results(
    entries: Sequence[schema.Requirement],
    judged: Judged,
    cut: bool | None = None,
    those: Bound | None = None,
) -> list[JudgedRequirement]:
    """Return what became of requirements; RequirementError as `bound_requirements`.

    `cut`: whether the run went on behind the log's end; None: as far as the log tells. `those`:
    what `bound_requirements` says of the entries, if that was asked already.
    """
    known = SignalNames(judged.log, judged.signals)
    able = [
        one if isinstance(one, str) else monitor(one, judged.period_s)
        for one in (bound_requirements(entries, known) if those is None else those)
    ]
    watched = [one for one in able if not isinstance(one, str)]
    for run, own in judged.stretches(LEADER) if watched else ():
        for watch in watched:
            watch.take(known.rows(watch.timed.names, run, own))
    for watch in watched:
        watch.end(ends_early(judged.log, watch.last, judged.period_s) if cut is None else cut)
    judged_results = [
        JudgedRequirement(text_of(entry), None, f"the log has no {one}")
        if isinstance(one, str)
        else _result(one, judged)
        for entry, one in zip(entries, able, strict=True)
    ]
    ids = (entry.id for entry in entries)
    return [replace(one, id=i) if i else one for one, i in zip(judged_results, ids, strict=True)]


def ends_early(log: Log, last: int, period_s: float) -> bool:
    """Return whether a record that ends with cycle `last` ends before its run should have."""
    clocked = log.metadata.get(LEADER, {}).get("pacing") not in WITHOUT_CLOCK
    cycles = log.node[LEADER].description.get("cycles", 0)
    return (cycles - 1 - last) * period_s > END_S * clocked


def _result(watch: Monitor, judged: Judged) -> JudgedRequirement:
    """Return what a monitor found."""
    record, period_s = judged.log.node[LEADER].cycle, judged.period_s
    unrecorded = int(record[-1] - record[0]) + 1 - watch.rows if len(record) else 0
    result = JudgedRequirement(
        watch.timed.text,
        None,
        _why_not(watch),
        events=watch.events,
        judged=watch.judged,
        open=watch.open,
        unrecorded=unrecorded,
    )
    if watch.least is None or not (watch.judged or watch.first):
        return result
    cycle, compared = watch.least
    margin = 0.0 if abs(watch.margin) <= -BARELY else watch.margin / float(compared.unit.factor)
    result = replace(
        result,
        held=watch.first is None,
        reason="",
        margin=margin,
        margin_unit=compared.unit.text,
        margin_cycle=cycle,
        margin_s=_seconds(cycle, period_s),
    )
    if watch.first is None:
        return result
    cycle, compared = watch.first
    return replace(
        result,
        first_cycle=cycle,
        first_s=_seconds(cycle, period_s),
        what=compared.what,
        value=compared.value,
        limit=compared.limit,
        unit=compared.unit.text,
    )


def _seconds(cycle: int, period_s: float) -> float:
    return float(f"{cycle * period_s:.12g}")


def _why_not(watch: Monitor) -> str:
    """Return why nothing of a requirement was judged."""
    if not watch.rows:
        return "its variables were not recorded"
    begin, past = watch.begin, watch.window[1]
    if not watch.events and (begin == NEVER or (watch.timed.overshoot and watch.last >= begin)):
        return NEVER_HAPPENED
    if past <= begin < NEVER or (
        isinstance(watch, Hold) and watch.events and watch.last >= past - 1
    ):
        return "no cycle lies in its time"
    if watch.events:
        return "the run ended before its time was over"
    if watch.last >= begin:
        return "no cycle of its time was recorded"
    return f"the run ended before its time began, at {_seconds(begin, watch.period_s)} s"
