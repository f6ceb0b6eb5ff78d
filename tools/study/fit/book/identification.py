"""`pcpc experiment identification`: what a log tells of a plant, and how sure.

    seeds      the nominal barrel fitted to 100 runs that differ in the sensors' noise alone
    structure  the same with a model of friction that is not the plant's
    network    Theorem 8.3.1: the telerobot's recurrent network as an identifier

Writes results.md and figures/; returns 1 where fewer than 95 of 100 intervals hold the true value.
"""

from pathlib import Path
from typing import Any

from pcpc.plants.telerobot.book import identified_network as of_network
from pcpc.tools.start.native import native
from pcpc.tools.start.pool import each
from pcpc.tools.study.fit.book import _identified_seeds as of_seeds
from pcpc.tools.study.fit.book import _identified_structure as of_structure
from pcpc.tools.terminal.progress import Progress

Piece = of_seeds.Seeds | of_structure.Structure | of_network.IdentifiedNetwork


def run(folder: Path, progress: Progress, jobs: int | None) -> int:
    """Run everything on `jobs` processes (all processors), write results.md and figures/."""
    todo: list[Piece] = [*of_structure.pieces(), *of_seeds.pieces(), of_network.IdentifiedNetwork()]
    with native():
        done = [one for some in each(_piece_results, todo, progress, jobs, _runs) for one in some]
    fits = [one for one in done if isinstance(one, of_seeds.SeedFit)]
    table, missed = of_seeds.table(fits)
    structure = of_structure.table([x for x in done if isinstance(x, of_structure.StructureFit)])
    network = of_network.table([x for x in done if isinstance(x, of_network.Identified)])
    text = "\n".join(("# Identification\n", table, structure, network))
    (folder / "results.md").write_text(text, "utf-8")
    (folder / "figures").mkdir()
    of_seeds.draw(fits, folder / "figures" / "seeds.png")
    for line in missed:
        progress.say(line)
    return 1 if missed else 0


def _piece_results(piece: Piece) -> list[Any]:
    return list(piece.done())


def _runs(piece: Piece) -> int:
    return piece.runs
