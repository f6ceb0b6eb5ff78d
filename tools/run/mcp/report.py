"""`pcpc report --audit FILE`: what was changed, what was run, what is green by another yardstick.

A finding is a change of what judges a run, whoever made it: requirements, limits, seed, duration,
evaluation, plant, tests, or a run that was changed, removed, or that no call made. A run that is ok
is judged again by the rig and the evaluation that its rig had first, in a process without its laws.
"""

import difflib
import hashlib
import multiprocessing
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from itertools import pairwise
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import RigError
from pcpc.executive.rig.yamlfile import Place, parse_value
from pcpc.plants.judging import effective_rig
from pcpc.tools.after.log.rig import carried_by
from pcpc.tools.after.opened import Opened, opened
from pcpc.tools.after.report.commands import ReportRequest
from pcpc.tools.after.trust import Trust, words_of
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.run.mcp import audit, lock
from pcpc.tools.run.mcp.audit import Entry, Ran
from pcpc.tools.run.mcp.commands import AuditRequest
from pcpc.tools.run.mcp.workspace import LOG, RUNS
from pcpc.tools.terminal.document import Block, Code, Part, Section, Table, Verdict, html, terminal
from pcpc.tools.terminal.html import page
from pcpc.tools.terminal.outfile import write_text

_RIGS = (".yaml", ".yml")
_JUDGES = (*_RIGS, ".py", ".dbc", ".csv", ".eds", ".toml", ".ini", ".cfg")
_LAWS = {"controller", "controllers", "standby", "title", "note", "watch", "rig"}  # keys of a rig
_JUDGED_AGAIN = ("expect", "require", "evaluation", "file of the evaluation")
_NONE, _PATIENCE_S = "-", 120.0


class Finding(NamedTuple):
    """A change, in a line of the audit."""

    line: int
    what: str
    old: str = ""
    new: str = ""


def command(request: ReportRequest) -> int:
    """Print findings and write the page; NOT_MET: there are some, LOSS: the audit is damaged."""
    asked = request.beside.of(AuditRequest)
    path = asked.audit or Path()
    if request.logs or request.suite:
        raise UserError("--audit: not together with runs")
    entries, _, problems = audit.read(path, asked.audit_end)
    if not entries:
        raise UserError(f"{path}: no line of an audit")
    with tempfile.TemporaryDirectory(prefix="pcpc-audit-") as scratch:
        story = _Story(path, entries, Path(scratch))
    found = [*(Finding(0, one) for one in problems), *story.findings]
    output = request.output or path.with_suffix(".html")
    word = "damaged" if problems else "with findings" if found else "without findings"
    verdict = Verdict(word, [f"line {one.line}: {one.what}" for one in found], not found)
    parts: list[Part] = [
        Section("Findings", [Table(("line", "what", "old", "new"), found, (0,))]),
        Section("Runs", [Table(("line", "run", "rig", "verdict", "changed"), story.runs, (0,))]),
        Section("Calls", [Table(("line", "tool", "arguments", "end"), story.calls, (0,))]),
        Section("Files", story.diffs),
    ]
    write_text(output, page(f"audit {path.name}", [*map(html, (verdict, *parts))]))
    print("\n".join([*([] if request.quiet else terminal(verdict)), str(output)]))
    return Exit.LOSS if problems else Exit.NOT_MET if found else Exit.OK


class _Recorded:
    """A run by its log: its laws, and its yardstick, all else that it was made of."""

    def __init__(self, run: Opened) -> None:
        self.path, rig = run.path, effective_rig(run.head)
        self.rig, self.controller = str(rig["rig"]), str(rig["controller"])
        self.yardstick = {name: own for name, own in _flat(rig) if not _is_law(name)}
        used = {_file_of(one) for one in self.yardstick.values()}
        self.laws = {_file_of(one["law"]) for one in rig["controllers"].values()} - used
        judges = carried_by(run.head, "judges")
        for name in ("dbc", "evaluation.file"):  # where it lies; its content is told below
            self.yardstick.pop(name, None)
        for file in (*carried_by(run.head), *judges):
            if file in judges or not self.laws & {*map(_file_of, (file.name, *file.laws))}:
                kind = "file of the evaluation" if file in judges else "file"
                self.yardstick[f"{kind} {Path(file.name).name}"] = file.sha256
        for name, text in run.head.attachments.items():
            if name.endswith(".dbc"):
                self.yardstick["file .dbc"] = hashlib.sha256(text.encode()).hexdigest()


