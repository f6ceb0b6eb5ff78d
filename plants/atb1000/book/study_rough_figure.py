"""The figure of study_rough.py: what each part of the rougher world costs each law."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcpc.plants.pages import sheet

Vector = NDArray[np.float64]
LIMIT = 2.0  # of the colours; a cost beyond it is as red


def draw_costs(
    kinds: Sequence[str],
    laws: Sequence[str],
    table: Vector,
    errors: Sequence[Sequence[Vector]],
    path: Path,
) -> None:
    """Draw `table` (kinds, laws) of costs, and errors (without, with) of each law, mrad.

    Each of these errors: (barrels,).
    """
    figure, (left, right) = sheet((12, 4.8), 100, 1, 2, width_ratios=(1.5, 1.0))
    shown = np.clip(np.log2(table), -np.log2(LIMIT), np.log2(LIMIT))
    left.imshow(shown, cmap="RdBu_r", vmin=-1.0, vmax=1.0, aspect="auto")
    for (row, at), value in np.ndenumerate(table):
        shade = "white" if abs(shown[row, at]) > 0.7 else "black"
        left.text(at, row, f"{value:.2f}", ha="center", va="center", fontsize=9, color=shade)
    left.set_xticks(range(len(laws)), laws, fontsize=9, rotation=30, ha="right")
    left.set_yticks(range(len(kinds)), kinds, fontsize=9)
    left.axhline(len(kinds) - 1.5, color="k", linewidth=1.5)
    left.set_title("muzzle error over that without: 95 % of the barrels stay below", fontsize=10)
    for side, (of_laws, colour, label) in enumerate(
        zip(errors, ("#0072b2", "#d55e00"), ("without", "with all of it"), strict=True)
    ):
        y = np.arange(len(laws)) + 0.2 * (2 * side - 1)
        low, middle, high = np.array([np.percentile(one, (5, 50, 95)) for one in of_laws]).T
        right.hlines(y, low, high, color=colour, linewidth=2.0)
        right.plot(middle, y, "o", color=colour, label=label)
    right.set_yticks(range(len(laws)), laws, fontsize=9)
    right.invert_yaxis()
    right.set_xscale("log")
    right.set_xticks((0.2, 0.5, 1.0, 2.0, 5.0), ("0.2", "0.5", "1", "2", "5"))
    right.minorticks_off()
    right.set_xlabel("muzzle error rms [mrad]: median, 5 to 95 %")
    right.grid(alpha=0.3)
    right.legend(frameon=False, fontsize=9)
    figure.savefig(path)
