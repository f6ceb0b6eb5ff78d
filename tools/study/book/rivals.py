"""`pcpc experiment rivals`: which law of the barrel wins where, plants/atb1000/book/rivals.py.

Writes results.md (tables with paired intervals, a margin beside each law), results.csv, a figure.
"""

from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.plants.atb1000.book import rivals
from pcpc.tools.start.pool import each
from pcpc.tools.study.experiment.cli import write_csv
from pcpc.tools.study.experiment.runs import case_results
from pcpc.tools.study.margin.book.tuning import margin
from pcpc.tools.terminal.extras import need
from pcpc.tools.terminal.progress import Progress


def run(folder: Path, progress: Progress, jobs: int | None) -> int:
    """Run all laws on all scenarios and plants; NOT_MET if a run failed."""
    need("rivals needs", "scipy.stats")
    margins = dict(zip(rivals.LAWS, each(margin, rivals.LAWS, progress, jobs), strict=True))
    results = case_results(list(rivals.cases()), progress, jobs)
    write_csv(results, folder / "results.csv")
    failed = [result for result in results if result.failed]
    for one in failed:
        progress.say(f"{one.case.controller} on {one.case.rig}: {one.failed}")
    if failed:
        what = f"{len(failed)} of {len(results)} runs failed, see results.csv"
        (folder / "results.md").write_text(f"# Laws of the barrel against each other\n\n{what}\n")
        return Exit.NOT_MET
    figures = folder / "figures"
    figures.mkdir(exist_ok=True)
    rivals.draw(results, figures / "rivals.png")
    text = f"# Laws of the barrel against each other\n\n{rivals.report(results, margins)}"
    (folder / "results.md").write_text(text)
    return Exit.OK
