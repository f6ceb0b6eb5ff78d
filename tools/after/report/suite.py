"""`pcpc report --suite`: all runs of a project by the requirements that they test.

Each log is judged anew, by the rig and the evaluation that it holds; the summary beside it has to
say the same. Of several verdicts the worst counts, so that no later or earlier run hides another:

    violated         in any run
    not judged       in any run: by which reason; also where a later run of the same rig and
                     controller does not test it any more
    never happened   the event that it begins with
    ok               in every run

A run that is none, damaged, cut, changed since, or not ok, keeps the suite from being ok.
"""

import os
from collections import ChainMap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from urllib.parse import quote

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.own_laws import carried_files
from pcpc.executive.rig.requirements import text_of
from pcpc.tools.after.log.recorded import folders_below, log_of
from pcpc.tools.after.opened import Opened
from pcpc.tools.after.trust import Trust, words_of
from pcpc.tools.after.verdict import summary as summaries
from pcpc.tools.after.verdict import summary_file
from pcpc.tools.after.verdict.findings import Finding, FindingKind
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.after.verdict.requirements import NEVER_HAPPENED
from pcpc.tools.after.verdict.summary import Summary
from pcpc.tools.start.folder import LOG
from pcpc.tools.terminal.progress import Progress

OK, HAPPENED, UNJUDGED, VIOLATED = WORDS = "ok", "never happened", "not judged", "violated"
_ALONE = "judged from the log alone: the settings of the run are not known"
_KEYS = "rig", "controller", "seed", "version_pcpc", "git", "clock_wall_ns", "start"


@dataclass(frozen=True)
class RequirementResult:
    """What became of a requirement in a run; `key`: its id, else its text."""

    key: str
    words: str
    verdict: str
    margin: str = ""
    why: str = ""
    id: str = ""

    @property
    def title(self) -> str:
        """What it says, behind its id."""
        return f"{self.id} {self.words}" if self.id else self.words or self.key


@dataclass
class OneRun:
    """A run, and what it tests; `problems`: what keeps it from being ok, whatever it tests."""

    path: Path
    facts: dict[str, str] = field(default_factory=dict)
    sha256: str = ""
    verdict: str = "no log"
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    tested: list[RequirementResult] = field(default_factory=list)

    @property
    def of(self) -> str:
        """Rig and controller."""
        return f"{self.facts.get('rig', '')}, {self.facts.get('controller', '')}"

    @property
    def begin_ns(self) -> int:
        """When it began, 0 for unknown."""
        return int(self.facts.get("clock_wall_ns", 0))

    @property
    def code(self) -> int:
        """The exit code of its verdict."""
        return summaries.CODES.get(self.verdict, Exit.LOSS)

    @property
    def ok(self) -> bool:
        """Nothing speaks against it, and something was judged."""
        return self.verdict == "ok" and not self.problems

    @property
    def lines(self) -> list[str]:
        """What keeps it from being ok, or how it was judged."""
        return [*self.problems, *(note for note in self.notes if note == _ALONE)]

    @property
    def revision(self) -> str:
        """Which versions made it."""
        known = ("pcpc " + self.facts.get("version_pcpc", ""), self.facts.get("git", ""))
        return ", ".join(one.strip() for one in known if one not in ("", "pcpc "))


@dataclass
class Cell:
    """A requirement in the runs of a rig with a controller; `worst`: with its run, which counts."""

    key: str
    of: str
    runs: list[tuple[OneRun, RequirementResult]] = field(default_factory=list)

    @property
    def worst(self) -> tuple[OneRun, RequirementResult]:
        """The run with the worst verdict, the latest of several."""
        return max(self.runs, key=lambda one: (WORDS.index(one[1].verdict), one[0].begin_ns))


