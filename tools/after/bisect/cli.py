"""`pcpc bisect RIG GOOD BAD`: the commit that changed a run's bits first, and where in the run."""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated, TypedDict

from msgspec import Meta

from pcpc.drivers.errors import Exit, UserError, printable
from pcpc.executive.log import reader as logs
from pcpc.tools.after.bisect.commands import BisectRequest
from pcpc.tools.after.bisect.runs import CannotRun, CommitRuns, First, firsts
from pcpc.tools.after.bisect.search import ends, suspects
from pcpc.tools.after.compare.repository import GitError, Repository
from pcpc.tools.after.compare.versions import path_from
from pcpc.tools.after.log import diff
from pcpc.tools.start import rigs
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.answer import Count, Positive
from pcpc.tools.terminal.progress import Progress

Hash = Annotated[str, Meta(pattern="^([0-9a-f]{40}|[0-9a-f]{64})$")]
_SHOWN = 8  # files, commits that cannot be run


class Suspect(TypedDict):
    """A commit."""

    commit: Hash
    date: str
    "of its author, ISO 8601"
    subject: str


class SkippedCommit(TypedDict):
    """A commit that cannot be run."""

    commit: Hash
    why: str


class Bisected(TypedDict):
    """The commit that changed the bits of a run first."""

    rig: str
    "its file, from the root of the repository"
    good: Hash
    bad: Hash
    uncommitted: Count
    "files of the working tree that differ from its commit; none was used"
    cycles: Positive
    "of the run of GOOD"
    runs: Annotated[int, Meta(ge=2)]
    suspects: list[Suspect]
    "one of them is the first, oldest first; empty: GOOD and BAD have equal bits"
    parent: Hash | None
    "of a suspect, with the bits of GOOD; the last suspect is compared with it"
    files: list[str]
    "that differ between parent and last suspect; first those beside the rig"
    skipped: list[SkippedCommit]
    only: list[str]
    "variables, cycles and nodes that only one of the two runs has, in words"
    nodes: list[First]
    "with a difference, the cause before its effect"


def command(request: BisectRequest) -> int:
    """Search and print; NOT_MET for equal bits, or several suspects. UserError: wrong input."""
    file = rigs.find(request.rig)
    repository = Repository.around(Path(file).parent)
    rig = path_from(repository.root, file)
    good, bad = ends(repository, request.good, request.bad)
    for word, commit in (("GOOD", good), ("BAD", bad)):
        if rig not in repository.files_of(commit):
            what = f"{rig}: not in {word}, {commit[:10]}"
            raise UserError(f"{what}; name a commit that has it under this name")
    uncommitted = _uncommitted_count(repository)
    progress = Progress(request.quiet)
    runs = CommitRuns(repository, bad, rig, list(_words(request)))
    told = _Bisection(runs, good, bad, progress).found(uncommitted)
    progress.close()
    screen.answer(request.json, told, _lines(told), 1)
    return Exit.OK if len(told["suspects"]) == 1 else Exit.NOT_MET


def _words(request: BisectRequest) -> Iterator[str]:
    """Yield what each run is asked for."""
    if request.controller is not None:
        yield f"--controller={request.controller}"
    for text in request.set:
        yield f"--set=@{os.path.abspath(text[1:])}" if text.startswith("@") else f"--set={text}"
    if request.duration is not None:
        yield f"--set=duration_s={request.duration!r}"


def _uncommitted_count(repository: Repository) -> int:
    """Return how many files of the working tree are not those of its commit."""
    with suppress(GitError):  # it has none yet
        return len(repository.changed("HEAD"))
    return 0


