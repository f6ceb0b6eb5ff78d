"""What the figures of all plants share: a page of axes above each other, of runs of any length."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pcpc.executive.log.long_logs import LongLog
from pcpc.executive.log.reader import Log
from pcpc.plants.judging import Measure, Run, Signal, Vector, measured, stretches
from pcpc.plants.statistics import PEAK

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito's colours, which colour-blind readers tell apart
BLACK, BLUE, VERMILION, GREEN = "#000000", "#0072B2", "#D55E00", "#009E73"
ORANGE, PURPLE, SKY = "#E69F00", "#CC79A7", "#56B4E9"
GREY, SHADE = "#707070", "#ECEFF3"
POINTS = 3000  # of a drawn line: more than pixels
SMALLEST_LATE_US = 1.0  # on the logarithmic axis
TITLE_LETTERS = 60  # of 13 point across the page


@dataclass(frozen=True)
class Line:
    """A drawn signal: `NODE:NAME` of a recorded variable, or a function of the run."""

    source: str | Signal
    label: str
    colour: str = BLUE
    width: float = 1.1
    style: str = "-"

    def values(self, run: Run) -> Vector:
        """Return what to draw."""
        return run.named(self.source) if isinstance(self.source, str) else self.source(run)


@dataclass(frozen=True)
class Panel:
    """Axes of a page: label with unit, lines, relative height."""

    label: str
    lines: Sequence[Line]
    height: float = 5.0


def new_page(panels: Sequence[float], title: str, text: str) -> tuple[Any, Any]:
    """Return a page of 1200 x 1500 pixels and its axes; ImportError, with the cure."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise ImportError("a figure needs matplotlib: pip install 'pcpc[plot]'") from None
    page = Figure(figsize=(8.0, 10.0), dpi=150)
    axes = page.subplots(len(panels), 1, sharex=True, height_ratios=panels, squeeze=False)[:, 0]
    page.subplots_adjust(left=0.1, right=0.975, top=0.9, bottom=0.05, hspace=0.24)
    size = 13.0 * min(1.0, TITLE_LETTERS / max(len(title), 1))  # a longer one would run off
    page.text(0.018, 0.985, title, size=size, weight="bold", va="top")
    page.text(0.018, 0.96, text, size=8, va="top", linespacing=1.5)
    return page, axes


def draw_page(
    log: Log, path: Path, title: str, text: str, window_s: tuple[float, float],
    panels: Sequence[Panel],
) -> None:  # fmt: skip
    """Write one PNG: `panels` above each other, below them how late a paced executive woke.

    `text`: the two lines under the title. The window is shaded. Raises ImportError, with the cure,
    where matplotlib is not installed.
    """
    there = "executive" in log.node and len(log.node["executive"].cycle) > 0
    clocked = there and was_clocked(log)
    heights = [panel.height for panel in panels]
    page, axes = new_page([*heights, 3.0] if clocked else heights, title, text)
    end_s = window_s[1]
    if there:
        period_s = 1e-9 * float(log.metadata["executive"]["period_ns"])
        end_s = period_s * (int(log.node["executive"].cycle[-1]) + 1)
        lines = [line for panel in panels for line in panel.lines]
        drawn = iter(traces(log, period_s, [line.values for line in lines]))
        for ax, panel in zip(axes, panels, strict=False):
            for line in panel.lines:
                style: dict[str, Any] = {"linewidth": line.width, "linestyle": line.style}
                draw_line(ax, *next(drawn), line.label, line.colour, **style)
        if clocked:
            draw_lateness(axes[-1], period_s, log)
    labels = [*(panel.label for panel in panels), "wake-up [us]"]
    for ax, label in zip(axes, labels, strict=False):
        ax.set_ylabel(label)
        dress(ax, window_s)
    axes[-1].set_xlabel("time [s]")
    axes[0].set_xlim(0.0, end_s)
    page.align_ylabels(axes)
    page.savefig(path, format="png")


