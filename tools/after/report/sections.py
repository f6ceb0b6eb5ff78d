"""What a run came to and what happened in it; None or [] where a log has nothing of the kind."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.log.long_logs import MOST_ENTRIES, LongLog
from pcpc.executive.log.provenance import rig_commits
from pcpc.executive.loop.alarms import KINDS
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.log.drawing import page_of
from pcpc.tools.after.log.info import start_of
from pcpc.tools.after.report import figures
from pcpc.tools.after.report.record import ReportedRun
from pcpc.tools.after.verdict.findings import NOT_JUDGED, FindingKind
from pcpc.tools.after.verdict.summary import branch_lines
from pcpc.tools.terminal.document import Note, Part, Picture, Section, Strong, Table, Verdict
from pcpc.tools.terminal.html import png_of

MOST_ROWS = 40  # of events of a kind


def title(record: ReportedRun) -> str:
    """Return what ran."""
    name = record.facts.get("rig", "")
    return f"{name}: {record.summary.title}".removesuffix(": ") if record.summary else name


def facts(record: ReportedRun) -> str:
    """Return how, when and how long it ran."""
    facts, summary = record.facts, record.summary
    real = {None: "", True: "SCHED_FIFO", False: "no SCHED_FIFO"}[
        summary.realtime if summary else None
    ]
    commit = rig_commits(record.log.metadata, record.log.node)
    lead = next(iter(record.log.node))
    cycles = len(record.log.node[lead].cycle)
    start = start_of(facts, record.tally.first_ns.get(logs.topic(lead, "state"), 0))
    parts = [
        f"controller {facts.get('controller')}", f"pacing {facts.get('pacing')}",
        f"bus {facts.get('bus')}", real, f"seed {facts.get('seed')}",
        f"rig at commit {commit}" if commit else "",
        f"{cycles:,} cycles recorded at {facts.get('rate_hz')} Hz, {record.end_s:.6g} s",
        f"{start[:19].replace('T', ' ')} UTC" if start else "",
    ]  # fmt: skip
    return ", ".join(filter(None, parts))


def verdict(record: ReportedRun) -> Verdict:
    """Return what the run came to and why, and what is missing in the log."""
    summary, missing = record.summary, [*record.log.missing, *record.tally.left_out()]
    word, lines = "not judged", [record.unjudged]
    if summary is not None:
        word = summary.verdict
        lines = [] if word == NOT_JUDGED else summary.problems()
        left = summary.not_judged.items()
        lines += [f"{summary.named(name)} was not judged: {why}" for name, why in left]
        if not summary.judged and not summary.not_judged:
            lines.append("the rig states no limits for this controller: nothing was judged")
        lines += [record.unjudged] if record.unjudged else []
        if not record.at_end:
            lines.append("judged from the log alone, without the settings of the run")
        missing = [line for line in missing if line not in summary.log_missing]
    branch = [f"no run: a {what}" for what in branch_lines(record.log)]
    lines += [record.doubt] if record.doubt and record.doubt not in lines else []
    reasons = [*branch, *lines, *(f"missing in the log: {line}" for line in missing)]
    return Verdict(word, reasons, word == "ok" and not (missing or branch))


def requirements(record: ReportedRun) -> Table:
    """Return what became of each requirement, where it was first violated, and its margin."""
    states = {True: "met", False: Strong("violated"), None: "not judged"}
    rows = [
        (one.name, states[one.held], one.first if one.held is False else one.reason,
         "" if one.margin is None else one.smallest)
        for one in (record.summary.requirements if record.summary else ())
    ]  # fmt: skip
    return Table(("requirement", "", "first violation", "smallest margin"), rows)


def metrics(record: ReportedRun) -> Table | None:
    """Return every metric, those with limits first, also those that the run does not tell."""
    summary = record.summary
    if summary is None:
        return None
    limits = {one.name: one for one in record.findings if one.kind is FindingKind.LIMIT}
    states, rows = {True: "met", False: Strong("not met"), None: "not judged"}, []
    for name in {**limits, **summary.metrics}:
        value: float = summary.metrics.get(name, math.nan)
        state: object = ""
        bounds = ""
        if one := limits.get(name):
            bounds, state = f"{one.low:g} to {one.high:g}", states[one.held]
        told = f"{value:.4g}" if name in summary.metrics else "not told"
        rows.append((summary.named(name), told, bounds, state))
    return Table(("metric", "value", "limits", ""), rows, (1,))


def figure(record: ReportedRun, folder: Path) -> Part:
    """Return the evaluation's figure; where it draws none the run's own, or variables over time."""
    if not record.is_drawn:
        return None
    judge, summary, place = record.judge, record.summary, folder / "figure.png"
    if judge is not None and not record.groups:
        told = (summary.requirements, summary.changed) if summary else ()
        try:
            if not judge.draw(record.log, summary.metrics if summary else {}, place, *told):
                return Picture(place.read_bytes(), "the figure of the evaluation")
        except RigError as error:
            return Note(f"No figure: {error}")
    if png := record.own_figure():
        return Picture(png, "the figure of the run's end")
    if not record.groups:
        return None
    return Picture(png_of(page_of([record.source()], record.groups)), "variables over time")


# What happened


def course(record: ReportedRun) -> list[Part]:
    """Return states, faults, tunings and alarms over time."""
    drawn = figures.course(record) if record.is_drawn else None
    nodes = record.log.node.values()
    most = max((len(one) for node in nodes for one in (node.events, node.tunings)), default=0)
    cut = isinstance(record.log, LongLog) and most >= MOST_ENTRIES
    return [
        drawn and Picture(png_of(drawn), "states of the supervisor, faults and tunings over time"),
        _states(record), _faults(record), _on_purpose(record), _tunings(record), _alarms(record),
        Note(f"Only the first {MOST_ENTRIES:,} events are shown.") if cut else None,
    ]  # fmt: skip


def _states(record: ReportedRun) -> Section:
    rows = []
    for node in record.log.node:
        spans = list(figures.states(record, node))
        for state in dict.fromkeys(name for name, *_ in spans) if len(spans) > 1 else ():
            own = [(begin_s, end_s) for name, begin_s, end_s in spans if name == state]
            total_s = math.fsum(end_s - begin_s for begin_s, end_s in own)
            rows.append((node, state, f"{len(own):,}", f"{own[0][0]:.4f}", f"{total_s:.4f}"))
    head = ("node", "state", "times", "first [s]", "together [s]")
    return Section("States of the supervisor", [Table(head, rows, (2, 3, 4))])


def listed_section(
    title: str, head: Sequence[str], rows: Iterable[Sequence[object]], right: Sequence[int] = (0, 1)
) -> Section:
    """Return a table with a title; of many rows the first."""
    first, rest = (found := list(rows))[:MOST_ROWS], len(found) - MOST_ROWS
    more = Note(f"And {rest:,} more: pcpc log info --json.") if rest > 0 else None
    return Section(title, [Table(head, first, right), more])


def _faults(record: ReportedRun) -> Section:
    rows = (
        (f"{at_s:.4f}", event["cycle"], node, event.get("name") or event.get("argument", ""))
        for at_s, node, event in record.entries("fault")
    )
    return listed_section("Faults", ("time [s]", "cycle", "node", "fault"), rows)


def _on_purpose(record: ReportedRun) -> Section:
    rows = (
        (f"{begin_s:.4f}", f"{end_s:.4f}", node, name, about.get("kind", ""), about.get("of", ""))
        for node, name, begin_s, end_s, about in figures.on_purpose_spans(record)
    )
    head = ("from [s]", "to [s]", "node", "fault", "kind", "of")
    return listed_section("Faults on purpose", head, rows)


def _tunings(record: ReportedRun) -> Section:
    """Return what was tuned: the old value is that of the tuning before, at first the rig's."""
    now: dict[tuple[str, str], float] = {}
    rows = []
    for at_s, node, entry in figures.tunings(record):
        name, value = str(entry["name"]), float(entry["value"])
        old = now.get((node, name), _of_rig(record.judge.rig, node, name) if record.judge else None)
        now[node, name] = value
        units = {row[0]: row[1] for row in record.log.node[node].description.get("variables", ())}
        change = f"{'unknown' if old is None else f'{old:g}'} → {value:g} {units.get(name, '')}"
        rows.append((f"{at_s:.4f}", entry["cycle"], node, name, change))
    return listed_section("Tunings", ("time [s]", "cycle", "node", "parameter", "old → new"), rows)


def _of_rig(rig: Rig, node: str, name: str) -> float | None:
    """Return a parameter as the rig gives it, None if it leaves it to the law."""
    block, _, parameter = name.partition(".")
    config = rig.config
    sections = {str(role): section for role, section in config.sections.items()}
    own = getattr(sections.get(node), "blocks", {}).get(block)
    parameters = dict(own.parameters) if own is not None else {}
    if block == "controller" and config.controller in config.controllers:
        parameters |= config.controllers[config.controller].parameters
    return parameters.get(parameter)


def _alarms(record: ReportedRun) -> Section:
    rows = []
    for at_s, node, event in record.entries("alarm"):
        name = str(event.get("name"))
        what = KINDS[name][1] if name in KINDS else "late cycle" if name == "late" else name
        rows.append((f"{at_s:.4f}", event["cycle"], node, f"{float(event['value']):g} x {what}"))
    return listed_section("Alarms", ("time [s]", "cycle", "node", "what"), rows)
