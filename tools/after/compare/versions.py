"""The rigs of two versions of a repository, run in virtual time and compared.

Each run is a process of its own, `pcpc simulate`, with the code of its version where the repository
holds pcpc, else with the installed one. What has the same inputs in both versions is not run.
"""

import fcntl
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import RigError, did_you_mean, one_line
from pcpc.executive.log.reader import LogError
from pcpc.tools.after.compare.commands import CompareRequest
from pcpc.tools.after.compare.comparison import Comparison
from pcpc.tools.after.compare.inputs import Rig, Tree
from pcpc.tools.after.compare.overlay import Criteria, compared_pair
from pcpc.tools.after.compare.pair import ALONE, FAILED, UNCHANGED, Pair
from pcpc.tools.after.compare.repository import ALIVE, GitError, Repository
from pcpc.tools.start import rigs
from pcpc.tools.start.children import end_with
from pcpc.tools.start.folder import LOG
from pcpc.tools.start.pool import each
from pcpc.tools.terminal.progress import Progress

_SIDES = ("old", "new")


@dataclass(frozen=True)
class Side:
    """A rig to run in one version."""

    root: Path
    rig: str  # its file, from the root
    controller: str  # "": the rig's own
    python_path: str


@dataclass(frozen=True)
class Job:
    """A rig to run in both versions; `folder` takes the runs."""

    name: str
    sides: Sequence[Side]  # old, new
    folder: Path
    how: Criteria

    @property
    def controller(self) -> str:
        """The controller, or both where they differ."""
        return " -> ".join(dict.fromkeys(side.controller for side in self.sides))


def version_comparison(
    against: str, request: CompareRequest, how: Criteria, progress: Progress
) -> Comparison:
    """Compare the rigs of the version `against` with those of the working tree.

    UserError: a version cannot run its rigs.
    """
    repository = _repository(request.words)
    commit = repository.commit(against)
    progress.show(f"writing out {against}")
    with repository.checked_out(commit) as folder:
        trees = (
            Tree(folder / "tree", repository.files_of(commit)),
            Tree(repository.root, repository.files()),
        )
        if trees[1].holds_pcpc and not trees[0].holds_pcpc:
            what = "that version of pcpc cannot run its rigs; name a later version"
            raise UserError(f"--against {against}: {what}")
        comparison = Comparison(f"{against} ({commit[:10]})", "working tree")
        plan = _Plan(trees, request, how, folder, repository.changed(commit))
        comparison.pairs = list(plan.pairs())
        progress.close()
        comparison.pairs += each(_run, plan.jobs, progress, request.jobs) if plan.jobs else []
    comparison.pairs.sort(key=lambda pair: pair.name)
    return comparison


def _repository(words: Sequence[str]) -> Repository:
    """Return the repository of the first word that is a path, else the working folder's.

    Where that is in none, the repository of the first rig that the words name; GitError.
    """
    for path in (Path(word) for word in words if word and os.path.exists(word)):
        return Repository.around(path if path.is_dir() else path.parent)
    try:
        return Repository.around()
    except GitError as error:
        if error.code == Exit.WRONG_INPUT and (files := [*filter(None, map(_rig_file, words))]):
            return Repository.around(Path(files[0]).parent)
        raise


def _rig_file(word: str) -> str:
    """Return the rig file that a word names here, "" for none."""
    with suppress(RigError):
        return rigs.find(word)
    return ""


def path_from(root: Path, word: str) -> str:
    """Return the path from `root`, which is no link, of what a word names from here."""
    folder, name = os.path.split(os.path.abspath(word))
    return os.path.relpath(os.path.join(os.path.realpath(folder), name), root)


class _Version:
    """A version of the rigs: what is wrong with which, and the others, by their paths."""

    def __init__(self, side: str, tree: Tree, present: Tree) -> None:
        self.side, self.tree, self.files = side, tree, tree.rig_files()
        self.python_path = python_path(tree, present)
        self.rigs: dict[str, Rig] = {}
        self.wrong: dict[str, str] = {}
        for path in self.files:
            try:
                if rig := tree.rig(path):
                    self.rigs[path] = rig
            except RigError as error:
                self.wrong[path] = f"{side}: {error}".replace(f"{tree.root}/", "")


