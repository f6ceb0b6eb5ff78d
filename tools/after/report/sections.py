"""What a run came to and what happened in it, as HTML; "" where a log has nothing of the kind."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.log.long_logs import MOST_ENTRIES, LongLog
from pcpc.executive.loop.alarms import KINDS
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.html import image, png_of, table, text
from pcpc.tools.after.log.drawing import page_of
from pcpc.tools.after.log.info import start_of
from pcpc.tools.after.report import figures
from pcpc.tools.after.report.record import Record
from pcpc.tools.after.verdict.conclude import changes
from pcpc.tools.after.verdict.requirements import violations

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_ROWS = 40  # of events of a kind


def heading(record: Record) -> str:
    """Return what ran, when and how long."""
    facts, told = record.facts, record.told
    name = facts.get("rig", "")
    title = f"{name}: {told.title}".removesuffix(": ") if told else name
    real = {None: "", True: "SCHED_FIFO", False: "no SCHED_FIFO"}[told.realtime if told else None]
    lead = next(iter(record.log.node))
    cycles = len(record.log.node[lead].cycle)
    start = start_of(facts, record.tally.first_ns.get(logs.topic(lead, "state"), 0))
    parts = [
        f"controller {facts.get('controller')}", f"pacing {facts.get('pacing')}",
        f"bus {facts.get('bus')}", real, f"seed {facts.get('seed')}",
        f"{cycles:,} cycles recorded at {facts.get('rate_hz')} Hz, {record.end_s:.6g} s",
        f"{start[:19].replace('T', ' ')} UTC" if start else "",
    ]  # fmt: skip
    return f"<h1>{text(title)}</h1><p>{text(', '.join(part for part in parts if part))}</p>"


def verdict(record: Record) -> str:
    """Return what the run came to and why, and what is missing in the log."""
    told = record.told
    if told is None:
        lines = [record.unjudged]
        return _box("not judged", lines, _missing(record))
    lines = [*told.faults, *told.expectations_failed, *told.frames_too_many, *told.log_missing]
    if told.verdict == "loss" and not (told.frames_too_many or told.log_missing):
        counts = {"frames lost": told.frames.get("missed", 0),
                  "records dropped": int(told.records.get("dropped", 0)),
                  "cycles without a valid input": told.frames.get("starved", 0)}  # fmt: skip
        lines += [f"{what}: {n:,}" for what, n in counts.items() if n > 0]
    lines += [f"{name} was not judged: {why}" for name, why in told.not_judged.items()]
    if not told.judged and not told.not_judged:
        lines.append("the rig states no limits for this controller: nothing was judged")
    lines += [record.unjudged] if record.unjudged else []
    if not record.at_end:
        lines.append("judged from the log alone: what was set for the run is not known")
    missing = [line for line in _missing(record) if line not in told.log_missing]
    return _box(told.verdict, lines, missing)


def _box(word: str, lines: Sequence[str], missing: Sequence[str]) -> str:
    items = [*lines, *(f"missing in the log: {line}" for line in missing)]
    body = "".join(f"<li>{text(line)}</li>" for line in items)
    good = " ok" if word == "ok" and not missing else ""
    listed = f"<ul>{body}</ul>" if body else ""
    return f'<div class="verdict{good}">Verdict: <b>{text(word)}</b>{listed}</div>'


def _missing(record: Record) -> list[str]:
    return [*record.log.missing, *record.tally.left_out()]


def requirements(record: Record) -> str:
    """Return what became of each requirement, where it was first violated, and its margin."""
    rows = []
    for one in record.told.requirements if record.told else ():
        state = {True: "held", False: "<b>violated</b>", None: "not judged"}[one.held]
        first = one.reason if one.held is None else ""
        if one.held is False:
            unit = f" {one.unit}" if one.unit else ""
            first = (f"cycle {one.first_cycle}, {one.first_s} s: {one.what} = "
                     f"{_number(one.value)}{unit}, limit {_number(one.limit)}{unit}")  # fmt: skip
        margin = ""
        if one.margin is not None:
            margin = f"{_number(one.margin)} {one.margin_unit}".rstrip() + f" at {one.margin_s} s"
        rows.append((text(one.name), state, text(first), text(margin)))
    head = ("requirement", "", "first violation", "smallest margin")
    return table(head, rows) if rows else ""


def metrics(record: Record) -> str:
    """Return every metric, those with limits first, also those that the run does not tell."""
    told = record.told
    if told is None:
        return ""
    config = record.judge.rig.config if record.judge else None
    limits = config.expect.get(config.controller, {}) if config else {}
    rows = []
    for name in {**limits, **told.metrics}:
        value, state, bounds = told.metrics.get(name), "", ""
        if name in limits:
            low, high = limits[name]
            bounds = f"{low:g} to {high:g}"
            inside = value is not None and low <= value <= high
            state = "met" if inside else "<b>not met</b>"
            state = "not judged" if name in told.not_judged else state
        shown = _number(value) if name in told.metrics else "not told"
        rows.append((text(name), shown, bounds, state))
    return table(("metric", "value", "limits", ""), rows, (1,)) if rows else ""


def _number(value: float | None) -> str:
    return "nan" if value is None else f"{value:.4g}"


def figure(record: Record, folder: Path) -> str:
    """Return the evaluation's figure; where it draws none the run's own, or variables over time."""
    judge, told, place = record.judge, record.told, folder / "figure.png"
    if judge is not None and not record.groups:
        config = judge.rig.config
        title = f"{config.rig}: {config.title}, controller {config.controller}"
        title += changes(told.changed) if told else ""
        values = {n: math.nan if v is None else v for n, v in told.metrics.items()} if told else {}
        marks = violations(asdict(one) for one in told.requirements) if told else []
        try:
            if not judge.draw(record.log, title, values, place, marks):
                return image(place.read_bytes(), "the figure of the evaluation")
        except RigError as error:
            return f'<p class="note">No figure: {text(error)}</p>'
    if png := record.own_figure():
        return image(png, "the figure of the run's end")
    if not record.groups:
        return ""
    drawn = page_of([record.source()], record.groups, (-math.inf, math.inf))
    return drawn_as("variables over time", drawn)


# What happened


def course(record: Record) -> str:
    """Return states, faults, tunings and alarms over time."""
    drawn = figures.course(record)
    parts = [
        drawn_as("states of the supervisor, faults and tunings over time", drawn),
        _states(record), _faults(record), _on_purpose(record), _tunings(record), _alarms(record),
    ]  # fmt: skip
    cut = isinstance(record.log, LongLog) and any(
        max(len(node.events), len(node.tunings)) >= MOST_ENTRIES
        for node in record.log.node.values()
    )
    if cut:
        parts.append(f'<p class="note">Only the first {MOST_ENTRIES:,} events are told.</p>')
    return "".join(parts)


def _states(record: Record) -> str:
    rows = []
    for node in record.log.node:
        spans = list(figures.states(record, node))
        for state in dict.fromkeys(name for name, *_ in spans) if len(spans) > 1 else ():
            own = [(begin_s, end_s) for name, begin_s, end_s in spans if name == state]
            total_s = math.fsum(end_s - begin_s for begin_s, end_s in own)
            rows.append((text(node), text(state), f"{len(own):,}", f"{own[0][0]:.4f}",
                         f"{total_s:.4f}"))  # fmt: skip
    head = ("node", "state", "times", "first [s]", "together [s]")
    return f"<h3>States of the supervisor</h3>{table(head, rows, (2, 3, 4))}" if rows else ""


def drawn_as(alt: str, drawn: "Figure | None") -> str:
    """Return a figure, if there is one."""
    return "" if drawn is None else image(png_of(drawn), alt)


def listed(
    title: str, head: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = (0, 1)
) -> str:  # fmt: skip
    """Return a table with a title; of many rows the first."""
    if not rows:
        return ""
    rest = len(rows) - MOST_ROWS
    more = f'<p class="note">And {rest:,} more: pcpc log info --json.</p>' if rest > 0 else ""
    return f"<h3>{title}</h3>{table(head, rows[:MOST_ROWS], numbers)}{more}"


def _faults(record: Record) -> str:
    rows = [
        (f"{at_s:.4f}", text(event["cycle"]), text(node),
         text(event.get("name") or event.get("argument", "")))
        for at_s, node, event in record.entries("fault")
    ]  # fmt: skip
    return listed("Faults", ("time [s]", "cycle", "node", "fault"), rows)


def _on_purpose(record: Record) -> str:
    rows = [
        (f"{begin_s:.4f}", f"{end_s:.4f}", text(node), text(name), text(about.get("kind", "")),
         text(about.get("of", "")))
        for node, name, begin_s, end_s, about in figures.on_purpose_spans(record)
    ]  # fmt: skip
    head = ("from [s]", "to [s]", "node", "fault", "kind", "of")
    return listed("Faults on purpose", head, rows)


def _tunings(record: Record) -> str:
    """Return what was tuned: the old value is that of the tuning before, at first the rig's."""
    now: dict[tuple[str, str], float] = {}
    rows = []
    for at_s, node, entry in figures.tunings(record):
        name, value = str(entry["name"]), float(entry["value"])
        key = node, name
        old = now.get(key, _given(record.judge.rig, node, name) if record.judge else None)
        now[key] = value
        units = {row[0]: row[1] for row in record.log.node[node].description.get("variables", ())}
        change = f"{'unknown' if old is None else f'{old:g}'} → {value:g} {units.get(name, '')}"
        rows.append((f"{at_s:.4f}", text(entry["cycle"]), text(node), text(name), text(change)))
    return listed("Tunings", ("time [s]", "cycle", "node", "parameter", "old → new"), rows)


def _given(rig: Rig, node: str, name: str) -> float | None:
    """Return a parameter as the rig gives it, None if it leaves it to the law."""
    block, _, parameter = name.partition(".")
    config = rig.config
    sections = {str(role): section for role, section in config.sections.items()}
    own = getattr(sections.get(node), "blocks", {}).get(block)
    found = dict(own.parameters) if own is not None else {}
    if block == "controller" and config.controller in config.controllers:
        found |= config.controllers[config.controller].parameters
    return found.get(parameter)


def _alarms(record: Record) -> str:
    rows = []
    for at_s, node, event in record.entries("alarm"):
        name = str(event.get("name"))
        what = KINDS[name][1] if name in KINDS else "late cycle" if name == "late" else name
        words = f"{float(event['value']):g} x {what}"
        rows.append((f"{at_s:.4f}", text(event["cycle"]), text(node), text(words)))
    return listed("Alarms", ("time [s]", "cycle", "node", "what"), rows)
