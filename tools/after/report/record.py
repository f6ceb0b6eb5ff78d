"""What a report tells of a log, gathered in bounded memory: two passes, and what a judge asks for.

The verdict is the run's own where a summary.json beside the log is bound to it; that of a log
alone knows nothing of what was set, and nothing is judged where the log holds no rig, or an
evaluation from outside that may not run (see `tools.after.log.rig`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.log import long_logs
from pcpc.executive.log import reader as logs
from pcpc.executive.log.inventory import TOPICS
from pcpc.executive.log.mcap_reader import Scan
from pcpc.executive.log.mcap_records import MESSAGE_HEAD
from pcpc.executive.own_laws import carried_files
from pcpc.plants.pages import thinned_line
from pcpc.tools.after.log import series, source
from pcpc.tools.after.log.drawing import DrawnLog
from pcpc.tools.after.log.plot import groups_of
from pcpc.tools.after.log.tally import Tally
from pcpc.tools.after.opened import Opened
from pcpc.tools.after.trust import words_of
from pcpc.tools.after.verdict import summary as summaries
from pcpc.tools.after.verdict import summary_file
from pcpc.tools.after.verdict.findings import Finding
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.after.verdict.summary import Summary
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress

RESOLVED = "rig-resolved.yaml"  # how the name of the effective rig ends
MOST_AXES = 6  # of variables, where the evaluation draws no figure
_POINTS = 4000  # of one of them in a long log
_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass
class ReportedRun:
    """A log, what it adds up to, and what became of the run.

    `unjudged`: why nobody judges it here, or by another evaluation; then `summary` may be None,
    where nothing can be said of what it came to. `at_end`: the verdict is the run's own; `doubt`:
    why the summary beside it is not of it.
    `groups`: the variables to draw, where the evaluation draws none. `is_drawn`: with pictures.
    """

    log: logs.Log
    tally: Tally
    sha256: str
    judge: Judge | None
    unjudged: str
    summary: Summary | None = None
    at_end: bool = False
    doubt: str = ""
    groups: list[list[str]] = field(default_factory=list)
    is_drawn: bool = True

    @property
    def path(self) -> Path:
        """The log's file."""
        return self.log.path

    @property
    def facts(self) -> Mapping[str, str]:
        """What the first node says of the run."""
        return self.log.metadata[next(iter(self.log.node))]

    @cached_property
    def findings(self) -> list[Finding]:
        """What became of limits and requirements; [] of a log that nobody judges here."""
        if self.summary is None or self.judge is None:
            return []
        return summary_file.findings_of(self.summary, self.judge, self.log)

    def period_s(self, node: str) -> float:
        """Return the period of a node's loop, s; 1 ms where the log does not tell."""
        about, facts = self.log.node[node].description, self.log.metadata[node]
        return 1e-9 * float(about.get("period_ns") or facts.get("period_ns") or 1e6)

    @property
    def end_s(self) -> float:
        """Time of the last recorded cycle of all nodes."""
        ends = [
            self.period_s(name) * (int(node.cycle[-1]) + 1)
            for name, node in self.log.node.items()
            if len(node.cycle)
        ]
        return max(ends, default=0.0)

    def entries(self, *kinds: str) -> list[tuple[float, str, Mapping[str, Any]]]:
        """Return time in s, node and event of all events of these kinds, by time."""
        entries = [
            (self.period_s(name) * int(event["cycle"]), name, event)
            for name, node in self.log.node.items()
            for event in node.events
            if event.get("event") in kinds
        ]
        return sorted(entries, key=lambda entry: entry[0])

    def source(self) -> DrawnLog:
        """Return the variables of `groups` as they are drawn."""
        known = _series(self.log, [name for group in self.groups for name in group])
        return DrawnLog(self.path.stem, self.log, known, series.start_ns(self.log))

    def own_figure(self) -> bytes:
        """Return the figure.png of a run's end, b"" if it cannot be had."""
        own = self.summary if self.at_end else None
        content = summary_file.figure_beside(self.path, own) if own else b""
        return content if content.startswith(_PNG) else b""


