"""Pictures of variables over time: an axis a group, no spike lost between two pixels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log import reader as logs
from pcpc.plants.pages import bare, sheet
from pcpc.tools.after.log import series
from pcpc.tools.after.log.series import Series
from pcpc.tools.terminal.extras import FIGURE, need

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH_IN, _AXIS_IN, _REST_IN, DPI = 12.0, 1.7, 0.9, 110
_PIXELS = 1100  # of an axis, about
_LONGEST_NAME = 60  # characters
_MOST_NAMES = 4  # of logs in the title
Vector = NDArray[np.float64]
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#000000", "#CC79A7", "#E69F00", "#56B4E9", "#707070")


@dataclass(frozen=True)
class DrawnLog:
    """One log; `name` is what the legend calls it."""

    name: str
    log: logs.Log
    series: dict[str, Series]
    start_ns: int

    def inside(self, name: str, window_s: tuple[float, float]) -> NDArray[np.bool_]:
        """Return which values of a variable lie in a window. Shape (n,)."""
        t = 1e-9 * (self.series[name].time_ns - self.start_ns)
        return np.asarray((t >= window_s[0]) & (t < window_s[1]))


def decimated(t: Vector, y: Vector, pixels: int = _PIXELS) -> tuple[Vector, Vector]:
    """Return first, last, lowest and highest point of each of `pixels` equal parts of `t`.

    `t`, `y` (n,), `t` ascending. NaN is neither lowest nor highest.
    """
    if len(t) <= 4 * pixels:
        return t, y
    edges = np.linspace(t[0], t[-1], pixels + 1)[:-1]
    first = np.unique(np.searchsorted(t, edges))
    last = np.append(first[1:], len(t)) - 1
    part = np.repeat(np.arange(len(first)), last - first + 1)
    by_value = np.lexsort((y, part))  # NaN comes last
    finite = np.maximum(np.add.reduceat(~np.isnan(y), first, dtype=np.int64), 1)
    low, high = by_value[first], by_value[first + finite - 1]
    kept = np.unique(np.concatenate((first, low, high, last)))
    return t[kept], y[kept]


def page_of(
    sources: Sequence[DrawnLog],
    groups: Sequence[Sequence[str]],
    window_s: tuple[float, float] = series.EVER_S,
    colours: Sequence[str] = _COLOURS,
) -> "Figure":
    """Return a figure with an axis for each group of names; UserError without matplotlib.

    One source: lines by variable. Several: by source, and the variable stands above its axis.
    """
    need("a picture needs", FIGURE)
    height = _REST_IN + (_AXIS_IN if len(groups) > 1 else 2 * _AXIS_IN) * len(groups)
    page, column = sheet((_WIDTH_IN, height), 100, len(groups), sharex=True, squeeze=False)
    axes, by_log = column[:, 0], len(sources) > 1
    for ax, names in zip(axes, groups, strict=True):
        drawn = False
        for i, name in enumerate(names):
            for number, source in enumerate(sources):
                if name in source.series:
                    label, line = (source.name, number) if by_log else (name, i)
                    style = {"label": plain_text(label), "color": colours[line % len(colours)]}
                    drawn = _draw(ax, source, name, window_s, style) or drawn
        if not drawn:
            ax.text(0.5, 0.5, "no value", transform=ax.transAxes, ha="center", color="#707070")
        one = next(source.series[names[0]] for source in sources if names[0] in source.series)
        unit = series.label(one.unit)
        ax.set_ylabel(plain_text(unit), fontsize=8)
        if by_log:
            ax.set_title(plain_text(names[0]), fontsize=8, loc="left", pad=2)
        bare(ax)
        ax.tick_params(labelsize=8)
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)
    axes[-1].set_xlabel("time [s]", fontsize=9)
    page.suptitle("   ".join(map(plain_text, _title(sources))), fontsize=10, x=0.01, ha="left")
    return page


def plain_text(text: str) -> str:
    """Return a name as matplotlib draws it: no formula, and no longer than an axis."""
    return (text if len(text) <= _LONGEST_NAME else f"{text[:_LONGEST_NAME]}...").replace(
        "$", r"\$"
    )


def _draw(
    ax: "Axes", source: DrawnLog, name: str, window_s: tuple[float, float], style: dict[str, Any]
) -> bool:
    """Draw one line; return False if it has no value."""
    one: Any = source.series[name]
    t, inside = 1e-9 * (one.time_ns - source.start_ns), source.inside(name, window_s)
    t, values = decimated(t[inside], one.values[inside])
    ax.plot(t, values, linewidth=1.0, **style)
    return bool(np.isfinite(values).any())


def _title(sources: Sequence[DrawnLog]) -> tuple[str, ...]:
    """Return what the logs are, as far as it is the same."""
    facts = [source.log.metadata[node] for source in sources for node in source.log.node]
    same = [
        next(iter(values))
        for key in ("rig", "controller", "pacing")
        if len(values := {fact.get(key, "") for fact in facts}) == 1
    ]
    names = [source.name for source in sources]
    names = names if len(names) <= _MOST_NAMES else [f"{len(names)} logs"]
    same = [word for word in dict.fromkeys(same) if word not in ("", "none", *names)]
    return ", ".join(names), *same
