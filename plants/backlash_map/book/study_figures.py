"""The figures of the map's study: laws side by side, and the command from step to step."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pcpc.plants.book.figures import REFERENCE, dress, name_rows
from pcpc.plants.pages import BLUE, GREEN, GREY, ORANGE, VERMILION, sheet
from pcpc.plants.study import Result

NAMES = {
    "pd without gap": "PD, no gap",
    "pd": "PD",
    "nn_sigmoid": "network, smooth nodes only",
    "nn": "network with jump nodes",
}
COLOURS = {"pd without gap": GREEN, "pd": VERMILION, "nn_sigmoid": ORANGE, "nn": BLUE}
LEGEND: dict[str, Any] = {"fontsize": 8, "loc": "upper right", "ncols": 2, "framealpha": 0.9}
MILLI = 1e3


def draw_laws(results: Sequence[Result], path: Path) -> None:
    """Draw state, error and tau, a column a law; the errors' scales differ."""
    made, axes = sheet((13.0, 7.2), 120, 3, len(results), sharex=True)
    for column, result in enumerate(results):
        tr, label = result.traces, result.case.label
        t, colour = tr["t"], COLOURS[label]
        x_d, x2 = tr["executive:reference.now"], tr["plant:map.x2"]
        top, middle, bottom = axes[:, column]
        rms, largest = result.metric("error_rms"), result.metric("error_max")
        top.set_title(f"{NAMES[label]}\n10 to 20 s: rms {rms:.4f}, max {largest:.3f}", size=10)
        top.plot(t, x_d, linewidth=1.4, label="$x_d$", **REFERENCE)
        top.plot(t, x2, color=colour, linewidth=1.0, label="$x_2$")
        settled = t >= 0.5
        middle.plot(t[settled], (x2 - x_d)[settled], color=colour, linewidth=0.8)
        tau, tau_d = tr["plant:map.tau"], tr["executive:controller.tau_d"]
        bottom.plot(t, tau_d, linewidth=1.4, label="desired", **REFERENCE)
        bottom.plot(t, tau, color=colour, linewidth=0.8, label="behind the gap")
        top.set_ylim(-1.2, 1.9)
        bottom.set_ylim(-0.15, 0.22)
        for ax in (top, bottom):
            ax.legend(**LEGEND)
    names = ("state (no unit)", "error $x_2 - x_d$ from 0.5 s on", "tau (no unit)")
    name_rows(axes, names, "time [s]")
    dress(axes.flat, 8)
    axes[0, 0].set_xlim(0.0, 20.0)
    made.savefig(path)


def draw_steps(result: Result, path: Path) -> None:
    """Draw the violent start, and 40 steps of the command long after it, each step a mark."""
    made, axes = sheet((10.0, 6.4), 120, 2, 2, sharex="col")
    tr = result.traces
    t_ms = MILLI * tr["t"]
    for column, (begin, end) in enumerate(((0.0, 100.0), (900.0, 940.0))):
        part = (t_ms >= begin) & (t_ms <= end)
        top, bottom = axes[:, column]
        top.plot(t_ms[part], tr["executive:reference.now"][part], label="$x_d$", **REFERENCE)
        top.plot(t_ms[part], tr["plant:map.x2"][part], color=BLUE, linewidth=1.0, label="$x_2$")
        marks = {"marker": "o", "markersize": 2.5, "linewidth": 0.6}
        bottom.plot(
            t_ms[part], tr["plant:map.acting"][part], color=GREY, label="command u", **marks
        )
        bottom.plot(t_ms[part], tr["plant:map.tau"][part], color=BLUE, label="tau", **marks)
        for ax in (top, bottom):
            ax.legend(**LEGEND)
    axes[0, 1].set_ylim(-0.2, 1.4)
    axes[1, 1].set_ylim(-0.1, 0.55)
    axes[0, 0].set_title("the start, from 1 away", size=10)
    axes[0, 1].set_title("900 ms later: u jumps across the gap, tau does not see it", size=10)
    name_rows(axes, ("state (no unit)", "u and tau (no unit)"), "time [ms]; a step is 1 ms")
    dress(axes.flat, 8)
    made.savefig(path)
