"""What the figures of several studies have in common."""

from collections.abc import Iterable, Sequence
from typing import Any

REFERENCE: dict[str, Any] = {"color": "#000000", "linestyle": "--"}


def page(size: tuple[float, float], dpi: float, *shape: int, **more: Any) -> tuple[Any, Any]:
    """Return a figure and its axes, in rows and columns where there are such."""
    from matplotlib.figure import Figure  # takes longer than a study's tables

    made = Figure(figsize=size, dpi=dpi, layout="constrained")
    return made, made.subplots(*shape, **more)


def dress(axes: Iterable[Any], ticks: float = 0.0, below: bool = False, **grid: Any) -> None:
    """Draw a light grid, `below` bars too, and no frame; `ticks`: the size of their numbers."""
    for ax in axes:
        ax.grid(**{"color": "#D0D0D0", "linewidth": 0.5, **grid})
        if below:
            ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
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
