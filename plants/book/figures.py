"""What the figures of several studies have in common."""

from collections.abc import Iterable, Sequence
from typing import Any

from pcpc.plants.pages import bare

REFERENCE: dict[str, Any] = {"color": "#000000", "linestyle": "--"}


def dress(axes: Iterable[Any], ticks: float = 0.0, below: bool = False, **grid: Any) -> None:
    """Draw a light grid, `below` bars too, and no frame; `ticks`: the size of their numbers."""
    for ax in axes:
        bare(ax, **{"color": "#D0D0D0", **grid})
        if below:
            ax.set_axisbelow(True)
        if ticks:
            ax.tick_params(labelsize=ticks)


def name_rows(axes: Any, labels: Sequence[str], below: str = "") -> None:
    """Label each row on its left and, with `below`, each column below its last axes."""
    for row, label in zip(axes, labels, strict=True):
        row[0].set_ylabel(label)
    for ax in axes[-1] if below else ():
        ax.set_xlabel(below)


def legend_below(figure: Any, ax: Any, columns: int, size: float = 9) -> None:
    """Write the legend of `ax` below all axes."""
    handles, names = ax.get_legend_handles_labels()
    figure.legend(
        handles, names, frameon=False, fontsize=size, ncols=columns, loc="outside lower center"
    )