def gather(run: Opened, progress: Progress, summary: Summary | None = None) -> ReportedRun:
    """Read a log, which stays open while it is reported; LogError if it is none.

    `summary`: what the run came to, if that is known.
    """
    path = run.path
    judge, why = _judge(run)
    groups: list[list[str]] = []

    def wanted_columns(first: logs.Log) -> long_logs.Wanted:
        """Return what will be asked of a long log."""
        columns = {} if judge is None else judge.needed_columns(first, True)
        if not _draws(judge):
            groups.extend(_groups(first))
        names = [name for group in groups for name in group]
        for name, one in _series(first, names).items():
            node, _ = TOPICS[one.topic]
            columns.setdefault(node, []).append(name.removeprefix(f"{node}."))
        return columns

    tally, ends = _totals(path, progress)
    log = run.part(wanted_columns)
    if not _draws(judge) and not groups:
        groups = _groups(log)
    reported = ReportedRun(log, tally, carried_files.sha256(path), judge, why, groups=groups)
    own, reported.doubt = (summary, "") if summary else summary_file.beside(path)
    reported.summary = own
    reported.at_end = reported.summary is not None
    if reported.summary is None and judge is not None:
        outcome = summaries.outcome_of(log, reported.doubt)
        outcome.health = {name: summaries.counters(ends.get(name, {})) for name in log.node}
        reported.summary = summaries.summarise(judge.rig, log, outcome, judge)
    return reported


def _judge(run: Opened) -> tuple[Judge | None, str]:
    """Return who judges a log, or None; and why, or a word on an evaluation that is another one."""
    if not any(name.endswith(RESOLVED) for name in run.head.attachments):
        return None, "the log holds no rig to judge it by"
    try:
        rig, note = run.judged()
        return Judge.of(rig), note
    except (logs.LogError, UserError) as error:
        return None, words_of(error).removeprefix(f"{run.path}: ")


def _draws(judge: Judge | None) -> bool:
    return judge is not None and bool(judge.evaluation.panels)


def _totals(path: Path, progress: Progress) -> tuple[Tally, dict[str, dict[str, float]]]:
    """Return what a log adds up to, but for events, and the last values of each node's columns."""
    tally, last = Tally(Scan()), dict[str, Any]()
    for channel, piece in source.stream(path, tally.found, progress):
        topic = tally.found.topic(channel)
        kind = TOPICS.get(topic, ("", ""))[1]
        if kind not in ("events", "tunings"):
            tally.add(channel, source.messages(piece))
        if kind in ("state", "timing"):
            last[topic] = piece[-1, MESSAGE_HEAD + logs.CDR_BYTES :].copy()
    ends: dict[str, dict[str, float]] = {}
    for topic, row in last.items():
        names = [one.name for one in logs.variables(tally.found, topic)]
        if row.size == 8 * len(names):
            values = zip(names, np.nan_to_num(row.view("<f8")), strict=True)
            ends.setdefault(TOPICS[topic][0], {}).update(values)
    return tally, ends


def _groups(log: logs.Log) -> list[list[str]]:
    """Return the variables on each axis; [] of a log without any."""
    try:
        whole = DrawnLog("", log, series.all_series(log), 0)
        return groups_of([whole], [])[:MOST_AXES]
    except LogCommandError:
        return []


def _series(log: logs.Log, names: Sequence[str]) -> dict[str, series.Series]:
    """Return variables as lines, of a long log with as many points as can be seen."""
    drawn = series.all_series(log, names)
    if isinstance(log, long_logs.LongLog):
        for name, variable in drawn.items():
            rows, values = thinned_line(
                np.arange(len(variable.values), dtype=float), variable.values, _POINTS
            )
            drawn[name] = replace(
                variable, time_ns=variable.time_ns[rows.astype(int)], values=values
            )
        log.forget()
    return drawn
