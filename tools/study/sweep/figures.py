"""The figures of a campaign: a metric's distribution, pairs, ratios, shares; and failures."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pcpc.executive.laws.units import unit_of_name
from pcpc.plants import pages
from pcpc.tools.after.log.drawing import plain_text
from pcpc.tools.study.arrays import Vector
from pcpc.tools.study.sweep.results import MARGIN, METRIC, VARY, Counts, Results, comparisons
from pcpc.tools.study.sweep.sensitivity import Share, shares

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure


COLOURS = (
    pages.BLUE,
    pages.VERMILION,
    pages.GREEN,
    pages.PURPLE,
    pages.ORANGE,
    pages.SKY,
    pages.BLACK,
)
STYLES = ("-", "--", ":")  # of controllers beyond the colours
RATIOS = (1.0, 2.3, 5.0)
LOG_FROM = 30.0  # an axis is logarithmic where its values span more
MOST_DOTS = 20_000  # of the scatter of a pair of controllers
MOST_STEPS = 2000  # of a drawn distribution: more than pixels
LINE_POINTS = 400  # of a line of equal ratio, which is curved on mixed axes
FEWEST_FOR_SHARES = 20  # runs
MOST_BARS = 12
WIDTH_IN, HEIGHT_IN, DPI = 8.4, 3.3, 110


def style_of(results: Results, controller: str) -> dict[str, Any]:
    """Return colour and line of a controller, the same in all figures."""
    i = results.controllers.index(controller)
    return {"color": COLOURS[i % len(COLOURS)], "linestyle": STYLES[i // len(COLOURS) % 3]}


def label_of(name: str) -> str:
    """Return the label of a column's axis, with its unit where the name ends in one."""
    unit = unit_of_name(name.removeprefix(METRIC).removeprefix(MARGIN).removeprefix(VARY))
    bare = name.removeprefix(METRIC).replace(MARGIN, "margin of ").removeprefix(VARY)
    return plain_text(f"{bare} [{unit.text}]" if unit else bare)


