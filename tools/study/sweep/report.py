"""The report of a campaign: one HTML file that needs no network, and its figures as PNG.

What it says, in this order: how it was drawn, the statement, failures with their intervals, why
runs failed or were not judged, the worst cases with the command that runs each again, then every
metric and every requirement's margin: distribution, pairs of controllers on the same draws, what
varied decides.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.tools.study import binomial
from pcpc.tools.study.sweep import decision, figures, reasons, statements
from pcpc.tools.study.sweep.results import MARGIN, METRIC, Results, comparisons
from pcpc.tools.study.sweep.sensitivity import Share
from pcpc.tools.terminal.document import Code, Note, Part, Picture, Section, Table, html
from pcpc.tools.terminal.extras import FIGURE, need
from pcpc.tools.terminal.html import page, png_of, text
from pcpc.tools.terminal.outfile import new_file, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONFIDENCE = 0.95
MOST_WORST, MOST_REASONS = 5, 10
_NOT_INDEPENDENT = {
    "grid": "The draws are a grid, no random sample: a share of failures is a share of the grid, "
    "and the intervals do not apply to a probability.",
    "lhs": "The draws are a Latin hypercube, not independent: the intervals are those of "
    "independent draws, which are probably too wide here.",
    "sobol": "The draws are a Sobol' sequence, not independent: the intervals are those of "
    "independent draws, which are probably too wide here.",
}

_ENDED = (
    "The campaign was ended by its statement. The intervals in the figure and the table are those "
    "of a number of runs fixed beforehand; the statement holds whenever you look."
)
_UNJUDGED = (
    "Of runs that were not judged nobody knows whether they failed. The intervals allow for both: "
    "all of them failed, or none."
)
_OF_CURVES = (
    "A curve ends below 1 where runs have no value, as after a safety stop. Pairs are runs on the "
    "same draw, with the same noise."
)
_OF_SHARES = (
    " First-order shares are estimated from these draws, and are exact on a full grid; the rest up "
    "to 1 is due to interactions and noise."
)


def report(results: Results, folder: Path) -> Path:
    """Write report.html and its PNGs into `folder`; return the path of the page.

    Raises UserError where matplotlib is missing, there is nothing to report or a file cannot be
    written.
    """
    need("a report needs", FIGURE)
    if not results.controllers:
        raise UserError(f"{folder}: no run to report on; start the campaign first")
    pictures = _Pictures(folder)
    title = str(results.spec.get("title") or results.spec["rig"])
    parts = [
        _draws_table(results),
        Section("Failures", _failures(results, pictures)),
        Section("Why runs failed, or were not judged", [_reasons(results)]),
        Section("Worst cases", _worst(results)),
        Section("Metrics and margins", _metrics(results, pictures)),
    ]
    bodies = [f"<h1>{text(title)}</h1>", *map(html, parts)]
    write_text(folder / "report.html", page(title, bodies))
    return folder / "report.html"


class _Pictures:
    """PNGs in a folder, and the same in the page."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._names = set[str]()

    def of(self, drawn: "Figure", name: str, shows: str) -> Picture:
        stem = "".join(c if c.isalnum() or c in "-_." else "-" for c in name)[:80]
        while stem in self._names:  # of names that differ in what a file's name cannot say
            stem += "-"
        self._names.add(stem)
        png = png_of(drawn)
        with new_file(self._folder / f"{stem}.png", force=True) as unfinished:
            unfinished.write_bytes(png)
        return Picture(png, shows)


def _draws_table(results: Results) -> Table:
    spec = results.spec
    settings = ", ".join(str(one) for one in spec.get("settings", ()))
    rows = [
        ("rig", Code(spec["rig"])),
        ("controllers", ", ".join(c or "the rig's own" for c in results.controllers)),
        ("draws", f"{int(np.unique(results.column('draw')).size):,}, "
                  f"{spec.get('sampling', '')}, seed {spec.get('seed', '')}"),
        *(("varied", Code(one)) for one in spec.get("variations", ())),
        *([("set", Code(settings))] if settings else []),
    ]  # fmt: skip
    return Table(("", ""), rows)


def _failures(results: Results, pictures: _Pictures) -> list[Part]:
    named = {"any failure": None} | {name: name for name in results.requirements}
    rows = [
        (what, controller, results.counts(controller, requirement))
        for what, requirement in named.items()
        for controller in results.controllers
    ]
    rows = [row for row in rows if any(row[2]) or row[0] == "any failure"]  # of other controllers
    cells = []
    for what, controller, found in rows:
        low, high = found.interval(CONFIDENCE)
        rate = f"{found.failures / found.runs:.3g}" if found.runs else "not judged"
        interval = f"{low:.3g} to {high:.3g}" if found.runs else ""
        cells.append((what, controller, *(f"{count:,}" for count in found), rate, interval))
    refused = int(results.refused.sum())
    notes = [_NOT_INDEPENDENT.get(str(results.spec.get("sampling")), "")]
    if refused:
        what = f"{refused:,} runs were refused, as a value lay outside its range"
        notes.append(f"{what}; they count neither as ok nor as failed.")
    if "until" in results.spec:
        notes.append(_ENDED)
    if any(found.unjudged for *_, found in rows):
        notes.append(_UNJUDGED)
    head = ("requirement", "controller", "failures", "runs", "not judged", "p_fail",
            "95 % interval")  # fmt: skip
    return [
        *_statements(results),
        pictures.of(figures.failures_page(results, rows), "failures", "failures"),
        Table(head, cells, range(2, len(head))),
        *(Note(note) for note in notes if note),
    ]