def thinned(t: Vector, y: Vector, points: int = POINTS) -> tuple[Vector, Vector]:
    """Return a line of about `points` points that shows the lowest and highest of every piece."""
    size = -(-len(y) // (points // 2))
    if size <= 2:
        return t, y
    whole = len(y) // size * size
    pieces = y[:whole].reshape(-1, size)
    first = np.arange(0, whole, size)
    low = first + np.where(np.isnan(pieces), math.inf, pieces).argmin(axis=1)
    high = first + np.where(np.isnan(pieces), -math.inf, pieces).argmax(axis=1)
    kept = np.unique(np.concatenate((low, high, np.arange(whole, len(y)))))
    return t[kept], y[kept]


def traces(log: Log, period_s: float, signals: Sequence[Signal]) -> list[tuple[Vector, Vector]]:
    """Return time and values of each signal over the whole run; of a long one enough to draw."""
    if not isinstance(log, LongLog):
        run = Run(log, period_s)
        return [(run.t_s, signal(run)) for signal in signals]
    found: list[list[tuple[Vector, Vector]]] = [[] for _ in signals]
    points = max(POINTS * log.part_cycles // max(len(log.node["executive"].cycle), 1), 8)
    for run, own in stretches(log, period_s, "executive"):
        for pieces, signal in zip(found, signals, strict=True):
            pieces.append(thinned(run.t_s[own], signal(run)[own], points))
    return [
        (np.concatenate([t for t, _ in pieces]), np.concatenate([y for _, y in pieces]))
        for pieces in found
    ]


def draw_line(ax: "Axes", t: Vector, y: Vector, label: str, colour: str, **style: Any) -> None:
    """Draw a signal where there is one."""
    if np.isfinite(y).any():
        ax.plot(*thinned(t, y), color=colour, label=label, **{"linewidth": 1.1, **style})


_LATE = "timing.wake_late_us"


def was_clocked(log: Log) -> bool:
    """Return whether the executive woke by a clock."""
    if _LATE not in log.node["executive"].timing:
        return False
    return measured(log, 1.0, {"late": Measure(_late, PEAK)})["late"] > 0.0


def _late(run: Run) -> Vector:
    return run.log.node["executive"].timing[_LATE]


def draw_lateness(ax: "Axes", period_s: float, log: Log) -> None:
    """Draw how late a paced executive woke up."""

    def late_us(run: Run) -> Vector:
        return np.maximum(_late(run), SMALLEST_LATE_US)

    def after(name: str) -> Signal:
        def marks(run: Run) -> Vector:
            count = run.log.node["executive"].timing.get(f"health.{name}_cycles")
            if count is None:
                return np.full(len(run.cycle), math.nan)
            begin = 0.0 if run.first_row == 0 else count[0]
            return np.where(np.diff(count, prepend=begin) > 0, late_us(run), math.nan)

        return marks

    late, *marked = traces(log, period_s, [late_us, after("late"), after("skipped")])
    draw_line(ax, *late, "wake-up behind the deadline", BLUE, linewidth=0.6)
    for (t, y), name, what, mark in zip(
        marked, ("late", "skipped"), ("late", "after a skip"), ("x", "v"), strict=True
    ):
        there = np.isfinite(y)
        if there.any():
            count = log.node["executive"].timing[f"health.{name}_cycles"]
            label = f"{what} ({int(count[-1])})"
            ax.plot(t[there], y[there], mark, color=VERMILION, markersize=5, label=label)
    ax.set_yscale("log")


def dress(ax: "Axes", window_s: tuple[float, float]) -> None:
    """Shade the window, give axes their grid, their legend above them."""
    ax.axvspan(*window_s, color=SHADE, linewidth=0, zorder=0)
    ax.grid(color="#D0D0D0", linewidth=0.5)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(labelsize=8)
    ax.yaxis.label.set_fontsize(9)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(
            loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=4, frameon=False, fontsize=8,
            borderaxespad=0.0, handlelength=1.8,
        )  # fmt: skip
    else:
        ax.set_yticks([])
        ax.text(0.5, 0.5, "not in this log", transform=ax.transAxes, color=GREY, ha="center")
