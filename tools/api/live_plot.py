"""`live.plot`: variables of a running rig over its last seconds, moving in a notebook.

Every cycle is drawn, or at least its part in the envelope of what a line can show: rows are taken
from the rings beside the recorder (`executive.nodes.tap`), so that the loop does nothing for it.
Drawing takes at most a third of this process's time.
"""

import io
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.tap import Tap
from pcpc.plants.pages import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    apply_grid_style,
    sheet,
)
from pcpc.tools.after.log.drawing import decimated, plain_text
from pcpc.tools.after.log.series import label
from pcpc.tools.after.record import Figure, UnknownName
from pcpc.tools.live.history import History
from pcpc.tools.terminal.extras import FIGURE, need

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = (BLUE, VERMILION, GREEN, BLACK, PURPLE, ORANGE, SKY)
PlottedVariable = tuple[str, Live, str]  # a name as it was asked for, its node, its name there
_POLL_S = 0.02
_SHARE = 3  # of the time, for a drawing
_WIDTH_IN, _AXIS_IN, _REST_IN, _DPI, _PIXELS = 8.0, 1.6, 0.6, 90, 600


class LivePlot:
    """The last seconds of variables, and their picture."""

    def __init__(self, asked: Sequence[PlottedVariable], window_s: float) -> None:
        need("a plot needs", FIGURE)
        self._variables, self._window_s = asked, window_s
        nodes = {id(node): node for _, node, _ in asked}
        self._taps = {key: Tap(node) for key, node in nodes.items()}
        for name, node, variable in asked:
            if variable not in (recorded := self._taps[id(node)].names):
                what = f"{name}: not recorded, so it cannot be plotted"
                raise UnknownName(f"{what}{did_you_mean(variable, recorded)}")
        if not window_s > 0.0:
            raise UserError(f"window_s={window_s:g}: expected more than 0")
        self._past = {
            key: History(
                max(round(1e9 * window_s / node.period_ns), 2), len(self._variables_of(key))
            )
            for key, node in nodes.items()
        }
        units = {name: node.variables[variable].unit for name, node, variable in asked}
        groups = list(dict.fromkeys(units.values()))
        height = _REST_IN + _AXIS_IN * max(len(groups), 2)
        shape = len(groups), 1
        self._page, axes = sheet((_WIDTH_IN, height), _DPI, *shape, sharex=True, squeeze=False)
        self._axes: list[Axes] = list(axes[:, 0])
        self._lines: Mapping[str, Any] = {}
        for ax, unit in zip(self._axes, groups, strict=True):
            own = [name for name, text in units.items() if text == unit]
            self._lines |= {
                name: ax.plot(
                    [], [], color=COLOURS[i % len(COLOURS)], linewidth=1.1, label=plain_text(name)
                )[0]
                for i, name in enumerate(own)
            }
            ax.set_ylabel(label(unit))
            apply_grid_style(ax)
            ax.legend(loc="upper left", framealpha=0.8, edgecolor="none", fontsize=8)
        self._axes[-1].set_xlabel("time [s]")

    def _variables_of(self, key: int) -> list[str]:
        return [variable for _, node, variable in self._variables if id(node) == key]

    def look(self) -> None:
        """Take what the nodes have done since the last look."""
        for key, tap in self._taps.items():
            rows = tap.rows()
            if len(rows):
                places = [rows.places[variable] for variable in self._variables_of(key)]
                self._past[key].add(rows.cycle, rows.stamp_ns, rows.values[:, places])

    def picture(self) -> Figure:
        """Return what was seen last."""
        end_s = 0.0
        for name, node, variable in self._variables:
            past = self._past[id(node)]
            t_s = np.asarray(past.cycle * (1e-9 * node.period_ns), np.float64)
            values = past.values[:, self._variables_of(id(node)).index(variable)]
            last_s = float(t_s[-1]) if len(t_s) else 0.0
            within = t_s > last_s - self._window_s  # more of them come where cycles were skipped
            self._lines[name].set_data(*decimated(t_s[within], values[within], _PIXELS))
            end_s = max(end_s, last_s)
        for ax in self._axes:
            ax.relim()
            ax.autoscale_view(scalex=False)
        self._axes[0].set_xlim(max(end_s - self._window_s, 0.0), max(end_s, self._window_s))
        missed = sum(tap.missed["record"] for tap in self._taps.values())
        self._axes[0].set_title(f"{missed:,} cycles missed" if missed else "", fontsize=8)
        written = io.BytesIO()
        self._page.savefig(written, format="png")
        return Figure(written.getvalue())


def follow(
    moving: LivePlot, goes_on: Callable[[], bool], every_s: float, show: Callable[[Figure], None]
) -> Figure:
    """Show what moves until it does not go on, or on Ctrl-C; return the last picture."""
    try:
        while goes_on():
            begin_s = time.monotonic()
            moving.look()
            show(moving.picture())
            until_s = max(begin_s + every_s, begin_s + _SHARE * (time.monotonic() - begin_s))
            while time.monotonic() < until_s and goes_on():
                time.sleep(_POLL_S)
                moving.look()
    except KeyboardInterrupt:
        pass
    moving.look()
    last = moving.picture()
    show(last)
    return last


def notebook_display() -> Callable[[Figure], None]:
    """Return what shows a picture where the one before it stood; outside a notebook nothing."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if getattr(shell, "kernel", None) is None:
        return lambda picture: None
    from IPython.display import display

    handles: list[Any] = []

    def show(picture: Figure) -> None:
        if handles:
            handles[0].update(picture)
        else:
            handles.append(display(picture, display_id=True))

    return show
