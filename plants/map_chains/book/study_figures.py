"""The figures of the chains' study: a law beside another, both chains."""

from pathlib import Path

from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY
from pcpc.plants.study import Result

COLOURS = {"a": BLUE, "b": GREEN}
TITLES = {
    "pd": "PD",
    "fuzzy": "PD with fuzzy precompensators",
    "pd_slow": "PD",
    "nn": "inversion with networks",
}


def draw_pair(left: Result, right: Result, path: Path) -> None:
    """Draw newest states and inputs of both chains, a column a law."""
    from matplotlib.figure import Figure

    page = Figure(figsize=(11.0, 8.0), dpi=110, layout="constrained")
    axes = page.subplots(4, 2, sharex=True, sharey="row")
    for column, result in enumerate((left, right)):
        traces = result.traces
        for i, chain in enumerate("ab"):
            state, inputs = axes[2 * i : 2 * i + 2, column]
            x_d, x3 = traces[f"executive:reference_{chain}.now"], traces[f"plant:chains.{chain}_x3"]
            state.plot(traces["t"], x_d, color=BLACK, linewidth=1.2, linestyle="--", label="$x_d$")
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
    for ax, name in zip(
        axes[:, 0], ("x3 of a", "input of a", "x3 of b", "input of b"), strict=True
    ):
        ax.set_ylabel(f"{name} (no unit)")
    for ax in axes.flat:
        ax.legend(fontsize=8, loc="upper right", ncols=2, framealpha=0.9)
        ax.grid(color="#D0D0D0", linewidth=0.5)
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelsize=8)
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    page.savefig(path)