def page_of(results: Results, name: str, found: dict[str, list[Share]]) -> "Figure":
    """Return the figure of a metric or margin; `found`: its shares by controller."""
    pairs = [results.pairs(name, results.controllers[0], o) for o in results.controllers[1:]]
    drawn = [p for p in pairs if len(p[0])]
    positive = bool(drawn) and all(min(x.min(), y.min()) > 0.0 for x, y in drawn)
    panels: list[tuple[Any, ...]] = [(distribution, name)]
    if found:
        panels.append((bars, found))
    if drawn:
        panels.append((scatter, name, pairs, positive))
    if positive:
        panels.append((ratios, name, pairs))
    rows, columns = -(-len(panels) // 2), min(len(panels), 2)
    page, grid = pages.sheet((WIDTH_IN, HEIGHT_IN * rows), DPI, rows, columns, squeeze=False)
    for ax in grid.ravel()[len(panels) :]:
        ax.set_axis_off()
    for ax, (draw, *about) in zip(grid.ravel(), panels, strict=False):
        draw(ax, results, *about)
        pages.apply_grid_style(ax)
    return page


def _scale(*values: Vector) -> str:
    """Return `log` of values above 0 that span more than LOG_FROM."""
    told = np.concatenate([v[np.isfinite(v)] for v in values])
    wide = len(told) > 0 and told.min() > 0.0 and told.max() > LOG_FROM * told.min()
    return "log" if wide else "linear"


def _limits(values: Vector, scale: str) -> tuple[float, float]:
    """Return the range of an axis with a little room around its values."""
    low, high = float(values.min()), float(values.max())
    if scale == "log":
        room = (high / low) ** 0.05
        return low / room, high * room
    room = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return low - room, high + room


def distribution(ax: "Axes", results: Results, name: str) -> None:
    """Draw which share of all runs lies below a value; a curve ends below 1 where some told none.

    The legend counts the runs that told a value.
    """
    told = {c: results.values(name, c) for c in results.controllers}
    for controller, values in told.items():
        x = np.sort(values[np.isfinite(values)])
        y = np.arange(1, len(x) + 1) / max(len(values), 1)
        label = plain_text(f"{controller or 'runs'}: {len(x):,} of {len(values):,}")
        kept = np.unique(np.linspace(0, len(x) - 1, MOST_STEPS).astype(int))[: len(x)]
        x, y = np.append(x[:1], x[kept]), np.append(0.0 * y[:1], y[kept])  # from 0 up
        ax.plot(
            x,
            y,
            drawstyle="steps-post",
            label=label,
            linewidth=1.2,
            **style_of(results, controller),
        )
    ax.set_xscale(_scale(*told.values()))
    if name.startswith(MARGIN):
        ax.axvline(0.0, color=pages.GREY, linewidth=0.9)
        ax.set_title("left of 0: violated", fontsize=8, loc="right")
    ends = ax.get_xlim()
    if ax.get_xscale() == "log":
        _plain_ticks(ax.xaxis, *ends)
    ax.set_ylim(0.0, 1.02)
    _words(ax, label_of(name), "share of runs up to it")


def _words(ax: "Axes", x: str, y: str, loc: Any = "best") -> None:
    ax.set_xlabel(x, fontsize=9)
    ax.set_ylabel(y)
    ax.legend(frameon=False, fontsize=7, loc=loc)


def ratio_line(low: float, high: float, times: float) -> tuple[Vector, Vector]:
    """Return a dense line y = x/times over low..high > 0, smooth on linear and log axes alike.

    Both (n,).
    """
    x = np.union1d(np.linspace(low, high, LINE_POINTS), np.geomspace(low, high, LINE_POINTS))
    return x, x / times


def scatter(
    ax: "Axes",
    results: Results,
    name: str,
    pairs: Sequence[tuple[Vector, Vector]],
    positive: bool,
) -> None:
    """Draw each other controller against the first, run by run on the same draw.

    Below a line of ratio r the first is more than r times larger; only the line of equality where
    a value is not above 0. `pairs`: each (n,).
    """
    x, y = (np.concatenate(part) for part in zip(*pairs, strict=True))
    scale = _scale(x, y)  # one: two hide how far the values are apart
    (left, right), bottom_top = _limits(x, scale), _limits(y, scale)
    ax.set(xscale=scale, yscale=scale, xlim=(left, right), ylim=bottom_top)
    if scale == "log":
        _plain_ticks(ax.xaxis, left, right)
        _plain_ticks(ax.yaxis, *bottom_top)
    if positive:
        for r, line in zip(RATIOS, ("-", "--", ":"), strict=True):
            start = max(left, 1e-3 * right)
            ax.plot(
                *ratio_line(start, right, r),
                color=pages.GREY,
                linewidth=0.9,
                linestyle=line,
                label="equal" if r == 1.0 else f"{r:g} times",
                zorder=3,
            )
    else:
        ax.plot((left, right), (left, right), color=pages.GREY, linewidth=0.9, label="equal")
    size = min(12.0, max(2.0, 600.0 / math.sqrt(len(x) or 1) / 3.0))
    for other, (a, b) in zip(results.controllers[1:], pairs, strict=True):
        colour = style_of(results, other)["color"]
        label = other if len(a) <= MOST_DOTS else f"{other}: {MOST_DOTS:,} of {len(a):,} pairs"
        ax.scatter(
            a[:MOST_DOTS],
            b[:MOST_DOTS],
            s=size,
            color=colour,
            alpha=0.6,
            linewidths=0,
            label=plain_text(label),
        )
    first, label = plain_text(results.controllers[0]), label_of(name)
    _words(ax, f"{first}: {label}", f"the other: {label}")


def ratios(ax: "Axes", results: Results, name: str, pairs: Sequence[tuple[Vector, Vector]]) -> None:
    """Draw how often the first controller's value is so many times the other's.

    `pairs`: each (n,).
    """
    base = results.controllers[0]
    quotients = [x / y for x, y in pairs]
    low = min(0.95, *(float(q.min()) for q in quotients if len(q)))
    high = max(1.05, *(float(q.max()) for q in quotients if len(q)))
    count = int(np.clip(math.sqrt(max(len(q) for q in quotients)), 8, 40))
    bins = np.geomspace(low * 0.999, high * 1.001, count + 1)
    for (other, told, smaller, _), q in zip(
        comparisons(results, name, RATIOS), quotients, strict=True
    ):
        label = f"{other}: smaller in {smaller[0]:,} of {told:,}"
        ax.hist(
            q,
            bins.tolist(),
            histtype="step",
            label=plain_text(label),
            linewidth=1.2,
            **style_of(results, other),
        )
    for r in RATIOS:
        if low < r < high:
            ax.axvline(r, color=pages.GREY, linewidth=0.9, linestyle="-" if r == 1.0 else "--")
    ax.set_xscale("log")
    _plain_ticks(ax.xaxis, low, high)
    ax.margins(y=0.3)
    _words(ax, f"{plain_text(base)} over the other, same draw", "pairs", loc="upper right")


def _plain_ticks(axis: "Axis", low: float, high: float) -> None:
    """Write 0.5, 1, 2, 5 at a logarithmic axis that spans little, and only powers of 10 else."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

    axis.set_minor_formatter(NullFormatter())
    if high < 100.0 * low:
        decades = [10.0**e for e in range(math.floor(math.log10(low)), math.ceil(math.log10(high)))]
        for steps in ((1.0, 1.5, 2.0, 3.0, 5.0, 7.0), (1.0, 2.0, 5.0)):
            within = [m * ten for ten in [*decades, 10.0 * decades[-1]] for m in steps]
            within = [tick for tick in within if low <= tick <= high]
            if len(within) <= 6:
                break
        axis.set_major_locator(FixedLocator(within))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())


def shares_of(results: Results, name: str) -> dict[str, list[Share]]:
    """Return the shares of the variations by controller, of those with enough runs that vary."""
    found = {}
    for controller in results.controllers if results.variations else ():
        y = results.values(name, controller)
        if np.count_nonzero(np.isfinite(y)) >= FEWEST_FOR_SHARES and np.nanvar(y) > 0.0:
            own = shares(results.variations, results.varied_values(controller), y)
            if any(math.isfinite(one.first) for one in own):
                found[controller] = own
    return found


def bars(ax: "Axes", results: Results, found: dict[str, list[Share]]) -> None:
    """Draw first-order shares with their intervals; the variations that count most on top."""
    of = {controller: {share.name: share for share in own} for controller, own in found.items()}
    names = sorted(
        results.variations,
        key=lambda name: -np.nanmax([own[name].first for own in of.values()] + [-1.0]),
    )
    kept = names[:MOST_BARS]
    thick = 0.8 / len(found)
    for i, (controller, own) in enumerate(of.items()):
        first, high = np.array([(own[name].first, own[name].high) for name in kept]).T
        at = np.arange(len(kept)) + (i - (len(found) - 1) / 2.0) * thick
        ax.barh(
            at,
            np.maximum(first, 0.0),
            thick,
            label=plain_text(controller or "runs"),
            color=style_of(results, controller)["color"],
        )
        ax.errorbar(first, at, xerr=high - first, fmt="none", ecolor=pages.BLACK, elinewidth=0.8)
    ax.set_yticks(range(len(kept)), [_short(name) for name in kept])
    ax.invert_yaxis()
    ax.set_xlim(0.0, 1.0)
    rest = f"; {len(names) - len(kept)} more below these" if len(names) > len(kept) else ""
    ax.set_xlabel(f"first-order share of the variance, 95 %{rest}", fontsize=9)
    if len(found) > 1:
        ax.legend(frameon=False, fontsize=7, loc="lower right")


def _short(name: str) -> str:
    """Return the end of a name, which says most of it, where it is long."""
    return plain_text(name if len(name) <= 24 else f"...{name[-21:]}")


def failures_page(results: Results, rows: Sequence[tuple[str, str, Counts]]) -> "Figure":
    """Return the figure of failure probabilities: rows of (what, controller, counts).

    The axis is logarithmic; no failure is a line from its left end to the bound. Of no run that was
    judged nothing is drawn.
    """
    page, ax = pages.sheet((WIDTH_IN, 0.9 + 0.27 * len(rows)), DPI)
    spans = [found.interval(0.95) if found.runs else (0.0, 1.0) for *_, found in rows]
    ends = [high for _, high in spans] + [low for low, _ in spans if low > 0.0]
    left = min(0.3 * min(ends), 0.1)
    for i, ((_, controller, found), (low, high)) in enumerate(zip(rows, spans, strict=True)):
        failures, runs, unjudged = found
        colour = style_of(results, controller)["color"]
        if runs:
            ax.plot((max(low, left), high), (i, i), color=colour, linewidth=2.0)
        if failures:
            ax.plot(failures / runs, i, "o", color=colour, markersize=5, clip_on=False, zorder=3)
        elif runs:
            ax.plot(high, i, "|", color=colour, markersize=9, clip_on=False)
        left_out = f", {unjudged:,} not judged" if unjudged else ""
        ax.annotate(
            f"{failures:,} of {runs:,}{left_out}" if runs else "not judged",
            (1.0, i),
            xycoords=("axes fraction", "data"),
            xytext=(7, 0),
            textcoords="offset points",
            fontsize=7,
            va="center",
        )
    names = [f"{what}, {controller}" if controller else what for what, controller, *_ in rows]
    ax.set_yticks(range(len(rows)), [plain_text(name) for name in names])
    ax.set(xscale="log", xlim=(left, 1.0), ylim=(len(rows) - 0.5, -0.5))
    _plain_ticks(ax.xaxis, left, 1.0)
    ax.set_xlabel("probability of failure, 95 % interval (Clopper-Pearson)", fontsize=9)
    pages.apply_grid_style(ax)
    return page
