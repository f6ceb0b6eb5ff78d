"""The figures that every report has: the run's course, and how late the executive woke.

Colours are Okabe and Ito's; every state has its name beside its colour.
"""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from pcpc.executive.log.long_logs import WITHOUT_CLOCK
from pcpc.plants import pages
from pcpc.tools.after.log.drawing import plain_text
from pcpc.tools.after.report.record import ReportedRun
from pcpc.tools.after.verdict import on_purpose
from pcpc.tools.after.verdict.timing import parts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STATES = {
    "INIT": pages.GREY, "READY": pages.SKY, "RUN": pages.BLUE, "HOLD": pages.ORANGE,
    "FAULT": pages.VERMILION, "STOP": pages.BLACK,
}  # fmt: skip
MARKS = {"tunings": ("^", pages.GREEN), "alarms": ("v", pages.ORANGE),
         "faults": ("X", pages.VERMILION)}  # fmt: skip
NARROWEST = 0.002  # of the page: of a state that lasts a cycle
MOST_FAULTS = 20  # on purpose, a row each
_ROW_IN, _REST_IN, _WIDTH_IN, _DPI = 0.3, 0.9, 7.0, 140
_EDGES_US = np.geomspace(0.1, 1e7, 8 * 20 + 1)
_STAGES = {
    "wake_late": ("woken behind its deadline", pages.BLUE, "-"),
    "work": ("work: receive, step, send", pages.VERMILION, "--"),
}


def states(record: ReportedRun, node: str) -> Iterator[tuple[str, float, float]]:
    """Yield each state of a node's supervisor with begin and end in s, in their order."""
    last, begin_s = "INIT", 0.0
    for at_s, name, event in record.entries("state"):
        if name == node:
            yield last, begin_s, at_s
            last, begin_s = str(event.get("name", event.get("argument"))), at_s
    yield last, begin_s, max(record.end_s, begin_s)


def on_purpose_spans(
    record: ReportedRun,
) -> Iterator[tuple[str, str, float, float, Mapping[str, Any]]]:
    """Yield node, fault on purpose, begin and end in s, and what is known of the fault."""
    for node, one in record.log.node.items():
        for fault, *span, known in on_purpose.fault_spans(one):
            later = bool(known.get("next_cycle"))
            begin_s, end_s = (record.period_s(node) * (cycle + later) for cycle in span)
            yield node, fault, begin_s, min(end_s, max(record.end_s, begin_s)), known


def course(record: ReportedRun) -> "Figure | None":
    """Return states, faults on purpose and marks over time; None of a run without any."""
    spans = [(node, list(states(record, node))) for node in record.log.node]
    spans = [(node, own) for node, own in spans if len(own) > 1]
    faults: dict[str, list[tuple[float, float]]] = {}
    for _, name, begin_s, end_s, _ in on_purpose_spans(record):
        faults.setdefault(name, []).append((begin_s, end_s - begin_s))
    faults = dict(list(faults.items())[:MOST_FAULTS])
    marks = {"tunings": [at_s for at_s, *_ in tunings(record)],
             "alarms": [at_s for at_s, *_ in record.entries("alarm")],
             "faults": [at_s for at_s, *_ in record.entries("fault")]}  # fmt: skip
    marks = {name: times for name, times in marks.items() if times}
    rows = [*(node for node, _ in spans), *faults, *marks]
    if not rows or not record.end_s:
        return None
    page, ax = pages.sheet((_WIDTH_IN, _REST_IN + _ROW_IN * len(rows)), _DPI)
    for i, (_, own) in enumerate(spans):
        _draw_states(ax, i, own, record.end_s)
    for i, pieces in enumerate(faults.values(), len(spans)):
        ax.broken_barh(pieces, (i - 0.3, 0.6), color=pages.PURPLE, edgecolor="none")
    for i, (name, times) in enumerate(marks.items(), len(spans) + len(faults)):
        marker, colour = MARKS[name]
        ax.plot(times, [i] * len(times), marker, color=colour, markersize=6, linestyle="none")
    ax.set_yticks(range(len(rows)), [plain_text(row) for row in rows])
    ax.set(xlim=(0.0, record.end_s), ylim=(len(rows) - 0.5, -0.5), xlabel="time [s]")
    pages.apply_grid_style(ax)
    handles = _keys({state for _, own in spans for state, *_ in own})
    page.legend(handles=handles, loc="outside upper left", ncols=6, frameon=False, fontsize=8)
    return page


