"""Small experiments side by side: a picture of all, and a table of what each is compared with."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import Exit
from pcpc.plants.pages import bare, sheet
from pcpc.plants.study import markdown
from pcpc.tools.terminal.progress import Progress

Row = tuple[str, str, str]  # what, as computed, what is exact


def gallery(
    folder: Path,
    progress: Progress,
    name: str,
    title: str,
    head: Row,
    panels: Iterable[Callable[[Any], list[Row] | None]],
    size_in: tuple[float, float],
    rows: int,
    letters: float,
) -> int:
    """Write figures/NAME.png, of so many `rows`, and results.md; return 0.

    A panel draws into its axes and returns rows of the table. `letters`: size in the legends.
    """
    draws = list(panels)
    figures = folder / "figures"
    figures.mkdir()
    page, axes = sheet(size_in, 110, rows, len(draws) // rows)
    found: list[Row] = []
    for ax, draw in zip(axes.flat, draws, strict=True):
        found += draw(ax) or []
        bare(ax)
        ax.legend(frameon=False, fontsize=letters, loc="best")
    page.savefig(figures / f"{name}.png")
    (folder / "results.md").write_text(f"# {title}\n\n{markdown(head, found)}")
    progress.close()
    return Exit.OK
