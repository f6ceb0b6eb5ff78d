"""The figures of the chains' study: a law beside another, both chains."""

from collections.abc import Sequence
from pathlib import Path

from pcpc.plants.book.figures import REFERENCE, dress, name_rows
from pcpc.plants.pages import BLUE, GREEN, GREY, sheet
from pcpc.plants.study import Result

COLOURS = {"a": BLUE, "b": GREEN}
TITLES = {
    "pd": "PD",
    "fuzzy": "PD with fuzzy precompensators",
    "pd_slow": "PD",
    "nn": "inversion with networks",
}


def draw_pair(pair: Sequence[Result], path: Path) -> None:
    """Draw newest states and inputs of both chains, a column a law."""
    figure, axes = sheet((11.0, 8.0), 110, 4, 2, sharex=True, sharey="row")
    for column, result in enumerate(pair):
        traces = result.traces
        for i, chain in enumerate("ab"):
            state, inputs = axes[2 * i : 2 * i + 2, column]
            x_d, x3 = traces[f"executive:reference_{chain}.now"], traces[f"plant:chains.{chain}_x3"]
            state.plot(traces["t"], x_d, linewidth=1.2, label="$x_d$", **REFERENCE)
            state.plot(traces["t"], x3, color=COLOURS[chain], linewidth=1.0, label="$x_3$")
            command = traces[f"executive:controller.{chain}_command"]
            inputs.plot(traces["t"], command, color=GREY, linewidth=0.6, label="command")
            tau = traces[f"plant:chains.{chain}_tau"]
            inputs.plot(traces["t"], tau, color=COLOURS[chain], linewidth=0.9, label="tau")
            rms = result.metric(f"error_{chain}_rms")
            state.set_title(
                f"chain {chain}, {TITLES[result.case.controller]}: rms {rms:.4f}", size=10
            )
            state.set_ylim(-1.3, 1.3)
            inputs.set_ylim(-0.7, 0.7)
    names = ("x3 of a", "input of a", "x3 of b", "input of b")
    name_rows(axes, [f"{name} (no unit)" for name in names], "time [s]")
    for ax in axes.flat:
        ax.legend(fontsize=8, loc="upper right", ncols=2, framealpha=0.9)
    dress(axes.flat, 8)
    figure.savefig(path)
