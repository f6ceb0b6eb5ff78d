"""The audit: a line of JSON for each thing that happened, chained by digests.

A line has the digest of the line before, so a changed or removed one is found. FILE.end has number
and digest of the last line, and each answer tells them too: who keeps one finds a cut end.
"""

import fcntl
import hashlib
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import msgspec

from pcpc.drivers.errors import UserError
from pcpc.tools.run.mcp import workspace
from pcpc.tools.run.mcp.policy import Refused

_FIRST = f"0:{'0' * 64}"


class Ran(msgspec.Struct, omit_defaults=True, kw_only=True):
    """A run that a call made: what was recorded of it, and by what it was judged."""

    folder: str
    log: str = ""
    "digest; empty: there is none"
    rig: str = ""
    controller: str = ""
    verdict: str = ""
    metrics: dict[str, Any] = {}
    changed: list[str] = []
    yardstick: dict[str, Any] = {}
    "all of the rig that is no law, and no parameter of one"
    laws: dict[str, Any] = {}


class Entry(msgspec.Struct, omit_defaults=True, kw_only=True):
    """A line; `files`: digests of what differs from the line before, None: it is gone."""

    number: int
    at: str
    before: str
    kind: Literal["start", "call", "end", "stop"]
    call: int = 0
    "the number of its line"
    tool: str = ""
    arguments: dict[str, Any] = {}
    why: str = ""
    code: int | None = None
    policy: str = ""
    files: dict[str, str | None] = {}
    texts: dict[str, str] = {}
    "of the files, by digest"
    ran: Ran | None = None


class Audit:
    """An audit that goes on; UserError for one that is damaged, or in use."""

    def __init__(self, path: Path, folder: Path) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC
        self._file = os.open(path, flags | os.O_APPEND, 0o600)
        self._end = os.open(_end_of(path), flags, 0o600)
        self._folder = folder
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UserError(f"{path}: another `pcpc mcp` writes it") from None
        self.entries, self.last, problems = read(path)
        if problems:
            raise UserError(f"{path}: {problems[0]}; begin another file")
        self.files: dict[str, str] = {}
        self._texts: set[str] = set()
        for entry in self.entries:
            self._note(entry)

    def _note(self, entry: Entry) -> None:
        self.files |= {name: digest or "" for name, digest in entry.files.items()}
        self._texts |= entry.texts.keys()

    def add(self, kind: Any, **about: Any) -> Entry:
        """Write a line, with the files that differ from the line before; OSError."""
        try:
            now = workspace.snapshot(self._folder)
        except Refused as why:
            now, about = self.files, {"why": str(why), **about}
        files: dict[str, Any] = {k: v for k, v in now.items() if self.files.get(k) != v}
        files |= {name: None for name, own in self.files.items() if own and name not in now}
        new = {own: name for name, own in files.items() if own and own not in self._texts}
        texts = {own: workspace.kept_text(self._folder / name) for own, name in new.items()}
        number, before = len(self.entries) + 1, self.last.partition(":")[2]
        entry = Entry(
            number=number,
            at=datetime.now(UTC).isoformat(timespec="milliseconds"),
            before=before,
            kind=kind,
            files=files,
            texts={own: text for own, text in texts.items() if text is not None},
            **about,
        )
        line = msgspec.json.encode(entry)
        os.write(self._file, line + b"\n")
        os.fsync(self._file)
        self.last = f"{number}:{hashlib.sha256(line).hexdigest()}"
        os.pwrite(self._end, f"{self.last:80}".encode(), 0)
        self.entries.append(entry)
        self._note(entry)
        return entry


def _end_of(path: Path) -> Path:
    return path.with_name(f"{path.name}.end")


def read(path: Path, known_end: str | None = None) -> tuple[list[Entry], str, list[str]]:
    """Return the lines, number and digest of the last one, and what is wrong; OSError."""
    entries, ends, problems = list[Entry](), [_FIRST], list[str]()
    for number, line in enumerate(path.read_bytes().splitlines(), 1):
        try:
            entries.append(msgspec.json.decode(line, type=Entry))
        except msgspec.MsgspecError:
            problems.append(f"line {number} is damaged")
            break
        if (f"{number - 1}:{entries[-1].before}", entries[-1].number) != (ends[-1], number):
            problems.append(f"line {number} does not follow the one before: changed or removed")
        ends.append(f"{number}:{hashlib.sha256(line).hexdigest()}")
    end = _end_of(path)
    told = end.read_text().strip() if end.exists() else ""
    if told != ends[-1] and (told or entries):
        problems.append(f"the last line is not the one that {end.name} knows: lines were cut")
    if known_end is not None and known_end not in ends:
        problems.append(f"{known_end} is no line of it: lines were cut or changed")
    return entries, ends[-1], problems
