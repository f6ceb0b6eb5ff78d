"""`pcpc report --audit FILE`: what was changed, what was run, what is green by another yardstick.

A finding is a change of what judges a run, whoever made it: requirements, limits, seed, duration,
evaluation, plant, tests, or a run that was changed, removed, or that no call made.
"""

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import RigError
from pcpc.executive.rig.yamlfile import Place, parse_value
from pcpc.tools.after.report.commands import ReportRequest
from pcpc.tools.run.mcp import audit
from pcpc.tools.run.mcp.audit import Entry, Ran
from pcpc.tools.run.mcp.commands import AuditRequest
from pcpc.tools.run.mcp.recorded import flat, is_law
from pcpc.tools.run.mcp.workspace import LOG, RUNS
from pcpc.tools.terminal.document import Block, Code, Part, Section, Table, Verdict, html, terminal
from pcpc.tools.terminal.html import page
from pcpc.tools.terminal.outfile import write_text

_JUDGES = (".yaml", ".yml", ".py", ".dbc", ".csv", ".eds", ".toml", ".ini", ".cfg")
_NONE = "-"


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
    story = _Story(entries)
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


class _Story:
    """What an audit tells, gathered line by line."""

    def __init__(self, entries: Sequence[Entry]) -> None:
        self.findings: list[Finding] = []
        self.runs: list[tuple[Any, ...]] = []
        self.calls: list[tuple[Any, ...]] = []
        self.diffs: list[Part] = []
        self._texts = {k: v for one in entries for k, v in one.texts.items()}
        self._files: dict[str, str | None] = {}
        self._first: dict[str, Ran] = {}  # by rig
        self._last: dict[str, Ran] = {}
        self._ended: set[int] = set()
        self._open: dict[int, Entry] = {}
        self._laws = {
            name.removeprefix("file ")
            for one in entries if one.ran for name in one.ran.laws if name.startswith("file ")
        }  # fmt: skip
        policies = [one for one in entries if one.kind == "start"]
        for entry in entries:
            self._add(entry, entries[0])
        for before, after in pairwise(policies):
            if before.policy != after.policy:
                self._find(after, "another policy", before.policy, after.policy)
        for entry in self._open.values():
            self._find(entry, f"the call of {entry.tool} has no end")

    def _find(self, entry: Entry, what: str, old: Any = "", new: Any = "") -> None:
        self.findings.append(Finding(entry.number, what, str(old), str(new)))

    def _add(self, entry: Entry, start: Entry) -> None:
        by = f"during call {entry.call}" if entry.call else "by hand"
        for name, digest in entry.files.items() if entry is not start else ():
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
                self._judge(entry, entry.ran, call, start)

    def _changed(self, entry: Entry, name: str, old: str | None, new: str | None, by: str) -> None:
        """Note a file that differs from the line before."""
        made = re.match(rf"{RUNS}/0*(\d+)-", name)
        number = int(made[1]) if made else 0
        if old and number in self._ended:
            what = "changed" if new else "removed"
            self._find(entry, f"{by}: {name} of a run was {what}", old, new or _NONE)
        elif new and name.endswith(LOG) and number not in self._open:
            self._find(entry, f"{by}: {name} is a log that no call made", "", new)
        elif old is None or made or not name.endswith(_JUDGES):
            return
        elif name.endswith((".yaml", ".yml")) and {old, new} <= self._texts.keys():
            for key, before, after in _differences(self._values(old), self._values(new)):
                if not is_law(key):
                    self._find(entry, f"{by}: {name}: {key}", before, after)
        elif not any(name == one or name.endswith(f"/{one}") for one in self._laws):
            self._find(entry, f"{by}: {name}", old[:12], (new or _NONE)[:12])
        if old and name.endswith(_JUDGES) and not made:
            self.diffs.append(Section(f"line {entry.number}, {by}: {name}", [self._diff(old, new)]))

    def _values(self, digest: str | None) -> dict[str, Any]:
        try:
            text = self._texts.get(digest or "", "")
            return dict(flat(parse_value(text, Place(Path(), 1, 1)) or {}))
        except RigError:  # no rig is such a file
            return {"": digest}

    def _diff(self, old: str, new: str | None) -> Block:
        before, after = (self._texts.get(one or "", "").splitlines() for one in (old, new))
        return Block("\n".join(difflib.unified_diff(before, after, lineterm="", n=1)))

    def _judge(self, entry: Entry, ran: Ran, call: Entry, start: Entry) -> None:
        """Hold a run against the last one of its rig, and against the limits of the first."""
        self.runs.append((entry.number, ran.folder, f"{ran.rig} {ran.controller}", ran.verdict,
                          ", ".join(ran.changed)))  # fmt: skip
        if not ran.yardstick:
            return
        first = self._first.setdefault(ran.rig, ran)
        for key, old, new in _differences(self._last.get(ran.rig, ran).yardstick, ran.yardstick):
            self._find(entry, f"{ran.folder}: {key}", old, new)
        self._last[ran.rig] = ran
        named = str(call.arguments.get("rig", ""))
        if first is ran and self._is_new(named, start):
            stated = {k: v for k, v in ran.yardstick.items() if k.startswith(("expect", "require"))}
            self._find(entry, f"{ran.rig}: its yardstick was written in this session", "", stated)
        for one in ran.changed:
            if not one.startswith("controller."):
                self._find(entry, f"{ran.folder}: changed in the run", "", one)
        if ran.verdict == "ok":
            for what, old in _broken(first, ran):
                self._find(entry, f"{ran.folder}: ok by a weakened limit only", old, what)

    def _is_new(self, rig: str, start: Entry) -> bool:
        """Return whether a rig's file came into the workspace after the start."""
        names = {rig, f"{rig}/rig.yaml", f"{rig}/rig.yaml".removeprefix("./")}
        now = names & {name for name, digest in self._files.items() if digest}
        return bool(now) and not now & start.files.keys()


def _differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    for key in sorted({*old, *new}):
        if old.get(key, _NONE) != new.get(key, _NONE):
            yield key, old.get(key, _NONE), new.get(key, _NONE)


def _broken(first: Ran, ran: Ran) -> Iterator[tuple[str, str]]:
    """Yield the metrics of a run that are outside the limits of the first run of its rig."""
    for name, value in ran.metrics.items():
        limits = first.yardstick.get(f"expect.{ran.controller}.{name}")
        if isinstance(limits, list) and not limits[0] <= float(value) <= limits[1]:
            yield f"{name} {value:.4g}", f"{limits[0]:g} to {limits[1]:g}"