@dataclass
class Suite:
    """All runs, and what they say of each requirement; `absent`: asked for, tested by none."""

    runs: list[OneRun]
    cells: list[Cell]
    absent: list[str]

    @property
    def ok(self) -> bool:
        """Everything was judged, and is ok."""
        return self.code == Exit.OK

    @property
    def code(self) -> Exit:
        """The exit code: what is violated or not judged goes before what is missing."""
        bad = [cell for cell in self.cells if cell.worst[1].verdict != OK]
        failed = [run for run in self.runs if not run.ok and run.code != Exit.LOSS]
        if bad or failed or self.absent or not self.cells:
            return Exit.NOT_MET
        return Exit.OK if all(run.ok for run in self.runs) else Exit.LOSS


def gather(names: Sequence[str], needed: Sequence[str], trust: Trust, progress: Progress) -> Suite:
    """Judge the runs of folders and logs; UserError where there is none."""
    found = dict[str, Path]()  # a log under two names is one
    for path in (path for name in names for path in _paths(name)):
        found.setdefault(os.path.realpath(path), path)
    paths, runs = list(found.values()), []
    for number, path in enumerate(paths, 1):
        progress.show(f"judging {number}/{len(paths)}: {path}")
        runs.append(_judged_run(path, trust))
    progress.close()
    cells = _cells(runs)
    known = {cell.key for cell in cells}
    return Suite(runs, cells, [one for one in needed if one not in known])


# Which runs


def _paths(name: str) -> list[Path]:
    """Return the logs below a folder, also where they should be; or the one that is named."""
    if not name.strip() or not Path(name).is_dir() or (Path(name) / LOG).exists():
        return [log_of(name)]
    paths = sorted(_logs_below(Path(name)))
    if not paths:
        cure = "name a folder that holds run folders, or the logs themselves"
        raise UserError(f"{name}: no run below this folder; {cure}")
    return paths


def _logs_below(top: Path) -> Iterator[Path]:
    """Yield the log of each run folder below a folder."""
    for folder, folders, files in folders_below(top):
        if LOG in files or LOG in folders or summary_file.NAME in files:
            yield folder / LOG


# A run


def _judged_run(path: Path, trust: Trust) -> OneRun:
    judged, run = OneRun(path), Opened(path, trust)
    try:
        if carried_files.is_ordinary(path):  # a pipe would never end
            judged.sha256 = carried_files.sha256(path)
        head = run.head
    except (OSError, UserError) as error:
        judged.problems.append(_reason(error, path))
        return judged
    told = ChainMap(*(head.metadata[name] for name in head.node))
    judged.facts = {key: told[key] for key in _KEYS if key in told}
    with closing(run):
        try:
            _judge(judged, run)
        except (OSError, UserError) as error:
            judged.verdict, why = "not judged", _reason(error, path)
            judged.problems += filter(None, [why, summary_file.beside(path)[1], *head.missing])
            judged.tested = [*_unjudged_results(run, why)]
    return judged


def _reason(error: Exception, path: Path) -> str:
    text = error.strerror if isinstance(error, OSError) and error.strerror else words_of(error)
    return text.removeprefix(f"{path}: ")


def _judge(judged: OneRun, run: Opened) -> None:
    rig, note = run.judged()
    judge = Judge.of(rig)
    log = run.part(lambda log: judge.needed_columns(log, False))
    own_summary, doubt = summary_file.beside(judged.path)
    outcome = summaries.outcome_of(log, doubt)
    outcome.changed = list(own_summary.changed) if own_summary else []
    summary = summaries.summarise(rig, log, outcome, judge)
    judged.verdict, judged.notes = summary.verdict, [note] if note else []
    judged.problems += summary.problems()
    judged.problems += [f"no run: a {what}" for what in summaries.branch_lines(log)]
    if own_summary is not None:
        _hold_against(judged, summary, own_summary)
    elif not doubt:
        judged.notes.append(_ALONE)
        if judged.path.name == LOG:  # of a run folder, which has one
            judged.problems.append("no summary.json: how the run ended is not known")
            judged.verdict = "loss" if judged.verdict in summaries.UNFAILED else judged.verdict
    judged.tested = [*_results(judge, summary, own_summary or summary)]
    if not judged.tested:
        judged.problems.append("nothing to judge: the rig states no requirement and no limit")


