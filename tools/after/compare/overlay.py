"""Old below new in one picture: the panels of the rig's evaluation, else what differs most."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.log.reader import LogError
from pcpc.plants.judging import Judged
from pcpc.plants.pages import Panel, draw_line, dress, new_page, traces
from pcpc.tools.after.compare.pair import CHANGED, Pair, compare
from pcpc.tools.after.log.drawing import DPI, DrawnLog, page_of
from pcpc.tools.after.log.series import all_series, start_ns
from pcpc.tools.after.record import Run
from pcpc.tools.after.verdict.judge import Judge, guarded
from pcpc.tools.terminal.outfile import new_file

_AXES = 6
_OLD, _NEW = "#B4B4B4", "#0072B2"


@dataclass(frozen=True)
class Criteria:
    """How runs are compared, and the folder for the figures of what changed, if there is one."""

    tolerance: float = 0.0
    figures: Path | None = None


def compared_pair(old: Path, new: Path, how: Criteria) -> Pair:
    """Compare two logs, and draw them if they differ; LogError."""
    runs = Run(old), Run(new)
    pair = compare(*runs, how.tolerance)
    if how.figures is not None and pair.state == CHANGED:
        name = _free_name(how.figures, f"{pair.rig}-{pair.controller}")
        if _draw(*runs, pair, how.figures / name):
            pair.figure = name
    return pair


def _free_name(folder: Path, text: str) -> str:
    """Return the name of a figure that is not there yet: a folder may hold a rig's runs."""
    stem = re.sub(r"[^\w.-]+", "-", text)
    names = (f"{stem}{'' if n == 1 else f'-{n}'}.png" for n in count(1))
    return next(name for name in names if not (folder / name).exists())


def _draw(old: Run, new: Run, pair: Pair, path: Path) -> bool:
    """Write a picture, old in grey below new; return False if there is nothing to draw."""
    try:
        judge = Judge.of(new.rig)
        panels, section = judge.evaluation.panels, judge.given
        if panels:
            runs = [
                judge.evaluation.judged(run.log, section.window_s, section.numbers, run.period_s)
                for run in (old, new)
            ]
            guarded(lambda: _panels(runs, panels, pair.name, path))
            return True
    except (LogError, UserError):
        pass  # an evaluation that is not there, or does not fit the older run
    return _signals(old, new, pair, path)


def _panels(runs: Sequence[Judged], panels: Sequence[Panel], title: str, path: Path) -> None:
    """Draw the panels of an evaluation."""
    end_s = 0.0
    page, axes = new_page([panel.height for panel in panels], title, "grey: old; colours: new")
    for number, judged in enumerate(runs):
        drawn = iter(traces(judged, [line for panel in panels for line in panel.lines]))
        for ax, panel in zip(axes, panels, strict=True):
            for line in panel.lines:
                t, y = next(drawn)
                end_s = max(end_s, float(np.max(t, initial=0.0)))
                style = {"linewidth": line.width, "linestyle": line.style}
                if number == 0:
                    draw_line(ax, t, y, "", _OLD, **{**style, "linewidth": 2.0 * line.width})
                else:
                    draw_line(ax, t, y, line.label, line.colour, **style)
    for ax, panel in zip(axes, panels, strict=True):
        ax.set_ylabel(panel.label)
        dress(ax, runs[1].windows["window"])
    axes[-1].set_xlabel("time [s]")
    axes[0].set_xlim(0.0, end_s)
    with new_file(path, force=True) as unfinished:
        page.savefig(unfinished, format="png")


def _signals(old: Run, new: Run, pair: Pair, path: Path) -> bool:
    """Draw the signals that differ most."""
    sources = [
        DrawnLog(name, run.log, all_series(run.log), start_ns(run.log))
        for name, run in (("old", old), ("new", new))
    ]
    names = [signal.name for signal in pair.outside[:_AXES]]
    if not names:
        return False
    page = page_of(sources, [[name] for name in names], colours=(_OLD, _NEW))
    with new_file(path, force=True) as unfinished:
        page.savefig(unfinished, dpi=DPI, format="png")
    return True