def _statements(results: Results) -> list[str]:
    """Return the statement of each controller, in words: that of `until`, or a bound of 95 %."""
    if until := results.spec.get("until"):
        return [one.text for one in decision.decisions(results, until)]
    if results.spec.get("sampling") == "grid":
        return []
    bounds = ((name, _bound(*results.counts(name))) for name in results.controllers)
    return [f"{name}: {bound}" if name else bound for name, bound in bounds]


def _bound(failures: int, runs: int, unjudged: int) -> str:
    """Return what so many failures say; where all may have failed, nothing is known from above."""
    every, most = failures == runs, failures + unjudged
    said = f"{statements.count_text(failures, 'failure')} in {statements.count_text(runs, 'run')}"
    if unjudged:
        said += f"; {statements.unjudged_text(unjudged, every)}"
    if not failures and every:
        return f"nothing is known of p_fail: {said}"
    bound_of = binomial.lower_bound if every else binomial.upper_bound
    bound = bound_of(failures if every else most, runs + unjudged, CONFIDENCE)
    return f"p_fail {'>' if every else '<'} {statements.bound_text(bound)} at 95 %: {said}"


def _reasons(results: Results) -> Table:
    failed = ~np.equal(results.column("ok"), True).astype(bool) & ~results.refused
    names = results.column("controller")
    found = [
        (controller, *one)
        for controller in results.controllers
        for one in reasons.count_reasons(
            results.column("why")[failed & (names == controller)], results.requirements
        )
    ]
    found.sort(key=lambda one: -one[2])
    rows = [(c, why, f"{n:,}") for c, why, n in found[:MOST_REASONS]]
    rest = sum(n for *_, n in found[MOST_REASONS:])
    rows += [("", "other reasons", f"{rest:,}")] if rest else []
    head = ("controller", "first reason", "runs")
    return Table(head, rows, (2,))


def _worst(results: Results) -> list[Section]:
    """Return the worst runs by each margin, without requirements by each metric, and the faults."""
    groups = [
        (f"safety stops and divergences, the first {MOST_WORST}", "", results.faults(MOST_WORST))
    ]
    for name in results.requirements:
        column = MARGIN + name
        groups.append((f"smallest margin: {name}", column, results.worst(column, MOST_WORST)))
    for name in results.metrics if not results.requirements else ():
        rows = results.worst(METRIC + name, MOST_WORST, largest=True)
        groups.append((f"largest {name}", METRIC + name, rows))
    parts = []
    for what, column, rows in groups:
        cells = []
        for row in rows.tolist():
            value = f"{results.column(column)[row]:.4g}" if column else results.column("why")[row]
            draw = f"{results.column('draw')[row]:,}"
            controller = results.column("controller")[row]
            cells.append((draw, controller, value, Code(results.command(row))))
        label = "margin" if column.startswith(MARGIN) else "value" if column else "why"
        head = ("draw", "controller", label, "to run it again, with its log")
        parts.append(Section(what, [Table(head, cells, (0, 2) if column else (0,))]))
    return parts


def _metrics(results: Results, pictures: _Pictures) -> list[Part]:
    parts: list[Part] = []
    for name in results.measures:
        if not any(np.isfinite(results.values(name, c)).any() for c in results.controllers):
            continue
        found = figures.shares_of(results, name)
        bare = name.removeprefix(METRIC).replace(MARGIN, "margin of ")
        picture = pictures.of(figures.page_of(results, name, found), name.replace(":", "-"), bare)
        tables = [_summary(results, name), _pairs_table(results, name), _interacting(found)]
        parts.append(Section(bare, [picture, *tables]))
    note = Note(_OF_CURVES + _OF_SHARES * bool(results.variations))
    return [note, *parts] if parts else []


def _summary(results: Results, name: str) -> Table:
    rows = []
    for controller in results.controllers:
        values = results.values(name, controller)
        told = values[np.isfinite(values)]
        points = np.percentile(told, (0, 50, 95, 100)) if len(told) else [np.nan] * 4
        row = [controller, f"{len(told):,} of {len(values):,}"]
        rows.append(row + ["" if np.isnan(p) else f"{p:.4g}" for p in points])
    head = ("controller", "runs", "smallest", "median", "95 %", "largest")
    return Table(head, rows, range(1, len(head)))


def _pairs_table(results: Results, name: str) -> Table:
    """Return the table of pairs with the first controller; of values not all above 0 no times."""
    rows = []
    for other, told, counts, ratio in comparisons(results, name, figures.RATIOS):
        times = ["" if np.isnan(ratio) else f"{count:,}" for count in counts[1:]]
        median = "" if np.isnan(ratio) else f"{ratio:.3g}"
        rows.append((other, f"{counts[0]:,} of {told:,}", *times, median))
    first = results.controllers[0]
    times = [f"{ratio:g} times" for ratio in figures.RATIOS[1:]]
    head = ("controller", f"smaller than {first}", *times, f"{first} over it, median")
    return Table(head, rows, range(1, len(head)))


def _interacting(found: Mapping[str, Sequence[Share]]) -> Table:
    """Return the total shares where they are estimable, on a full grid."""
    rows = [
        (controller, s.name, f"{s.first:.3f}", f"{s.total:.3f}")
        for controller, own in found.items()
        for s in own
        if np.isfinite(s.total)
    ]
    head = ("controller", "varied", "first order", "with interactions")
    return Table(head, rows, (2, 3))
