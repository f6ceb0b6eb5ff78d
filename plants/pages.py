"""What the figures of all plants share: a page of axes above each other, of runs of any length."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pcpc.drivers.machine.packages import pip_install
from pcpc.executive.log.long_logs import LongLog
from pcpc.plants.judging import (
    RUN,
    WINDOW,
    Judged,
    Merit,
    Place,
    Run,
    Source,
    Vector,
    declared_at,
)
from pcpc.plants.statistics import PEAK, peak

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which colour-blind readers tell apart
BLACK, BLUE, VERMILION, GREEN = "#000000", "#0072B2", "#D55E00", "#009E73"
ORANGE, PURPLE, SKY = "#E69F00", "#CC79A7", "#56B4E9"
GREY, SHADE = "#707070", "#ECEFF3"
POINTS = 3000  # of a drawn line: more than pixels
SMALLEST_LATE_US = 1.0  # on the logarithmic axis
IN_SIGHT = 2.0  # times what is drawn
TOP = 0.9  # of the first axes, in a page
SWINGS = 150  # of a line: with more its dashes make a block
MOST_VIOLATIONS, NAME_LETTERS = 5, 50  # marked, and of a name beside its mark
TITLE_LETTERS = 60  # of 13 point across the page


@dataclass(frozen=True)
class Line:
    """A drawn source: a signal of the evaluation, a variable `NODE:NAME`, a function of the run."""

    source: Source
    label: str
    colour: str = BLUE
    width: float = 1.1
    style: str = "-"
    place: Place = field(default_factory=declared_at, init=False, compare=False)


@dataclass(frozen=True)
class Level:
    """A bound, drawn on both sides of 0; only named if it is far from the lines. NaN: none."""

    value: Callable[[Run], float]
    label: str
    colour: str = GREY


@dataclass(frozen=True)
class Panel:
    """Axes of a page: label with unit, lines, relative height; `when`: draw it only if true."""

    label: str
    lines: Sequence[Line]
    height: float = 5.0
    levels: Sequence[Level] = ()
    when: Callable[[Run], bool] | None = None
    place: Place = field(default_factory=declared_at, init=False, compare=False)


def _figure_class() -> type["Figure"]:
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise ImportError(f"a figure needs matplotlib: {pip_install('matplotlib')}") from None
    return Figure


def sheet(
    size_in: tuple[float, float], dpi: float, *shape: int, **how: Any
) -> tuple["Figure", Any]:
    """Return a figure that lays itself out, and axes as its `subplots`; ImportError, with the cure.

    `shape`: rows and columns.
    """
    page = _figure_class()(figsize=size_in, dpi=dpi, layout="constrained")
    return page, page.subplots(*shape, **how)


def new_page(panels: Sequence[float], title: str, text: str) -> tuple[Any, Any]:
    """Return a page of 1200 x 1500 pixels and its axes; ImportError, with the cure."""
    page = _figure_class()(figsize=(8.0, 10.0), dpi=150)
    axes = page.subplots(len(panels), 1, sharex=True, height_ratios=panels, squeeze=False)[:, 0]
    page.subplots_adjust(left=0.1, right=0.975, top=TOP, bottom=0.05, hspace=0.24)
    size = 13.0 * min(1.0, TITLE_LETTERS / max(len(title), 1))  # a longer one would run off
    page.text(0.018, 0.985, title, size=size, weight="bold", va="top")
    page.text(0.018, 0.96, text, size=8, va="top", linespacing=1.5)
    return page, axes


def draw_page(
    judged: Judged,
    path: Path | None,
    title: str,
    text: str,
    panels: Sequence[Panel],
    violations: Sequence[tuple[float, str]] = (),
) -> None:
    """Write one PNG: `panels` above each other, below them how late a paced executive woke.

    Without a `path` it is laid out only.

    `text`: the two lines under the title; `violations`: times to mark, s, and of what. The window
    is shaded. Raises ImportError, with the cure,
    where matplotlib is not installed.
    """
    log, window_s = judged.log, judged.windows[WINDOW]
    there = "executive" in log.node and len(log.node["executive"].cycle) > 0
    clocked = there and was_clocked(judged)
    shown = [p for p in panels if not there or p.when is None or p.when(judged.run())]
    heights = [panel.height for panel in shown]
    page, axes = new_page([*heights, 3.0] if clocked else heights, title, text)
    end_s = window_s[1]
    if there:
        end_s = judged.period_s * (int(log.node["executive"].cycle[-1]) + 1)
        drawn = iter(traces(judged, [line for panel in shown for line in panel.lines]))
        for ax, panel in zip(axes, shown, strict=False):
            draw_panel(ax, panel, [next(drawn) for _ in panel.lines], judged.run())
        if clocked:
            draw_lateness(axes[-1], judged)
        mark_tunings(axes, judged)
        mark_violations(axes, violations, end_s)
    for ax, label in zip(axes, [*(p.label for p in shown), "wake-up [us]"], strict=False):
        ax.set_ylabel(label)
        dress(ax, window_s)
    axes[-1].set_xlabel("time [s]")
    axes[0].set_xlim(0.0, end_s)
    page.align_ylabels(axes)
    if path is None:  # its ticks take most of the time, and are not of the evaluation's making
        for ax in axes:
            ax.set(xticks=[], yticks=[])
        page.draw_without_rendering()
    else:
        page.savefig(path, format="png")


def draw_panel(ax: "Axes", panel: Panel, drawn: Sequence[tuple[Vector, Vector]], run: Run) -> None:
    """Draw the lines, `drawn` as pairs (t, y) of shape (n,), and the levels."""
    for line, (t, y) in zip(panel.lines, drawn, strict=True):
        draw_line(ax, t, y, line.label, line.colour, linewidth=line.width, linestyle=line.style)
    largest = peak(np.concatenate([y for _, y in drawn]))
    for level in panel.levels:
        value = level.value(run)
        if math.isnan(value) or math.isnan(largest):
            continue
        style: dict[str, Any] = {"color": level.colour, "linewidth": 0.9, "linestyle": "--"}
        seen = value <= IN_SIGHT * largest
        for bound in (-value, value) if seen else ():
            ax.axhline(bound, **style)
        ax.plot([], [], label=f"{level.label} ±{value:g}{'' if seen else ', out of view'}", **style)


def mark_tunings(axes: Sequence["Axes"], judged: Judged) -> None:
    """Draw a line through all axes where parameters were tuned, and name them in the second."""
    tunings = judged.log.node["executive"].tunings
    for cycle in sorted({int(tuning["cycle"]) for tuning in tunings}):
        names = [tuning for tuning in tunings if tuning["cycle"] == cycle]
        words = ", ".join(f"{t['name']} = {t['value']:g}" for t in names[:2])
        for ax in axes:
            ax.axvline(cycle * judged.period_s, color=BLACK, linewidth=0.8, linestyle=":")
        axes[min(1, len(axes) - 1)].annotate(
            words,
            (cycle * judged.period_s, 0.04),
            xycoords=("data", "axes fraction"),
            fontsize=7,
            xytext=(3, 0),
            textcoords="offset points",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
        )


def mark_violations(
    axes: Sequence["Axes"], violations: Sequence[tuple[float, str]], end_s: float
) -> None:
    """Draw a line through all axes where requirements were first violated, named in the first."""
    marked = sorted(violations)[:MOST_VIOLATIONS]
    axes[0].figure.subplots_adjust(top=TOP - 0.0125 * len(marked))  # their names stand above
    for i, (time_s, name) in enumerate(marked):
        for ax in axes:
            ax.axvline(time_s, color=VERMILION, linewidth=0.9, linestyle="-.")
        words = name if len(name) <= NAME_LETTERS else f"{name[: NAME_LETTERS - 3]}..."
        right = time_s > end_s / 2.0  # of the middle: the words go left
        axes[0].annotate(
            f"violated: {words}",
            (time_s, 1.0),
            xycoords=("data", "axes fraction"),
            color=VERMILION,
            fontsize=7,
            xytext=(0, 14 + 9 * (len(marked) - 1 - i)),
            va="bottom",
            textcoords="offset points",
            ha="right" if right else "left",
        )


def thinned_line(t: Vector, y: Vector, points: int = POINTS) -> tuple[Vector, Vector]:
    """Return about `points` of the line y (n,) over t (n,): the extremes of every piece."""
    size = -(-len(y) // (points // 2))
    if size <= 2:
        return t, y
    full = len(y) // size * size
    pieces = y[:full].reshape(-1, size)
    first = np.arange(0, full, size)
    low = first + np.where(np.isnan(pieces), math.inf, pieces).argmin(axis=1)
    high = first + np.where(np.isnan(pieces), -math.inf, pieces).argmax(axis=1)
    kept = np.unique(np.concatenate((low, high, np.arange(full, len(y)))))
    return t[kept], y[kept]


def traces(judged: Judged, lines: Sequence[Line]) -> list[tuple[Vector, Vector]]:
    """Return (t, y), each (n,), of every line over the run; of a long one enough to draw."""
    cycles = max(len(judged.log.node["executive"].cycle), 1)
    points = cycles + 2
    if isinstance(judged.log, LongLog):
        points = max(POINTS * judged.log.part_cycles // cycles, 8)
    drawn: list[list[tuple[Vector, Vector]]] = [[] for _ in lines]
    for run, rows in judged.stretches("executive"):
        for pieces, line in zip(drawn, lines, strict=True):
            y = run.values(line.source, line.place)
            pieces.append(thinned_line(run.t_s[rows], y[rows], points))
    return [
        (np.concatenate([t for t, _ in pieces]), np.concatenate([y for _, y in pieces]))
        for pieces in drawn
    ]


def draw_line(ax: "Axes", t: Vector, y: Vector, label: str, colour: str, **style: Any) -> None:
    """Draw y (n,) over t (n,) if it has finite values; a fast line thin, without dashes."""
    if not np.isfinite(y).any():
        return
    look = {"linewidth": 1.1, "linestyle": "-", **style}
    if look["linestyle"] != "-" and _swings(y) > SWINGS:
        look |= {"linestyle": "-", "linewidth": 0.6, "alpha": 0.4}
    ax.plot(*thinned_line(t, y), color=colour, label=label, **look)


def _swings(y: Vector) -> int:
    """Return how often a line turns back."""
    up = np.diff(y[np.isfinite(y)])
    up = up[up != 0.0]
    return int(np.count_nonzero(up[1:] * up[:-1] < 0.0))


_LATE = "timing.wake_late_us"


def was_clocked(judged: Judged) -> bool:
    """Return whether the executive woke by a clock."""
    if _LATE not in judged.log.node["executive"].timing:
        return False
    return judged.measured({"late": Merit(PEAK, _late, RUN)})["late"] > 0.0


def _late(run: Run) -> Vector:
    return run.log.node["executive"].timing[_LATE]


def draw_lateness(ax: "Axes", judged: Judged) -> None:
    """Draw how late a paced executive woke up."""

    def late_us(run: Run) -> Vector:
        return np.maximum(_late(run), SMALLEST_LATE_US)

    def after(name: str) -> Line:
        def marks(run: Run) -> Vector:
            count = run.log.node["executive"].timing.get(f"health.{name}_cycles")
            if count is None:
                return np.full(len(run.cycle), math.nan)
            begin = 0.0 if run.first_row == 0 else count[0]
            return np.where(np.diff(count, prepend=begin) > 0, late_us(run), math.nan)

        return Line(marks, name)

    late, *marked = traces(judged, [Line(late_us, "late"), after("late"), after("skipped")])
    draw_line(ax, *late, "wake-up behind the deadline", BLUE, linewidth=0.6)
    for (t, y), name, words, mark in zip(
        marked, ("late", "skipped"), ("late", "after a skip"), ("x", "v"), strict=True
    ):
        there = np.isfinite(y)
        if there.any():
            count = judged.log.node["executive"].timing[f"health.{name}_cycles"]
            label = f"{words} ({int(count[-1])})"
            ax.plot(t[there], y[there], mark, color=VERMILION, markersize=5, label=label)
    ax.set_yscale("log")


def dress(ax: "Axes", window_s: tuple[float, float]) -> None:
    """Shade the window, give axes their grid, their legend above them."""
    ax.axvspan(*window_s, color=SHADE, linewidth=0, zorder=0)
    apply_grid_style(ax)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 0.97),
            ncols=4,
            frameon=False,
            fontsize=8,
            borderaxespad=0.0,
            handlelength=1.8,
        )
    else:
        ax.set_yticks([])
        ax.text(0.5, 0.5, "not in this log", transform=ax.transAxes, color=GREY, ha="center")


def apply_grid_style(ax: "Axes") -> None:
    """Give axes their grid, no frame above and beside, and small letters."""
    bare(ax, color="#D0D0D0")
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=8)
    ax.yaxis.label.set_fontsize(9)


def bare(ax: "Axes", **grid: Any) -> None:
    """Give axes a thin grid, and no frame above and beside."""
    ax.grid(**{"color": "#D8D8D8", "linewidth": 0.5, **grid})
    ax.spines[["top", "right"]].set_visible(False)