class _Bisection:
    """A search; the logs of GOOD and of the earliest commit that differs are kept."""

    def __init__(self, runs: CommitRuns, good: str, bad: str, progress: Progress) -> None:
        self._runs, self._git, self._progress = runs, runs.repository.git, progress
        self._why: dict[str, str] = {}
        self._ends = good, bad
        self._good, self._bad = self._log(good, "GOOD"), self._log(bad, "BAD")

    def _log(self, commit: str, name: str) -> logs.Log:
        self._progress.show(f"running {name}, {commit[:7]}")
        try:
            return self._runs.log(commit)
        except CannotRun as error:
            raise UserError(f"{name} {commit[:10]} cannot be run: {error}") from None

    def _differs(self, commit: str) -> bool | None:
        try:
            log = self._runs.log(commit)
        except CannotRun as error:
            self._why[commit] = str(error)
            return None
        if diff.compare(self._good, log).equal:
            return False
        self._bad = log
        return True

    def found(self, uncommitted: int) -> Bisected:
        """Return what is told of it; UserError where two runs of one commit differ."""
        rig, (good, bad) = self._runs.rig, self._ends
        cycles = len(next(iter(self._good.node.values())).cycle)
        if diff.compare(self._good, self._bad).equal:
            return {
                "rig": rig, "good": good, "bad": bad, "uncommitted": uncommitted,
                "cycles": cycles, "runs": self._runs.count, "parent": None,
                "suspects": [], "skipped": [], "files": [], "only": [], "nodes": [],
            }  # fmt: skip
        left, parent = suspects(self._runs.repository, good, bad, self._differs, self._tell)
        old, new = self._again(parent, self._good), self._again(left[-1], self._bad)
        report, folder = diff.compare(old, new), os.path.dirname(rig)
        words = "diff-tree", "-r", "-z", "--name-only", "--no-renames", parent, left[-1]
        files = self._git(*words).split("\0")[:-1]
        files.sort(key=lambda name: not name.startswith(os.path.join(folder, "")))
        return {
            "rig": rig, "good": good, "bad": bad, "uncommitted": uncommitted,
            "cycles": cycles, "runs": self._runs.count,
            "suspects": list(map(self._commit_facts, left)), "parent": parent, "files": files,
            "skipped": [{"commit": one, "why": why} for one, why in self._why.items()],
            "only": report.only, "nodes": firsts(report),
        }  # fmt: skip

    def _tell(self, left: int, commit: str) -> None:
        self._progress.show(f"{left} commit{'s' * (left > 1)} left, testing {commit[:7]}")

    def _again(self, commit: str, before: logs.Log) -> logs.Log:
        """Run a commit once more; UserError if its bits are not those of before."""
        log = self._log(commit, "once more")
        if diff.compare(before, log).equal:
            return log
        what = "its runs differ from each other, so they depend on a clock or on chance"
        raise UserError(f"{commit[:10]}: {what}; fix that before you bisect")

    def _commit_facts(self, commit: str) -> Suspect:
        words = "-c", "log.showSignature=false", "show", "-s", "--format=%aI%n%s", commit
        date, _, subject = self._git(*words).rstrip("\n").partition("\n")
        return {"commit": commit, "date": date, "subject": printable(subject)}


def _lines(told: Bisected) -> Iterator[str]:
    """Yield the text for a terminal."""
    if told["uncommitted"]:
        yield f"uncommitted files, left out: {told['uncommitted']}"
    left = told["suspects"]
    if not left:
        what = f"equal bits up to cycle {told['cycles'] - 1}, nothing to find"
        yield f"{told['good'][:10]} and {told['bad'][:10]}: {what}"
        return
    for skipped in told["skipped"][:_SHOWN]:
        yield f"skipped  {skipped['commit'][:10]} cannot be run: {skipped['why']}"
    if len(left) > 1:
        yield f"one of {len(left)} commits; those between cannot be run"
    for one in left:
        yield f"commit   {one['commit'][:10]}  {one['date']}  {one['subject']}"
    yield f"changed  {', '.join(screen.some(told['files'], _SHOWN, '{} more'))}"
    yield from (f"also     {text}" for text in told["only"])
    for first in told["nodes"]:
        yield f"{first.node}, cycle {first.cycle} ({first.time_s:.6g} s), {first.stage}"
        ulp = "" if first.ulp is None else f", {first.ulp} ULP"
        others = f"; {first.others} more in this cycle" if first.others else ""
        yield f"  {first.name}: {first.old} -> {first.new}{ulp}{others}"
