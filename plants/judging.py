"""What the evaluations of all plants share: the records of both nodes side by side, windows, pages.

A window holds the cycles k with from <= k T < to: a run as long as `to` ends with its last cycle.
The plant's record of the same instant belongs to an executive cycle: that of the same cycle where
no clock runs, else the newest one not stamped later; one older than 2 periods tells nothing.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from numpy.typing import NDArray

from executive.logs import Log

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]

OLDEST_PERIODS = 2.0  # a paced plant's record is up to 1 period old, and later by its jitter
EDGE_PERIODS = 1e-6  # rounding of a window's edge

# Okabe and Ito's colours, which colour-blind readers tell apart
BLACK, BLUE, VERMILION, GREEN = "#000000", "#0072B2", "#D55E00", "#009E73"
ORANGE, PURPLE, SKY = "#E69F00", "#CC79A7", "#56B4E9"
GREY, SHADE = "#707070", "#ECEFF3"
POINTS = 3000  # of a drawn line: more than pixels
SMALLEST_LATE_US = 1.0  # on the logarithmic axis
TITLE_LETTERS = 60  # of 13 point across the page


def plant_rows(log: Log, period_s: float) -> NDArray[np.int64]:
    """Return the row of the plant's record that belongs to each executive cycle; -1 for none."""
    executive, plant = log.node["executive"], log.node.get("plant")
    if plant is None or not len(plant.cycle):
        return np.full(len(executive.cycle), -1, np.int64)
    ours, theirs, oldest = executive.stamp_ns, plant.stamp_ns, 1e9 * OLDEST_PERIODS * period_s
    if log.metadata.get("executive", {}).get("pacing") in ("lockstep", "virtual"):
        ours, theirs, oldest = executive.cycle, plant.cycle, 0.0
    rows = np.searchsorted(theirs, ours, side="right").astype(np.int64) - 1
    return np.where((rows >= 0) & (ours - theirs[rows] <= oldest), rows, -1)


def between(cycle: NDArray[np.int64], period_s: float, begin_s: float, end_s: float) -> Mask:
    """Return which cycles are in the window [begin, end)."""
    first, past = np.ceil(np.array((begin_s, end_s)) / period_s - EDGE_PERIODS)
    return (cycle >= first) & (cycle < past)


@dataclass(frozen=True)
class Run:
    """A run by executive cycle; its columns are (n,), NaN where the log does not tell."""

    log: Log
    period_s: float

    @cached_property
    def cycle(self) -> NDArray[np.int64]:
        """The cycles of the executive."""
        return self.log.node["executive"].cycle

    @cached_property
    def t_s(self) -> Vector:
        """Time of the cycles."""
        return np.asarray(self.cycle * self.period_s, np.float64)

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """The plant's row of each cycle, see `plant_rows`."""
        return plant_rows(self.log, self.period_s)

    def executive(self, name: str) -> Vector:
        """Return a variable of the executive."""
        found = self.log.node["executive"].columns.get(name)
        return np.full(len(self.cycle), math.nan) if found is None else found

    def plant(self, name: str) -> Vector:
        """Return a variable of the plant at the executive's cycles."""
        node = self.log.node.get("plant")
        found = None if node is None else node.columns.get(name)
        if found is None or not len(found):
            return np.full(len(self.cycle), math.nan)
        return np.where(self.rows < 0, math.nan, found[self.rows])

    def named(self, name: str) -> Vector:
        """Return `executive:NAME` or `plant:NAME`."""
        node, _, variable = name.partition(":")
        return self.executive(variable) if node == "executive" else self.plant(variable)

    def between(self, begin_s: float, end_s: float) -> Mask:
        """Return which cycles are in the window [begin, end)."""
        return between(self.cycle, self.period_s, begin_s, end_s)

    def setting(self, name: str) -> float:
        """Return a setting of the controller, else of the plant; NaN if unknown."""
        return setting(self.log, name)


def setting(log: Log, name: str) -> float:
    """Return a setting of the controller, else of the plant, from the log's rig; NaN if unknown."""
    rig = _rig(log)
    laws = [rig.get("controllers", {}).get(rig.get("controller"), {})]
    laws += rig.get("plant", {}).get("blocks", {}).values()
    values = (law["parameters"][name] for law in laws if name in law.get("parameters", {}))
    return float(next(values, math.nan))


def _rig(log: Log) -> dict[str, Any]:
    """Return the effective rig; {} if the log has none."""
    texts = [text for file, text in log.attachments.items() if file.endswith("rig-resolved.yaml")]
    return _parsed(texts[0]) if texts else {}


@lru_cache(maxsize=4)  # every metric asks
def _parsed(rig: str) -> Any:
    return yaml.load(rig, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))


# Figures of merit


def over_finite(values: Vector, statistic: Callable[[Vector], Any]) -> float:
    """Return the statistic of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    with np.errstate(over="ignore"):  # of a run that diverged
        return float(statistic(finite)) if finite.size else math.nan


def rms(values: Vector) -> float:
    """Return the root of the mean square."""
    return math.sqrt(over_finite(values, lambda v: np.mean(v * v)))


def peak(values: Vector) -> float:
    """Return the largest magnitude."""
    return over_finite(values, lambda v: np.max(np.abs(v)))


def known(figures: Mapping[str, float]) -> dict[str, float]:
    """Return the figures without those that are NaN."""
    return {name: value for name, value in figures.items() if not math.isnan(value)}


# Pages


@dataclass(frozen=True)
class Line:
    """A drawn signal: `executive:NAME`, `plant:NAME`, or a function of the run."""

    source: str | Callable[[Run], Vector]
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
        run = Run(log, 1e-9 * float(log.metadata["executive"]["period_ns"]))
        end_s = float(run.t_s[-1]) + run.period_s
        for ax, panel in zip(axes, panels, strict=False):
            for line in panel.lines:
                style = {"linewidth": line.width, "linestyle": line.style}
                draw_line(ax, run.t_s, line.values(run), line.label, line.colour, **style)
        if clocked:
            draw_lateness(axes[-1], run.t_s, log)
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


def draw_line(ax: "Axes", t: Vector, y: Vector, label: str, colour: str, **style: Any) -> None:
    """Draw a signal where there is one."""
    if np.isfinite(y).any():
        ax.plot(*thinned(t, y), color=colour, label=label, **{"linewidth": 1.1, **style})


def was_clocked(log: Log) -> bool:
    """Return whether the executive woke by a clock."""
    late_us = log.node["executive"].timing.get("timing.wake_late_us")
    return late_us is not None and bool(late_us.any())


def draw_lateness(ax: "Axes", t: Vector, log: Log) -> None:
    """Draw how late a paced executive woke up."""
    timing = log.node["executive"].timing
    late_us = np.maximum(timing["timing.wake_late_us"], SMALLEST_LATE_US)
    draw_line(ax, t, late_us, "wake-up behind the deadline", BLUE, linewidth=0.6)
    for name, what, mark in (("late", "late", "x"), ("skipped", "after a skip", "v")):
        count = timing.get(f"health.{name}_cycles", np.zeros(len(t)))
        more = np.diff(count, prepend=0.0) > 0
        if more.any():
            label = f"{what} ({int(count[-1])})"
            ax.plot(t[more], late_us[more], mark, color=VERMILION, markersize=5, label=label)
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
