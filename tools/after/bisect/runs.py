"""The run of a rig at a commit, in a process of its own, and what differs first in two of them.

A commit is written out beside the repository, whose working tree, index and branches stay as they
are. Bits are compared as `pcpc log diff` does: NaN equals NaN, 0.0 differs from -0.0.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.faults import Fault
from pcpc.tools.after.compare.inputs import Tree, texts
from pcpc.tools.after.compare.repository import Repository
from pcpc.tools.after.compare.versions import Side, last_line, python_path, simulation
from pcpc.tools.after.log import diff
from pcpc.tools.start.folder import LOG

_OWN = str(Path(__file__).resolve().parents[3])  # the folder of this pcpc
_ENDED = (Exit.OK, Exit.NOT_MET, Exit.SAFETY_STOP)
_RAISED = (Fault.STEP_RAISED.says, Fault.STEP_HANGS.says)
_KINDS = ("parameter", "input", "state", "output")
_CLAMPED = "supervisor.saturated"  # the only one of the supervisor's that the limits set
_STAGES = {"<in": "frames in", "rx": "frames in", "tx": "limits, sent", "<out": "frames out"}


class CannotRun(Exception):
    """A commit whose rig cannot be run, and why."""


@dataclass(frozen=True)
class First:
    """What differs first in a node; `others` do so in the same cycle."""

    node: str
    cycle: int
    time_s: float
    stage: str
    name: str
    old: str
    new: str
    ulp: int | None
    others: int


class Runs:
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
            log = replace(logs.read(place / LOG), path=Path(commit[:10]))
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


def firsts(report: diff.Report, old: logs.Log, new: logs.Log) -> list[First]:
    """Return what differs first in each node, by time and, at one instant, by cause."""
    of: dict[str, list[diff.Difference]] = {}
    for one in report.differences:
        of.setdefault(diff.node_of(one), []).append(one)
    found = []
    for node, differences in of.items():
        order = _Order(node, old, new)
        first = min(differences, key=lambda one: (one.cycle, *order.place(one.name)))
        others = sum(one.cycle == first.cycle for one in differences) - 1
        found.append(
            First(
                node,
                first.cycle,
                first.time_s,
                order.stage(first.name),
                first.name.replace(f"{node}.", "", 1),
                first.a,
                first.b,
                first.ulp,
                others,
            )
        )
    return found


class _Order:
    """The order in which a cycle of a node comes to frames and variables."""

    def __init__(self, node: str, old: logs.Log, new: logs.Log) -> None:
        rows = [row for log in (new, old) for row in log.node[node].description["variables"]]
        self._node, self._kinds = node, {row[0]: row[2] for row in rows}
        blocks = [row[3] for row in rows if row[2] in _KINDS and row[3] != "loop"]
        self._blocks = list(dict.fromkeys(blocks))
        self._keys = ["<in", "rx", "", *self._blocks, "tx", "<out"]

    def _key(self, name: str) -> str:
        if name.startswith("frame "):
            return "<in" if name.endswith(" received") else "<out"
        local = name.removeprefix(f"{self._node}.")
        return "tx" if local == _CLAMPED else local.partition(".")[0]

    def stage(self, name: str) -> str:
        """Return in words when a cycle comes to it."""
        key = self._key(name)
        return f"block {key}" if key in self._blocks else _STAGES.get(key, key)

    def place(self, name: str) -> tuple[int, int]:
        """Return what sorts those of one cycle; without an order of their own they keep theirs."""
        key, kind = self._key(name), self._kinds.get(name.removeprefix(f"{self._node}."), "")
        at = self._keys.index(key if key in self._keys else "")
        return at, _KINDS.index(kind) if kind in _KINDS else 0
