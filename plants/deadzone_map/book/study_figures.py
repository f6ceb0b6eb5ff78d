"""The figures of the study: PD beside the fuzzy precompensator."""

from collections.abc import Sequence
from pathlib import Path

from pcpc.plants.book.figures import REFERENCE, dress, name_rows
from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, PURPLE, VERMILION, sheet
from pcpc.plants.study import Result

NAMES = {"pd": "PD", "fuzzy": "PD and fuzzy precompensator"}


def draw_beside(pair: Sequence[Result], path: Path) -> None:
    """Draw PD in the left column, the precompensator in the right."""
    figure, axes = sheet(
        (11.0, 9.5), 120, 4, 2, sharex=True, sharey="row", height_ratios=(4, 4, 4, 3)
    )
    for column, result in zip(axes.T, pair, strict=True):
        x, width = result.traces, result.settings["map.d"]
        t, xd, x2 = x["t"], x["executive:reference.now"], x["plant:map.x2"]
        column[0].plot(t, x2, color=BLUE, linewidth=1.2, label="x2")
        column[0].plot(t, xd, linewidth=0.9, label="reference", **REFERENCE)
        column[1].plot(t, x2 - xd, color=VERMILION, linewidth=1.1)
        band = {"color": "#F3E8D2", "linewidth": 0, "zorder": 0, "label": "deadzone of u"}
        column[2].axhspan(-width, width, **band)
        u, tau = x["executive:controller.command"], x["plant:map.tau"]
        column[2].step(t, u, where="post", color=GREEN, linewidth=1.0, label="command u")
        begin = t[1] - t[0]  # the plant's sample of t tells the input of the step that ends there
        column[2].step(
            t - begin, tau, where="post", color=BLACK, linewidth=0.9, label="behind the deadzone"
        )
        column[0].set_title(NAMES[result.case.controller], fontsize=11, loc="left")
        column[3].axhline(width, linewidth=0.9, label="true, both sides", **REFERENCE)
        for name, colour in (("plus", GREEN), ("minus", PURPLE)):
            learned = x.get(f"executive:controller.d_{name}")
            if learned is not None:
                sign = "positive" if name == "plus" else "negative"
                column[3].plot(t, learned, color=colour, linewidth=1.2, label=f"learned, {sign}")
    figure.suptitle(f"Second-order map behind a deadzone of half width {width:g}", fontsize=13)
    axes[3, 0].text(15.0, 0.5 * width, "PD learns no width", ha="center", color=GREY)
    name_rows(axes, ("x2", "x2 - reference", "input", "width"), "time [s]")
    axes[0, 0].set_ylim(-1.15, 1.6)
    axes[1, 0].set_ylim(-0.55, 0.55)  # the first error is -1 in both
    axes[2, 0].set_ylim(-0.55, 0.9)
    dress(axes.flat)
    axes[0, 0].set_xlim(0.0, 30.0)
    axes[3, 0].set_ylim(-0.02, 1.4 * width)
    for ax, place in zip(
        axes[(0, 2, 3), 1], ("upper right", "upper right", "lower right"), strict=True
    ):
        ax.legend(fontsize=8, ncols=3, loc=place, framealpha=0.9)
    figure.savefig(path)
