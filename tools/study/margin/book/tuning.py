"""`pcpc experiment tuning`: the gains of the barrel's laws by one rule, atb1000/book/tuning.py.

Writes tuning.csv (every candidate with its score, its chatter and its margin), results.md (ranges,
what was chosen) and a figure.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.atb1000.book import tuning
from pcpc.plants.atb1000.book.tuning import RANGES, Candidate
from pcpc.plants.study import markdown
from pcpc.tools.start.pool import each
from pcpc.tools.study.experiment.runs import case_results
from pcpc.tools.study.margin.commands import Question
from pcpc.tools.terminal.extras import need
from pcpc.tools.terminal.progress import Progress

SETTLE_S = 20.0  # a network that still learns the weight is no loop at rest


def run(folder: Path, progress: Progress, jobs: int | None) -> int:
    """Run all candidates, choose; NOT_MET if a law has none that is allowed."""
    need("tuning needs", "scipy.stats")
    results = case_results(list(tuning.cases()), progress, jobs)
    asked = [(law, i) for law in RANGES for i in range(tuning.CANDIDATES + 1)]
    progress.say("margins of all candidates")
    margins = dict(zip(asked, each(margin_of, asked, progress, jobs), strict=True))
    found = tuning.rows(results, margins)
    tuning.write(found, folder / "tuning.csv")
    figures = folder / "figures"
    figures.mkdir(exist_ok=True)
    draw(found, figures / "tuning.png")
    (folder / "results.md").write_text(f"# Tuning of the barrel's laws\n\n{report(found)}")
    without = [law for law in RANGES if tuning.choice(found, law) is None]
    for law in without:
        progress.say(f"{law}: no candidate is allowed")
    return Exit.NOT_MET if without else Exit.OK


def margin_of(asked: tuple[str, int]) -> float:
    """Return the disk margin of a candidate (law, number); 0 of a loop that is not stable."""
    law, number = asked
    return margin(law, tuning.settings(tuning.candidates(law)[number]))


def margin(controller: str, settings: Sequence[str] = ()) -> float:
    """Return the disk margin of a controller on the linear barrel; 0 of a loop not stable."""
    from pcpc.tools.study.margin import find  # numba

    linear = f"@{tuning.RIGS.with_name('linear.yaml')}"
    rig = load_rig(tuning.RIGS / "sin0.5.yaml", controller, [linear, *settings])
    method: Any = "measured" if controller in tuning.MEASURED else "linearised"
    about = Question(method=method, amplitude=tuning.AMPLITUDE_NM, settle_s=SETTLE_S)
    try:
        return float(find.margin_of(rig, about).disk_margin)
    except UserError:
        return 0.0


def report(found: Sequence[Candidate]) -> str:
    """Return the tables: the ranges, what was chosen."""
    ranges = [
        [law, ", ".join(f"{name} {low:g} to {high:g}" for name, (_, low, high) in own.items())]
        for law, own in RANGES.items()
    ]
    head = ("law", "by hand", "chosen", "gains", "step, N m", "disk margin", "allowed")
    lines = []
    for law in RANGES:
        own = [row for row in found if row.law == law]
        best, count = tuning.choice(found, law), sum(row.allowed for row in own)
        line = [law, f"{own[0].score:.3f}" + ("" if own[0].allowed else " (not allowed)")]
        if best is not None:
            gains = ", ".join(f"{name} {value:g}" for name, value in best.gains.items())
            line += [f"{best.score:.3f}", gains, f"{best.step_Nm:.2g}", f"{best.margin:.2f}"]
        lines.append([*line, *[""] * (6 - len(line)), f"{count} of {len(own)}"])
    return (
        f"{markdown(('law', 'ranges'), ranges)}\nScores relative to pd; allowed are a step of at "
        f"most {tuning.STEP_NM:g} N m and a disk margin of\nat least {tuning.MARGIN:g}.\n\n"
        f"{markdown(head, lines)}"
    )


def draw(found: Sequence[Candidate], path: Path) -> None:
    """Draw score over margin, a panel a law; hollow: not allowed."""
    from matplotlib.figure import Figure

    columns = 4
    high = -(-len(RANGES) // columns)
    page = Figure(figsize=(11.0, 2.4 * high), layout="constrained")
    axes = page.subplots(high, columns, sharex=True, sharey=True)
    for ax, law in zip(axes.flat, RANGES, strict=False):
        own = [row for row in found if row.law == law and np.isfinite(row.score)]
        for row in own:
            face = "#0072b2" if row.allowed else "none"
            ax.plot(row.margin, row.score, "o", markersize=4, color="#0072b2", mfc=face)
        for one, mark in ((own[0], "s"), (tuning.choice(found, law), "*")):
            if one is not None:
                ax.plot(one.margin, one.score, mark, markersize=11, color="#d55e00", mfc="none")
        ax.axvline(tuning.MARGIN, color="k", linestyle=":", linewidth=0.8)
        ax.set_title(law, fontsize=10)
        ax.set_yscale("log")
        ax.grid(alpha=0.3)
    for ax in axes.flat[len(RANGES) :]:
        ax.set_axis_off()
    page.supxlabel("disk margin")
    page.supylabel("error relative to pd")
    page.suptitle("candidates: hollow not allowed, square by hand, star chosen", fontsize=11)
    page.savefig(path, dpi=110)
