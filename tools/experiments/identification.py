"""`pcpc experiment identification`: what a log tells of a plant, and how sure.

    seeds      the nominal barrel fitted to 100 runs that differ in the sensors' noise alone

Writes results.md and figures/; returns 1 where fewer than 95 of 100 intervals hold the true value.
"""

from pathlib import Path

from pcpc.tools.console.progress import Progress
from pcpc.tools.experiments import _identified_seeds as of_seeds
from pcpc.tools.starting.native import native
from pcpc.tools.starting.pool import each


def run(folder: Path, progress: Progress, jobs: int | None) -> int:
    """Run everything on `jobs` processes (all processors), write results.md and figures/."""
    todo = of_seeds.pieces()
    with native():
        done = each(_done, todo, progress, jobs, _runs)
    fits = [one for some in done for one in some]
    table, missed = of_seeds.table(fits)
    (folder / "results.md").write_text(f"# Identification\n\n{table}", "utf-8")
    (folder / "figures").mkdir()
    of_seeds.draw(fits, folder / "figures" / "seeds.png")
    for line in missed:
        progress.say(line)
    return 1 if missed else 0


def _done(piece: of_seeds.Seeds) -> list[of_seeds.Fitted]:
    return piece.done()


def _runs(piece: of_seeds.Seeds) -> int:
    return piece.runs
