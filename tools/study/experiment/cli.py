"""`pcpc experiment NAME`: a whole study in virtual time, on all processors.

    chapterN           every plants/*/book/study.py of that chapter of the book, see plants/study.py
    PATH/study.py      one such file, wherever it lies
    any other name     the module of tools/study/book: what needs no rig

Writes results.md, figures/ and, for studies of rigs, results.csv into a new folder.
"""

import csv
import importlib
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

from pcpc import plants
from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.own_laws.law_errors import cause
from pcpc.executive.own_laws.modules import module_of, own_streams
from pcpc.plants.study import CaseResult
from pcpc.tools.start.folder import folder_of
from pcpc.tools.start.pool import PoolError
from pcpc.tools.study.experiment.commands import ExperimentRequest
from pcpc.tools.study.experiment.runs import case_results
from pcpc.tools.terminal.ending import writing
from pcpc.tools.terminal.extras import FIGURE, need
from pcpc.tools.terminal.progress import Progress

_STUDY = Path(__file__).resolve().parents[1]
ONLY_IN_THE_REPOSITORY = (
    "those of the book are in the repository of pcpc only; here it takes a study.py"
)
STUDY_PARTS = ("CHAPTER", "TITLE", "cases", "report", "draw")


class StudyError(UserError):
    """A file that is no study."""


def write_csv(results: Sequence[CaseResult], path: Path) -> None:
    """Write one line a result: group, rig, label, settings and all metrics."""
    names = sorted({name for result in results for name in result.metrics})
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(("group", "rig", "controller", "label", "settings", "ended_early", *names))
        for result in results:
            case = result.case
            values = [f"{result.metrics[n]:.6g}" if n in result.metrics else "" for n in names]
            first = (case.group, Path(case.rig).stem, case.controller, case.label)
            rows.writerow((*first, " ".join(case.settings), str(result.diverged), *values))


def names() -> list[str]:
    """Return what can be given as NAME: chapters with a study, modules of tools/study/book."""
    chapters = {f"chapter{study.CHAPTER}" for study in studies()}
    return sorted((*chapters, *without_rigs()))


def without_rigs() -> dict[str, str]:
    """Return the studies of the book that need no rig, by name: their modules."""
    book = (file for file in _STUDY.glob("**/book/[a-z]*.py"))
    places = {file.stem: file.relative_to(_STUDY).with_suffix("") for file in book}
    return {name: f"pcpc.tools.study.{'.'.join(place.parts)}" for name, place in places.items()}


def studies() -> list[ModuleType]:
    """Return the studies of the project's plants, by folder."""
    files = sorted(Path(plants.__file__).parent.glob("*/book/study.py"))
    return [importlib.import_module(f"pcpc.plants.{file.parts[-3]}.book.study") for file in files]


def chosen_studies(name: str) -> list[ModuleType]:
    """Return the studies of a chapter or of a file; none for another name.

    StudyError: a file that is not a study.
    """
    if not name.endswith(".py"):
        return [study for study in studies() if f"chapter{study.CHAPTER}" == name]
    with study_errors(), own_streams():
        module = module_of("", Path(name).resolve())
    absent = [part for part in STUDY_PARTS if not hasattr(module, part)]
    if absent:
        raise StudyError(f"{name}: no {', '.join(absent)}; plants/study.py shows what it needs")
    return [module]


@contextmanager
def study_errors() -> Iterator[None]:
    """Tell what a study's code raises in a line, with its place: StudyError."""
    try:
        yield
    except (UserError, OSError):
        raise
    except (Exception, SystemExit) as error:
        raise StudyError(cause(error)) from None


def run_studies(
    parts: Sequence[ModuleType], folder: Path, progress: Progress, jobs: int | None
) -> int:
    """Run the cases of all studies, write tables and figures; NOT_MET if a run failed."""
    with study_errors():
        cases = [(study, case) for study in parts for case in study.cases()]
    if not cases:
        raise StudyError(f"{parts[0].__file__}: cases() has no run; expected one at least")
    results = case_results([case for _, case in cases], progress, jobs)
    write_csv(results, folder / "results.csv")
    figures = folder / "figures"
    figures.mkdir()
    texts = []
    for study in parts:
        own = [result for (of, _), result in zip(cases, results, strict=True) if of is study]
        progress.say(f"tables and figures: {study.TITLE}")
        with study_errors():
            texts.append(f"# {study.TITLE}\n\n{study.report(own)}")
            study.draw(own, figures)
    (folder / "results.md").write_text("\n".join(texts))
    failed = [result for result in results if result.failed]
    progress.close()
    for result in failed:
        print(f"{result.case.label} on {result.case.rig}: {result.failed}", file=sys.stderr)
    return Exit.NOT_MET if failed else Exit.OK


def command(request: ExperimentRequest) -> int:
    """Run the experiment `request.name`; NOT_MET if a run failed. StudyError: wrong input."""
    name = request.name
    if not (Path(name).is_file() if name.endswith(".py") else name in names()):
        known = ", ".join(names())
        cure = f"; expected {known}, or a study.py" if known else f"; {ONLY_IN_THE_REPOSITORY}"
        raise StudyError(f"{name}: no such experiment{did_you_mean(name, names()) or cure}")
    if request.jobs is not None and request.jobs < 1:
        raise StudyError(f"--jobs {request.jobs}: expected 1 or more")
    need(f"{name}: its figures need", FIGURE)
    parts = chosen_studies(name)
    with folder_of(request.output, Path(name).stem, empty=True) as folder:
        return _run_in(folder, parts, request)


def _run_in(folder: Path, parts: Sequence[ModuleType], request: ExperimentRequest) -> int:
    progress = Progress(request.quiet)
    try:
        with writing(folder):
            if parts:
                code = run_studies(parts, folder, progress, request.jobs)
            else:
                experiment = importlib.import_module(without_rigs()[request.name])
                code = int(experiment.run(folder, progress, request.jobs))
    except PoolError as error:
        raise PoolError(f"{request.name}: {error}") from None
    print(folder / "results.md")
    return code