class _Story:
    """What an audit tells, gathered line by line."""

    def __init__(self, path: Path, entries: list[Entry], scratch: Path) -> None:
        self.findings: list[Finding] = []
        self.runs: list[tuple[Any, ...]] = []
        self.calls: list[tuple[Any, ...]] = []
        self.diffs: list[Part] = []
        self._path, self._entries, self._scratch = path, entries, scratch
        self._files: dict[str, str | None] = {}
        self._rigs_written = False
        self._first: dict[str, _Recorded] = {}  # by rig
        self._last: dict[str, _Recorded] = {}
        self._ended: set[int] = set()
        self._open: dict[int, Entry] = {}
        self._recorded = {one.number: self._record(one.ran) for one in entries if one.ran}
        recorded = [one for one in self._recorded.values() if one]
        self._laws = tuple(f"/{law}" for one in recorded for law in one.laws)
        for entry in entries:
            self._add(entry)
        for before, after in pairwise(one for one in entries if one.kind == "start"):
            if before.policy != after.policy:
                self._find(after, "another policy", before.policy, after.policy)
        for entry in self._open.values():
            self._find(entry, f"the call of {entry.tool} has no end")

    def _find(self, entry: Entry, what: str, old: Any = "", new: Any = "") -> None:
        self.findings.append(Finding(entry.number, what, str(old), str(new)))

    def _text(self, digest: str | None) -> str:
        return audit.content(self._path, self._entries, digest or "").decode("utf-8", "replace")

    def _record(self, ran: Ran) -> _Recorded | None:
        """Return a run by its log; None without one that says what it was."""
        log = self._scratch / f"{ran.log}.mcap"
        log.write_bytes(audit.content(self._path, self._entries, ran.log))
        try:
            with opened(log) as run:
                return _Recorded(run)
        except (UserError, OSError, KeyError, TypeError, AttributeError):
            return None

    def _add(self, entry: Entry) -> None:
        by = f"during call {entry.call}" if entry.call else "by hand"
        for name, digest in entry.files.items() if entry is not self._entries[0] else ():
            self._changed(entry, name, self._files.get(name), digest, by)
        self._files |= entry.files
        if entry.kind == "call":
            self._open[entry.number] = entry
        if entry.why and (entry.kind != "end" or entry.code is not None):
            self._find(entry, entry.why)
        if entry.kind == "end":
            call = self._open.pop(entry.call, entry)
            self._ended.add(entry.call)
            end = entry.why or f"exit {entry.code}"
            self.calls.append((entry.number, entry.tool, Code(call.arguments), end))
            for one in call.arguments.get("require", ()):
                self._find(entry, "judged by a requirement of its own", "", one)
            if entry.ran is not None:
                self._judge(entry, entry.ran)

    def _changed(self, entry: Entry, name: str, old: str | None, new: str | None, by: str) -> None:
        """Note a file that differs from the line before."""
        made = re.match(rf"{RUNS}/0*(\d+)-", name)
        number = int(made[1]) if made else 0
        if old and number in self._ended:
            what = "changed" if new else "removed"
            self._find(entry, f"{by}: {name} of a run was {what}", old, new or _NONE)
        elif new and name.endswith(LOG) and number not in self._open:
            self._find(entry, f"{by}: {name} is a log that no call made", "", new)
        elif made:
            return
        elif name.endswith(_RIGS):
            self._rigs_written |= old is None
            for key, before, after in _differences(self._values(old), self._values(new)):
                if old is not None and not _is_law(key):
                    self._find(entry, f"{by}: {name}: {key}", before, after)
        elif old and name.endswith(_JUDGES) and not f"/{name}".endswith(self._laws):
            self._find(entry, f"{by}: {name}", old[:12], (new or _NONE)[:12])
        if name.endswith(_JUDGES):
            before, after = (self._text(one).splitlines() for one in (old, new))
            lines = difflib.unified_diff(before, after, lineterm="", n=1)
            title = f"line {entry.number}, {by}: {name}"
            self.diffs.append(Section(title, [Block("\n".join(lines))]))

    def _values(self, digest: str | None) -> dict[str, Any]:
        try:
            return dict(_flat(parse_value(self._text(digest), Place(Path(), 1, 1)) or {}))
        except RigError:  # no rig is such a file
            return {"": digest}

    def _judge(self, entry: Entry, ran: Ran) -> None:
        """Hold a run against the last one of its rig, and against the yardstick of the first."""
        new, changed = self._recorded[entry.number], ", ".join(ran.changed)
        name = f"{new.rig} {new.controller}" if new else ""
        self.runs.append((entry.number, ran.folder, name, ran.verdict, changed))
        for one in ran.changed:
            if not one.startswith("controller."):
                self._find(entry, f"{ran.folder}: changed in the run", "", one)
        if new is None:
            if ran.verdict == "ok":
                self._find(entry, f"{ran.folder}: ok, but its log does not say what it was")
            return
        last, self._last[new.rig] = self._last.get(new.rig, new), new
        for key, before, after in _differences(last.yardstick, new.yardstick):
            self._find(entry, f"{ran.folder}: {key}", before, after)
        first = self._first.setdefault(new.rig, new)
        if first is new and ran.own and self._rigs_written:
            stated = {k: v for k, v in new.yardstick.items() if k.startswith(_JUDGED_AGAIN[:2])}
            self._find(entry, f"{new.rig}: its yardstick was written in this session", "", stated)
        if ran.verdict != "ok":
            return
        others = [*_differences(first.yardstick, new.yardstick)]
        how = "by a weakened limit" if others else "where its laws run"
        for why in _unheld(first, new):
            self._find(entry, f"{ran.folder}: ok {how} only", why, "ok")
        if made := [key for key, *_ in others if not key.startswith(_JUDGED_AGAIN)]:
            told = f"{ran.folder}: ok, not judged under the old {', '.join(made)}: no such run"
            self._find(entry, told, {k: old for k, old, _ in others if k in made},
                       {k: own for k, _, own in others if k in made})  # fmt: skip