def _hold_against(judged: OneRun, summary: Summary, own_summary: Summary) -> None:
    """Enter what the run's own summary says besides; the worse verdict counts."""
    judged.notes += [f"changed: {', '.join(own_summary.changed)}"] if own_summary.changed else []
    judged.problems += [line for line in own_summary.problems() if line not in judged.problems]
    if own_summary.verdict != "ok" and summary.verdict in summaries.UNFAILED:
        judged.verdict = own_summary.verdict
    elif own_summary.verdict == "ok" and summary.verdict != "ok":
        judged.problems.append("summary.json says ok, the log does not")


def _results(judge: Judge, summary: Summary, own_summary: Summary) -> Iterator[RequirementResult]:
    """Yield what became of requirements in time, then of limits, by the log and `own_summary`."""
    findings = {
        (one.kind, one.key): one
        for one in summary_file.findings_beside(own_summary, summary.findings)
    }
    known = {one.name: one for one in summary.requirements}
    for entry in judge.required().values():
        name = text_of(entry)
        lost = own_summary.not_judged.get(name) or "the log was not judged by it"
        finding = findings.get(
            (FindingKind.REQUIREMENT, name), Finding(FindingKind.REQUIREMENT, lost, None)
        )
        requirement, words = known.get(name), name.removeprefix(f"{entry.id} ")
        margin, why = "", finding.why
        if requirement and finding.held is requirement.held is not None:
            margin, why = requirement.smallest, requirement.first
        yield _result(entry.id or "", words, words, finding.held, margin, why)
    for (kind, _), finding in findings.items():
        if kind is FindingKind.LIMIT:
            margin = "" if finding.margin is None else f"{finding.margin:.4g}"
            why = finding.why if finding.held is None else str(finding)
            yield _result(
                finding.id, finding.name, _limit_words(finding), finding.held, margin, why
            )


def _limit_words(one: Finding) -> str:
    return f"{one.name} {one.low:g} to {one.high:g}"


def _result(
    own_id: str, name: str, words: str, held: bool | None, margin: str, why: str
) -> RequirementResult:
    word = {True: OK, False: VIOLATED, None: UNJUDGED}[held]
    word = HAPPENED if held is None and why == NEVER_HAPPENED else word
    margin, why = margin * (held is not None), why * (not held)
    return RequirementResult(own_id or name, words, word, margin, why, own_id)


def _unjudged_results(run: Opened, why: str) -> Iterator[RequirementResult]:
    """Yield the requirements and limits that a log's rig states, which nobody could judge."""
    try:
        judge = Judge(run.stated())
    except (OSError, UserError):
        return
    for one in (*judge.left_limits(why, {}), *judge.left_requirements(why)):
        words = _limit_words(one) if one.kind is FindingKind.LIMIT else one.name
        yield _result(one.id, one.name, words, None, "", one.why)


# All of them


def _cells(runs: Iterable[OneRun]) -> list[Cell]:
    """Return each requirement with each rig and controller that tests it, or did before."""
    cells: dict[tuple[str, str], Cell] = {}
    for run in runs:
        for one in run.tested:
            cells.setdefault((one.key, run.of), Cell(one.key, run.of)).runs.append((run, one))
    for (_, of), cell in cells.items():
        last = max(run.begin_ns for run, _ in cell.runs)
        for run in runs:
            if run.of == of and run.begin_ns > last and run.tested != []:
                why = "a later run of this rig does not test it any more"
                untested = replace(cell.runs[0][1], verdict=UNJUDGED, margin="", why=why)
                cell.runs.append((run, untested))
    return sorted(cells.values(), key=lambda cell: (cell.key, cell.of))


def link(path: Path, page: Path) -> str:
    """Return a log's address for a page: from there, so that both can move together."""
    folder = os.path.dirname(os.path.realpath(page))
    return quote(os.path.relpath(os.path.realpath(path), folder))
