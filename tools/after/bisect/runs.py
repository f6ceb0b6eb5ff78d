"""The run of a rig at a commit, in a process of its own, and what differs first in two of them.

A commit is written out beside the repository, whose working tree, index and branches stay as they
are. Bits are compared as `pcpc compare --bits` does: NaN equals NaN, 0.0 differs from -0.0.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from msgspec import Struct

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.faults import Fault
from pcpc.tools.after.compare.inputs import Tree, texts
from pcpc.tools.after.compare.repository import Repository
from pcpc.tools.after.compare.versions import Side, last_line, python_path, simulation
from pcpc.tools.after.differences import Difference
from pcpc.tools.after.log import diff
from pcpc.tools.after.opened import Opened
from pcpc.tools.start.folder import LOG
from pcpc.tools.terminal.answer import Count, NodeName

_OWN = str(Path(__file__).resolve().parents[3])  # the folder of this pcpc
_ENDED = (Exit.OK, Exit.NOT_MET, Exit.SAFETY_STOP)
_RAISED = (Fault.STEP_RAISED.says, Fault.STEP_HANGS.says)


class CannotRun(Exception):
    """A commit whose rig cannot be run, and why."""


class First(Struct):
    """What differs first in a node."""

    node: NodeName
    cycle: Count
    time_s: float
    "s"
    stage: str
    "frames in; supervisor, time; block NAME; limits, sent; frames out"
    name: str
    "the first of the cycle's order"
    old: str
    "of the parent, as Python writes it"
    new: str
    "of the last suspect"
    ulp: int | None
    "distance in float64 numbers; null: of frames, or NaN"
    others: Count
    "further variables and frames of the node that differ in this cycle"


class CommitRuns:
    """Runs `rig`, a path from the root of `repository`, at its commits, as `words` ask.

    Where `newest` holds pcpc, each commit's code of pcpc runs its rig; else this one does.
    """

    def __init__(self, repository: Repository, newest: str, rig: str, words: Sequence[str]) -> None:
        self.repository, self.rig, self._words, self.count = repository, rig, words, 0
        self._here = Tree(repository.root, repository.files_of(newest))

    def log(self, commit: str) -> logs.Log:
        """Return the log of a new run; CannotRun, UserError."""
        with self.repository.checked_out(commit) as folder:
            tree = Tree(folder / "tree", self.repository.files_of(commit))
            if self.rig not in tree.files:
                raise CannotRun(f"{self.rig} is not in it")
            if self._here.holds_pcpc and not tree.holds_pcpc:
                raise CannotRun("it has no pcpc that can run a rig")
            self._require_in(tree, self._named_files(tree))
            path = python_path(tree, self._here)
            if "-packages" not in _OWN:
                path = os.pathsep.join(filter(None, (path, _OWN)))
            side, place = Side(tree.root, f"./{self.rig}", "", path), folder / "run" / "it"
            self.count += 1
            done = simulation(side, place, "--json", *self._words)
            said = last_line(done).replace(f"{tree.root}/", "")
            if done.returncode in (Exit.LOSS, Exit.INTERRUPTED):
                raise UserError(f"{commit[:10]}: {said}", Exit(done.returncode))
            raised = [text for text in _RAISED if text in done.stdout]
            if raised or done.returncode not in _ENDED or not (place / LOG).is_file():
                raise CannotRun(raised[0] if raised else said)
            log = replace(Opened(place / LOG).log, path=Path(commit[:10]))
            for node in log.node.values():
                self._require_in(tree, [str(one["path"]) for one in node.description["files"]])
        if log.missing or not all(len(node.cycle) for node in log.node.values()):
            raise CannotRun(next(iter(log.missing), "its log has no cycle"))
        return log

    def _named_files(self, tree: Tree) -> Iterator[str]:
        """Yield the files that a rig is read from, and the absolute paths in it."""
        with suppress(RigError):  # its run says what is wrong
            if rig := tree.rig(self.rig):
                yield from map(str, rig.document.sources)
                found = (text.partition(":")[0] for _, text in texts(rig.document.data, ()))
                yield from (text for text in found if text.startswith("/"))

    def _require_in(self, tree: Tree, files: Iterator[str] | Sequence[str]) -> None:
        """Raise UserError for a file of the working tree: it is not that of the commit."""
        for file in map(Path, map(os.path.realpath, files)):
            if file.is_relative_to(self.repository.root) and not file.is_relative_to(tree.root):
                what = f"{self.rig}: a commit of it reads {file} of the working tree"
                raise UserError(f"{what}; name it by a path from the rig")


def firsts(report: diff.Report) -> list[First]:
    """Return what differs first in each node, by time and, at one instant, by cause."""
    of: dict[str, list[Difference]] = {}
    for one in report.differences:
        of.setdefault(one.node, []).append(one)
    return [_first(differences) for differences in of.values()]


def _first(differences: Sequence[Difference]) -> First:
    one = differences[0]
    others = sum(other.cycle == one.cycle for other in differences) - 1
    about = one.node, one.cycle, one.time_s, one.stage, one.name
    return First(*about, *one.texts, one.ulp, others)