def _unheld(first: _Recorded, new: _Recorded) -> list[str]:
    """Return what a run does not hold of another one's limits and requirements, or why not known.

    The evaluation is code of the workspace: it runs in a process that can write nowhere else.
    """
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    about = there, first.path, new.path, new.controller
    child = context.Process(target=_judge_again, args=about)
    child.start()
    there.close()
    try:
        if here.poll(_PATIENCE_S):
            return msgspec.json.decode(here.recv_bytes(), type=list[str])
    except (EOFError, msgspec.MsgspecError):
        pass
    finally:
        child.kill()
        child.join()
    return ["not judged under the old one: its evaluation comes to no end"]


def _judge_again(there: Connection, first: Path, new: Path, controller: str) -> None:
    place = Path(tempfile.mkdtemp(dir=first.parent))
    tempfile.tempdir, told = str(place), "not judged under the old one"
    try:
        if not lock.confine([place]):
            raise UserError("this kernel has no Landlock")
        with opened(first, Trust(trust=True)) as old, opened(new) as run:
            rig, _ = old.judged([f"controller={controller}"])
            findings = Judge.of(rig).judge(run.log, []).findings
        found = [str(one) for one in findings if one.held is not True]
    except (UserError, OSError) as error:
        found = [f"{told}: {words_of(error)}"]
    there.send_bytes(msgspec.json.encode(found))


def _file_of(value: Any) -> str:
    """Return the file of a law, as FILE:BLOCK names it, or a text as it is."""
    return os.path.normpath(str(value).rpartition(":")[0] or str(value))


def _is_law(key: str) -> bool:
    """Return whether a rig's key is of its laws; all others say what they are judged by."""
    return key.partition(".")[0] in _LAWS


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values of a rig by their dotted names; entries of a list by their own names."""
    if isinstance(value, list) and any(isinstance(one, dict) for one in value):
        value = {str(one.get("id") or one.get("name") or i): one for i, one in enumerate(value)}
    if not isinstance(value, dict) or not value:
        yield name, value
        return
    for key, own in value.items():
        yield from _flat(own, f"{name}.{key}" if name else str(key))


def _differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    for key in sorted({*old, *new}):
        if old.get(key, _NONE) != new.get(key, _NONE):
            yield key, old.get(key, _NONE), new.get(key, _NONE)
