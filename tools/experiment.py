"""`pcpc experiment NAME`: a whole study in virtual time, on all processors.

    chapterN           every plants/*/study.py of that chapter of the book, see plants/study.py
    PATH/study.py      one such file, wherever it lies
    any other name     the module of tools/experiments: what needs no rig

Writes results.md, figures/ and, for studies of rigs, results.csv into a new folder.
"""

import argparse
import csv
import importlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pcpc import plants
from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.rig.law_errors import cause
from pcpc.executive.rig.modules import module_of, own_streams
from pcpc.plants.judging import Run
from pcpc.plants.study import Case, Result
from pcpc.tools.console.progress import Progress
from pcpc.tools.starting.pool import PoolError, each

if TYPE_CHECKING:
    from pcpc.executive.rig.reading import Rig

STUDY_PARTS = ("CHAPTER", "TITLE", "cases", "report", "draw")
TRACE_POINTS = 1500  # of a figure's line: more than its pixels


class StudyError(UserError):
    """A file that is no study."""


def run_case(case: Case) -> Result:
    """Run one case in virtual time in this process."""
    from pcpc.executive.errors import RigError
    from pcpc.executive.nodes.virtual import in_memory
    from pcpc.executive.nodes.watched import StepError
    from pcpc.executive.rig.reading import load_rig
    from pcpc.tools.verdict.judge import Judge

    try:
        rig = load_rig(case.rig, case.controller, case.settings)
        log = in_memory(rig)
    except (RigError, StepError) as error:
        return Result(case, failed=str(error) or "a step does not return")
    if rig.evaluation is None:
        return Result(case, failed=f"{case.rig}: names no evaluation file")
    try:
        judge = Judge.of(rig)
        metrics = judge.metrics(log, case.window_s)
        traces = _traces(judge.judged(log).run(), case.traces) if case.traces else {}
    except RigError as error:
        return Result(case, failed=str(error))
    done = len(log.node["executive"].cycle)
    expected = round(rig.config.duration_s * rig.config.rate_hz)
    return Result(case, metrics, traces, settings_of(rig), diverged=done < expected)


def settings_of(rig: "Rig") -> dict[str, float]:
    """Return the settings of all blocks of a rig, as BLOCK.NAME."""
    specs = (spec for node in rig.nodes().values() for spec in node.blocks)
    return {f"{spec.name}.{name}": v for spec in specs for name, v in spec.settings.items()}


def _traces(run: Run, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Return variables and signals over the executive's cycles, thinned, and `t`."""
    step = max(1, len(run.cycle) // TRACE_POINTS)
    columns = {"t": run["executive:time.t_s"]} | {name: run.get(name) for name in names}
    return {name: values[::step].copy() for name, values in columns.items()}


def write_csv(results: Sequence[Result], path: Path) -> None:
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
    """Return what can be given as NAME: chapters with a study, modules of tools/experiments."""
    chapters = {f"chapter{study.CHAPTER}" for study in studies()}
    modules = (module.stem for module in (Path(__file__).parent / "experiments").glob("[a-z]*.py"))
    return sorted((*chapters, *modules))


def studies() -> list[ModuleType]:
    """Return the studies of the project's plants, by folder."""
    files = sorted(Path(plants.__file__).parent.glob("*/study.py"))
    return [importlib.import_module(f"pcpc.plants.{file.parent.name}.study") for file in files]


def chosen(name: str) -> list[ModuleType]:
    """Return the studies of a chapter or of a file; none for another name."""
    if not name.endswith(".py"):
        return [study for study in studies() if f"chapter{study.CHAPTER}" == name]
    with told(), own_streams():
        module = module_of("", Path(name).resolve())
    absent = [part for part in STUDY_PARTS if not hasattr(module, part)]
    if absent:
        raise StudyError(f"{name}: no {', '.join(absent)}; plants/study.py says what a study holds")
    return [module]


@contextmanager
def told() -> Iterator[None]:
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
    with told():
        cases = [(study, case) for study in parts for case in study.cases()]
    results = each(run_case, [case for _, case in cases], progress, jobs)
    write_csv(results, folder / "results.csv")
    figures = folder / "figures"
    figures.mkdir()
    texts = []
    for study in parts:
        own = [result for (of, _), result in zip(cases, results, strict=True) if of is study]
        progress.say(f"tables and figures: {study.TITLE}")
        with told():
            texts.append(f"# {study.TITLE}\n\n{study.report(own)}")
            study.draw(own, figures)
    (folder / "results.md").write_text("\n".join(texts))
    failed = [result for result in results if result.failed]
    for result in failed:
        progress.say(f"{result.case.label} on {result.case.rig}: {result.failed}")
    return Exit.NOT_MET if failed else Exit.OK


def command(options: argparse.Namespace) -> int:
    """Run the experiment `options.name`; NOT_MET if a run failed."""
    name = str(options.name)
    if not (Path(name).is_file() if name.endswith(".py") else name in names()):
        known = ", ".join(names())
        raise StudyError(f"{name}: no such experiment; expected {known}, or a study.py")
    if options.jobs is not None and options.jobs < 1:
        raise StudyError(f"--jobs {options.jobs}: expected 1 or more")
    try:
        import matplotlib.figure  # noqa: F401  the figures come last
    except ImportError as error:
        cure = "pip install 'pcpc[plot]'"
        what = f"{name}: its figures need matplotlib: {cure} ({error})"
        raise StudyError(what, Exit.ENVIRONMENT) from None
    parts = chosen(name)
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    folder = Path(options.output or Path("runs") / f"{stamp}-{Path(name).stem}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise FileExistsError(0, "is not empty")
    except OSError as error:
        raise StudyError(f"{folder}: {error.strerror}; choose another folder with -o") from None
    progress = Progress(options.quiet)
    try:
        if parts:
            code = run_studies(parts, folder, progress, options.jobs)
        else:
            experiment = importlib.import_module(f"pcpc.tools.experiments.{name}")
            code = int(experiment.run(folder, progress, options.jobs))
    except PoolError as error:
        raise PoolError(f"{name}: {error}") from None
    except OSError as error:
        raise OSError(error.errno, error.strerror, error.filename or str(folder)) from None
    print(folder / "results.md")
    return code
