"""One rig in two runs: first differing cycle and signal, metrics, verdict, values of the rig.

The states of a pair:

    equal       every recorded bit, all metrics and the verdict
    changed     something of it differs
    unchanged   not run: everything that goes into the run is the same in both versions
    alone       only one side has this rig, or this controller of it
    failed      one side or both could not be run, read or trusted
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import PurePath
from typing import Annotated, Any, Literal

import numpy as np
import yaml

from pcpc.drivers.errors import UserError
from pcpc.executive.log import reader as logs
from pcpc.executive.log.provenance import rig_commits
from pcpc.plants.judging import effective_rig
from pcpc.tools.after.differences import Change, Difference
from pcpc.tools.after.log import diff, series
from pcpc.tools.after.record import Run
from pcpc.tools.after.trust import words_of
from pcpc.tools.after.verdict.findings import NOT_JUDGED
from pcpc.tools.after.verdict.summary import Summary
from pcpc.tools.terminal.answer import Count, NodeName, Number, one_of

STATES = EQUAL, CHANGED, UNCHANGED, ALONE, FAILED = (
    "equal", "changed", "unchanged", "alone", "failed"
)  # fmt: skip
Setting = float | str | bool | list[Any] | None
Side = Literal["", "old", "new"]
_APART = ("title", "note", "watch")  # keys of a rig that no bit depends on
_NONE = Summary(metrics={}, verdict="")  # of a run that cannot be judged here
_UNTOLD = (logs.LogError, UserError, OSError, ValueError)


@dataclass(frozen=True)
class SignalDifference:
    """The biggest difference of a signal."""

    name: str
    largest: float
    "absolute, in the unit of the variable"
    at_s: float
    "its time, s"
    share: Number
    "of the range that the signal has on side A"


@dataclass
class Pair:
    """What came of comparing two runs."""

    rig: str
    "two names with an arrow where they differ"
    controller: str
    "empty: of a rig as a whole"
    state: Annotated[str, one_of(*STATES)] = EQUAL
    "unchanged: nothing that goes into it differs; alone: on one side only; failed: not compared"
    said: list[str] = field(default_factory=list)
    "what only one side has, what failed, in words"
    old: str = ""
    "its log; empty: none"
    new: str = ""
    "its log; empty: none"
    first: Difference | None = None
    "null: none, or not compared"
    signals: list[SignalDifference] = field(default_factory=list)
    "that differ, by share"
    frames: Count = 0
    "kinds of frames that differ"
    metrics: list[Change[Number | None]] = field(default_factory=list)
    "all of both sides, each in the unit of its name"
    judged: list[str] = field(default_factory=list)
    "the metrics that the rig limits"
    verdict: Change[str] = field(default_factory=lambda: Change("verdict", "", ""))
    "empty: not known"
    settings: list[Change[Setting]] = field(default_factory=list)
    "of the rig, that differ, by dotted names"
    commit: Change[str] = field(default_factory=lambda: Change("commit", "", ""))
    "of the rig; empty: not known"
    unknown: list[Annotated[str, one_of("metrics", "verdict")]] = field(default_factory=list)
    "what cannot be compared"
    figure: str = ""
    "its file; empty: none"
    missing: list[str] = field(default_factory=list)
    "damage of the logs; also in said"
    doubts: list[str] = field(default_factory=list)
    "why no gate may trust it: an edited summary, two rigs, a branch and a run; also in said"
    cycles: dict[NodeName, tuple[Count, Count]] = field(default_factory=dict)
    "of each node: how many were compared, of how many"
    side: Side = ""
    "that alone has it"
    allowed: bool = False
    "on one side only, by --allow"

    @property
    def name(self) -> str:
        """Rig and controller."""
        return f"{self.rig}, {self.controller}" if self.controller else self.rig

    @property
    def is_cut(self) -> bool:
        """Nothing differs in what is left of damaged logs."""
        return self.state == FAILED and bool(self.missing) and not self.doubts

    @property
    def faulty(self) -> bool:
        """Of a run on one side only: its verdict is known, and is not ok."""
        return self.verdict.new not in ("", "ok")

    def is_called(self, name: str) -> bool:
        """Return whether a name, RIG or RIG/CONTROLLER, in which * is any text, means it."""
        known = self.rig, f"{self.rig}/{self.controller}"
        return any(fnmatchcase(one, name) for one in known)

    @property
    def checked(self) -> str:
        """How many cycles of how many were compared, of which nodes."""
        counts = [f"{node} {n} of {of}" for node, (n, of) in self.cycles.items()]
        return f"cycles of {', '.join(counts)}" if counts else "no cycle"

    @property
    def outside(self) -> list[SignalDifference]:
        """The signals that differ, without the states of blocks, whose names begin with x_."""
        return [signal for signal in self.signals if ".x_" not in signal.name]

    @property
    def changed_metrics(self) -> list[Change[Number | None]]:
        """The metrics that differ: those that the rig limits first, then by relative change."""

        def order(one: Change[Any]) -> tuple[bool, float]:
            relative = abs(one.relative)
            return one.name not in self.judged, -math.inf if math.isnan(relative) else -relative

        return sorted((one for one in self.metrics if one.differs), key=order)


def compare(old: Run, new: Run, tolerance: float = 0.0) -> Pair:
    """Compare two runs; LogError for what is no log.

    `tolerance`: metrics that change by no more than this share count as equal.
    """
    report = diff.compare(old.log, new.log)
    commits = (rig_commits(run.log.metadata, run.log.node) for run in (old, new))
    found = Pair(
        _both(old, new, "rig"),
        _both(old, new, "controller"),
        old=str(old.path),
        new=str(new.path),
        said=[*report.only, *(_kinds(old, new) if report.equal else ())],
        first=next(iter(report.differences), None),
        commit=Change("commit", *commits),
        cycles={node: (n, _most_cycles(node, old, new)) for node, n in report.cycles.items()},
    )
    found.signals = sorted(_signals(old.log, report.differences), key=lambda s: -s.share)
    found.frames = sum(one.is_frame for one in report.differences)
    values = [dict(settings(run.log)) for run in (old, new)]
    found.settings = [one for one in _changes(*values) if one.differs]
    summaries = [_summary(run, found.said) for run in (old, new)]
    found.metrics = [
        one if not abs(one.relative) <= tolerance else Change(one.name, one.old, one.old)
        for one in _changes(*({**s.metrics, **_margins(s)} for s in summaries))
    ]
    limited = (name for s in summaries for name in (*s.judged, *_margins(s)))
    found.judged = list(dict.fromkeys(limited))
    own = old.judged_at_its_end, new.judged_at_its_end
    if all(own):
        found.verdict = Change("verdict", *(s.verdict for s in summaries))
    found.missing, found.doubts = report.missing, _doubts(old, new, report.equal)
    _conclude(found, report, summaries)
    alike = own[0] == own[1] and found.state == EQUAL  # bits of one log are judged alike
    wrong = bool(found.missing or found.doubts)
    found.unknown = ["metrics"] * (wrong or (_NONE in summaries and not alike))
    left = _unjudged_lines(summaries[0], summaries[1], found.state == EQUAL)
    found.unknown += ["verdict"] * (wrong or bool(left) or not (all(own) or alike))
    found.said += left
    found.said += [
        f"no verdict: {run.path}: no summary.json of this run is beside it"
        for run in (old, new)
        if found.state == CHANGED and not run.judged_at_its_end
    ]
    return found


def _conclude(found: Pair, report: diff.Report, summaries: list[Summary]) -> None:
    """Enter the state, and why a verdict is another one."""
    for side, summary in zip(("old", "new"), summaries, strict=True):
        if found.verdict.differs:
            why = (*summary.faults, *summary.expectations_failed)
            found.said += [f"{side}: {reason}" for reason in why]
    if not report.equal or found.changed_metrics or found.verdict.differs:
        found.state = CHANGED
    elif found.missing or found.doubts:
        found.state = FAILED
    found.said += [*found.missing, *found.doubts]


def _unjudged_lines(old: Summary, new: Summary, alike: bool) -> list[str]:
    """Return what the new run was not judged by, of which the old one tells no verdict either."""
    whole = new.verdict == NOT_JUDGED and not alike
    return [
        f"new: {new.named(name)} was not judged: {why}"
        for name, why in new.not_judged.items()
        if whole or name not in old.not_judged
    ]


def _doubts(old: Run, new: Run, equal: bool) -> list[str]:
    """Return why no gate may trust what two runs say, a line each; `equal`: all their bits are."""
    found = [f"{run.path}: {run.doubt}" for run in (old, new) if run.doubt and not run.log.missing]
    if equal:
        return found
    rigs = [fact(run.log, "rig") for run in (old, new)]
    if rigs[0] != rigs[1]:
        found.append(f"two rigs, {rigs[0]} and {rigs[1]}: nothing of them has to be equal")
    return [*found, *_kinds(old, new)]


def _kinds(old: Run, new: Run) -> list[str]:
    """Return a line if one of two is a branch, and the other is not one from the same cycle."""
    cycles = [fact(run.log, "branch_cycle") for run in (old, new)]
    if cycles[0] == cycles[1]:
        return []
    words = [f"a branch at cycle {one}" if one else "a run from its start" for one in cycles]
    return [f"old is {words[0]}, new is {words[1]}"]


def _most_cycles(node: str, *runs: Run) -> int:
    """Return how many cycles of a node the runs were to have, or have."""
    nodes = [run.log.node[node] for run in runs]
    planned = (int(one.description.get("cycles", 0)) for one in nodes)
    return max(*planned, *(len(one.cycle) for one in nodes))


def _both(old: Run, new: Run, key: str) -> str:
    """Return what the logs say of `key`: one word, or two where they differ."""
    return " -> ".join(dict.fromkeys(fact(run.log, key) for run in (old, new)))


def fact(log: logs.Log, key: str) -> str:
    """Return what a log says of `key`: rig, controller, pacing, ...; "" for nothing."""
    return next((log.metadata.get(node, {}).get(key, "") for node in log.node), "")


def _summary(run: Run, said: list[str]) -> Summary:
    """Return what a run came to; of one that cannot be judged here nothing, and why is said."""
    try:
        return run.result
    except _UNTOLD as error:
        said.append(f"no metrics: {words_of(error)}")
        return _NONE


def _margins(summary: Summary) -> dict[str, float | None]:
    """Return how far a run was from violating each requirement in time, negative if it did."""
    return {f"margin of {one.name}": one.margin for one in summary.requirements}


def _changes(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[Change[Any]]:
    """Return what two mappings say by name, equal or not."""
    return [Change(name, old.get(name), new.get(name)) for name in dict.fromkeys((*old, *new))]


def settings(log: logs.Log) -> Iterator[tuple[str, Any]]:
    """Yield the effective values of a log's rig by dotted names, without other controllers'."""
    try:
        data = effective_rig(log)
    except (yaml.YAMLError, ValueError, RecursionError):
        return
    chosen = fact(log, "controller")
    for name, value in _flat(data, ()):
        of_another = name[0] in ("controllers", "expect") and name[1:2] != (chosen,)
        if not of_another and name[0] not in _APART:
            yield ".".join(name), PurePath(value).name if name == ("dbc",) else value


def _flat(data: Any, above: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    if isinstance(data, dict):
        for key, child in data.items():
            yield from _flat(child, (*above, str(key)))
    elif above:
        yield above, data


def _signals(old: logs.Log, differences: list[Difference]) -> Iterator[SignalDifference]:
    known = series.all_series(old)
    for one in differences:
        if one.largest is None or one.largest_time_s is None or one.label not in known:
            continue
        values = known[one.label].values
        finite = values[np.isfinite(values)]
        span = float(np.ptp(finite)) if len(finite) else 0.0
        share = one.largest / span if span else math.inf
        yield SignalDifference(one.label, one.largest, one.largest_time_s, share)
