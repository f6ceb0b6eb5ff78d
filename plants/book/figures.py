"""What the figures of several studies have in common: columns of runs, rows of panels."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from pcpc.plants.pages import Line, Panel, bare, sheet
from pcpc.plants.study import CaseResult

NONE: Mapping[str, str] = {}
REFERENCE: dict[str, Any] = {"color": "#000000", "linestyle": "--"}
SHADE: dict[str, Any] = {"color": "#F3E8D2", "linewidth": 0, "zorder": 0}
LEGEND: dict[str, Any] = {"fontsize": 8, "ncols": 3, "loc": "upper right", "framealpha": 0.9}


class Traces(Protocol):
    """What the source of a line takes values of: the traces of a result, or a whole run."""

    def __getitem__(self, name: str, /) -> Any:
        """Return the values of a name."""


Source = str | Callable[[Traces], Any]


def reference(source: Source, label: str = "reference", width: float = 0.9) -> Line:
    """Return the line of what is wanted."""
    return Line(source, label, REFERENCE["color"], width, REFERENCE["linestyle"])


def times(scale: float, name: str) -> Callable[[Traces], Any]:
    """Return what gives a trace in another unit."""
    return lambda traces: scale * traces[name]


def overlay(
    ax: Any, runs: Iterable[CaseResult], source: Source, colours: Mapping[str, str], width: float,
    names: Mapping[str, str] | None = None,
) -> None:  # fmt: skip
    """Draw a trace of runs over time, a colour a controller, of those that have a colour."""
    for run in runs:
        law = run.case.controller
        if law in colours:
            line = Line(source, names[law] if names else law, colours[law], width)
            draw_lines(ax, [line], run.traces)


def draw_lines(ax: Any, lines: Iterable[Line], traces: Mapping[str, Any], **look: Any) -> None:
    """Draw the lines of a run; `look`: of all, such as the colour of those that have none.

    A line's source is the name of a trace, and left out where the run has none, or a function of
    the traces; its style may be that of a step.
    """
    for line in lines:
        source: Any = line.source
        values = source(traces) if callable(source) else traces.get(source)
        if values is not None:
            steps = line.style.startswith("steps")
            options = {"linewidth": line.width, "label": line.label}
            options |= {"color": line.colour} if line.colour else {}
            options |= {"drawstyle": line.style} if steps else {}
            ax.plot(traces["t"], values, "-" if steps else line.style, **{**look, **options})


def columns(
    runs: Sequence[CaseResult],
    panels: Sequence[Panel],
    limits: Sequence[tuple[float, float] | None],
    size_in: tuple[float, float],
    title: Callable[[CaseResult], str],
    colours: Mapping[str, str] = NONE,
    below: Callable[[Any, CaseResult], None] | None = None,
    until_s: float | None = None,
    left: float = 0.0,
    dpi: float = 120,
    markersize: float | None = None,
    **how: Any,
) -> tuple[Any, Any]:
    """Return a figure of a column a run and a row a panel, over time, and its axes.

    `limits`: of each row; `title`: of a column; `left`: its size on the left; `colours`: of lines
    without one, by label or controller; `below` draws into a column before its lines.
    """
    look = {"fontsize": left, "loc": "left"} if left else {"fontsize": 10}
    heights = [panel.height for panel in panels]
    how = {"sharex": True, "height_ratios": heights, "squeeze": False, **how}
    figure, axes = sheet(size_in, dpi, len(panels), len(runs), **how)
    for column, run in zip(axes.T, runs, strict=True):
        column[0].set_title(title(run), **look)
        if below:
            below(column, run)
        colour = colours.get(run.case.label, colours.get(run.case.controller))
        for ax, panel, ends in zip(column, panels, limits, strict=True):
            draw_lines(ax, panel.lines, run.traces, color=colour, markersize=markersize)
            if ends:
                ax.set_ylim(*ends)
    name_rows(axes, [panel.label for panel in panels], "time [s]")
    if until_s:
        axes[0, 0].set_xlim(0.0, until_s)
    return figure, axes


def legends(axes: Iterable[Any], **how: Any) -> None:
    """Write the legend of each axes that has a named line."""
    for ax in axes:
        if ax.get_legend_handles_labels()[1]:
            ax.legend(**{**LEGEND, **how})


def save(figure: Any, path: Path, title: str = "", size: float = 12) -> None:
    """Write a figure with its title."""
    if title:
        figure.suptitle(title, fontsize=size)
    figure.savefig(path)


def dress(axes: Iterable[Any], ticks: float = 0.0, below: bool = False, **grid: Any) -> None:
    """Draw a light grid, `below` bars too, and no frame; `ticks`: the size of their numbers."""
    for ax in axes:
        bare(ax, **{"color": "#D0D0D0", **grid})
        if below:
            ax.set_axisbelow(True)
        if ticks:
            ax.tick_params(labelsize=ticks)


def name_rows(axes: Any, labels: Sequence[str], below: str = "") -> None:
    """Label each row on its left and, with `below`, each column below its last axes."""
    for row, label in zip(axes, labels, strict=True):
        row[0].set_ylabel(label)
    for ax in axes[-1] if below else ():
        ax.set_xlabel(below)


def legend_below(figure: Any, ax: Any, columns: int, size: float = 9) -> None:
    """Write the legend of `ax` below all axes."""
    handles, names = ax.get_legend_handles_labels()
    figure.legend(
        handles, names, frameon=False, fontsize=size, ncols=columns, loc="outside lower center"
    )