class _Plan:
    """What has to be run, in `jobs`, and what is known without."""

    def __init__(
        self,
        trees: tuple[Tree, Tree],
        request: CompareRequest,
        how: Criteria,
        folder: Path,
        changed: Sequence[str],
    ) -> None:
        self._request, self._how, self._folder, self._root = request, how, folder, trees[1].root
        both = zip(_SIDES, trees, strict=True)
        self._versions = [_Version(side, tree, trees[1]) for side, tree in both]
        self._names = _names({k: v for one in self._versions for k, v in one.files.items()})
        used = {f for one in self._versions for r in one.rigs.values() for f in one.tree.used(r)}
        self._loose = trees[1].loose(changed, used)
        self.jobs: list[Job] = []

    def pairs(self) -> Iterator[Pair]:
        """Yield the pairs that need no run, and fill `jobs`; RigError for words that name none."""
        for path in self._chosen():
            wrong = [one.wrong[path] for one in self._versions if path in one.wrong]
            having = [one for one in self._versions if path in one.rigs]
            if wrong:
                yield Pair(self._names[path], "", FAILED, wrong)
            elif len(having) > 1:
                yield from self._controllers(path, *(one.rigs[path] for one in having))
            elif having:
                what = f"only in the {having[0].side} version: {path}"
                yield Pair(self._names[path], "", ALONE, [what])

    def _chosen(self) -> list[str]:
        """Return the paths of the rigs that the command line names, or of all."""
        words, known = self._request.words, sorted(self._names)
        chosen = dict[str, None]()
        for word in words:
            ends = ("", "/rig.yaml") if word else ()
            forms = {path_from(self._root, f"{word}{end}") for end in ends}
            mine = [p for p in known if p in forms or fnmatchcase(self._names[p], word)]
            if not mine and (file := _rig_file(word)):
                mine = [p for p in known if p == path_from(self._root, file)]
            if not mine:
                raise RigError(
                    f"{word or repr(word)}: no rig of either version"
                    f"{did_you_mean(word, self._names.values())}"
                )
            chosen |= dict.fromkeys(mine)
        if not known:
            raise RigError(f"{self._root}: no rig, a YAML file with `rig: NAME`, in either version")
        return list(chosen) if words else known

    def _controllers(self, path: str, old: Rig, new: Rig) -> Iterator[Pair]:
        """Deal with a rig's controllers: its own, others that changed, or those asked for."""
        name, request = self._names[path], self._request
        if old.own != new.own and not (request.controller or request.all_controllers):
            self._add(path, old.own, new.own)
            return
        known = list(dict.fromkeys((*old.controllers, *new.controllers)))
        wanted = [request.controller] if request.controller else known
        if not (request.controller or request.all_controllers):
            wanted = [new.own, *(law for law in known if law != new.own)]
        for law in wanted:
            both = zip(_SIDES, (old, new), strict=True)
            sides = [side for side, rig in both if law in rig.controllers]
            if not sides and request.controller:
                what = f"no such controller{did_you_mean(law, known)}"
                yield Pair(name, law, FAILED, [what])
            elif len(sides) == 1:
                yield Pair(name, law, ALONE, [f"only in the {sides[0]} version"])
            elif self._same(old, new, law):
                if law in (new.own, request.controller) or request.all_controllers:
                    yield Pair(name, law, UNCHANGED)
            else:
                self._add(path, law, law)
                if law == new.own and not request.all_controllers:
                    return  # what it shares with the others has changed

    def _same(self, old: Rig, new: Rig, law: str) -> bool:
        both = zip(self._versions, (old, new), strict=True)
        return len({one.tree.digest(rig, law, self._loose) for one, rig in both}) == 1

    def _add(self, path: str, old: str, new: str) -> None:
        both = zip(self._versions, (old, new), strict=True)
        sides = [Side(one.tree.root, path, law, one.python_path) for one, law in both]
        folder = self._folder / f"run{len(self.jobs)}"
        self.jobs.append(Job(self._names[path], sides, folder, self._how))


def _names(files: dict[str, str]) -> dict[str, str]:
    """Return a name for each rig file: the rig's own if it is the only one, else its path."""
    names = list(files.values())
    return {
        path: name if names.count(name) == 1 else path.rpartition(".")[0]
        for path, name in files.items()
    }


def python_path(tree: Tree, present: Tree) -> str:
    """Return the PYTHONPATH of a version: what is imported from `present` comes from `tree`."""
    entries = [tree.root] if tree.holds_pcpc else []
    for entry in (Path(text).resolve() for text in sys.path if text):
        if entry.is_relative_to(present.root):
            there = tree.root / entry.relative_to(present.root)
            entries += [there] if there.is_dir() else []
    named = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
    before = [Path(os.path.abspath(entry)) for entry in named]
    entries += [e for e in before if not e.resolve().is_relative_to(present.root)]
    return os.pathsep.join(dict.fromkeys(map(str, entries)))


def _run(job: Job) -> Pair:
    """Run a job and compare; in a process of a pool."""
    logs, wrong = [], []
    for word, side in zip(_SIDES, job.sides, strict=True):
        done = simulation(side, job.folder / word)
        logs.append(job.folder / word / LOG)
        wrong += [] if logs[-1].is_file() else [f"{word}: {last_line(done)}"]
    try:
        if wrong:
            return Pair(job.name, job.controller, FAILED, wrong)
        pair = compared_pair(logs[0], logs[1], job.how)
        pair.rig, pair.controller, pair.old, pair.new = job.name, job.controller, "", ""
        return pair
    except (LogError, UserError) as error:
        return Pair(job.name, job.controller, FAILED, [str(error)])
    finally:
        shutil.rmtree(job.folder, ignore_errors=True)


def simulation(side: Side, folder: Path, *more: str) -> "subprocess.CompletedProcess[str]":
    """Run a rig in virtual time into a folder two below the one that holds the version."""
    words = ["simulate", side.rig, "-o", str(folder), "--no-figure", "--quiet", *more]
    words += [f"--controller={side.controller}"] if side.controller else []
    environment = os.environ | {"PYTHONPATH": side.python_path, "OPENBLAS_NUM_THREADS": "1"}
    with (folder.parents[1] / ALIVE).open() as alive:
        fcntl.flock(alive, fcntl.LOCK_SH)
        return subprocess.run(
            [sys.executable, "-P", "-m", "pcpc.tools.cli", *words],
            cwd=side.root,
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            pass_fds=(alive.fileno(),),
            preexec_fn=partial(end_with, os.getpid(), 9),
        )


def last_line(done: "subprocess.CompletedProcess[str]") -> str:
    """Return the last line that a run said, else its exit code."""
    said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
    return one_line(said[-1])