def tunings(record: ReportedRun) -> list[tuple[float, str, Mapping[str, Any]]]:
    """Return time in s, node and entry of all tunings, but for those of faults on purpose."""
    entries = [
        (record.period_s(name) * int(entry["cycle"]), name, entry)
        for name, node in record.log.node.items()
        for entry in node.tunings
        if not (entry["name"].startswith("fault.") and entry["name"].endswith(".left"))
    ]
    return sorted(entries, key=lambda entry: entry[0])


def _draw_states(
    ax: "Axes", row: int, spans: list[tuple[str, float, float]], whole_s: float
) -> None:
    for state in dict.fromkeys(state for state, *_ in spans):
        pieces = [
            (begin_s, max(end_s - begin_s, NARROWEST * whole_s))
            for name, begin_s, end_s in spans
            if name == state and end_s > begin_s
        ]
        colour, above = STATES.get(state, pages.PURPLE), 2 if state in ("RUN", "READY") else 3
        ax.broken_barh(pieces, (row - 0.3, 0.6), color=colour, edgecolor="none", zorder=above)


def _keys(seen: set[str]) -> list[Any]:
    from matplotlib.patches import Patch

    known = [state for state in STATES if state in seen] + sorted(seen - STATES.keys())
    return [
        Patch(color=STATES.get(state, pages.PURPLE), label=plain_text(state)) for state in known
    ]


def lateness(record: ReportedRun) -> "Figure | None":
    """Return how often the executive was how late, and worked how long; None without a clock."""
    counts = _counts(record)
    measured = [name for name, found in counts.items() if found.sum()]
    if not measured:
        return None
    page, ax = pages.sheet((_WIDTH_IN, 3.4), _DPI)
    for name in measured:
        label, colour, style = _STAGES[name]
        ax.stairs(
            counts[name], _EDGES_US, label=label, color=colour, linestyle=style, linewidth=1.3
        )
    period_us = 1e6 * record.period_s("executive")
    ax.axvline(period_us, color=pages.BLACK, linewidth=0.9, linestyle=":", label="one period")
    seen = np.flatnonzero(np.sum([counts[name] for name in measured], axis=0))
    ax.set(xscale="log", yscale="log", xlabel="time [us]", ylabel="cycles")
    ax.set_xlim(_EDGES_US[seen[0]], max(_EDGES_US[seen[-1] + 1], 1.2 * period_us))
    ax.set_ylim(bottom=0.7)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter("{x:,g}")
    pages.apply_grid_style(ax)
    page.legend(loc="outside upper left", ncols=3, frameon=False, fontsize=8)
    return page


def _counts(record: ReportedRun) -> dict[str, Any]:
    """Return how many cycles fell into each class of `_EDGES_US`, by what was measured."""
    names = [f"timing.{stage}_us" for stage in ("wake_late", "receive", "step", "send")]
    counts = {name: np.zeros(len(_EDGES_US) - 1, np.int64) for name in _STAGES}
    node = record.log.node.get("executive")
    if node is None or record.facts.get("pacing") in WITHOUT_CLOCK:
        return counts
    if not all(name in node.timing for name in names):
        return counts
    for part in parts(record.log):
        late, *work = (part.timing[name] for name in names)
        for name, values in (("wake_late", late), ("work", np.sum(work, axis=0))):
            kept = np.clip(values[np.isfinite(values)], _EDGES_US[0], _EDGES_US[-1])
            counts[name] += np.histogram(kept, _EDGES_US)[0]
    return counts
