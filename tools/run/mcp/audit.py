"""The audit: a line of JSON for each thing that happened, chained by digests.

A line has the digest of the line before, so a changed or removed one is found. FILE.end has number
and digest of the last line, and each answer tells them too: who keeps one finds a cut end.
FILE.kept has the contents of what judges a run, and of logs, one behind the other.
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
_CHUNK = 1 << 24  # bytes


class Ran(msgspec.Struct, omit_defaults=True, kw_only=True):
    """A run that a call made, and what its command has said of it."""

    folder: str
    log: str = ""
    "digest; empty: there is none"
    own: bool = False
    "its rig lies in the workspace"
    verdict: str = ""
    changed: list[str] = []


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
    kept: dict[str, tuple[int, int]] = {}
    "from where to where in FILE.kept, by digest"
    ran: Ran | None = None


class Audit:
    """An audit that goes on; UserError for one that is damaged, or in use."""

    def __init__(self, path: Path, folder: Path) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC
        self._file = os.open(path, flags | os.O_APPEND, 0o600)
        self._end = os.open(beside(path, "end"), flags, 0o600)
        self._kept = os.open(beside(path, "kept"), flags, 0o600)
        self._folder = folder
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UserError(f"{path}: another `pcpc mcp` writes it") from None
        self.entries, self.last, problems = read(path)
        if problems:
            raise UserError(f"{path}: {problems[0]}; begin another file")
        self.files: dict[str, str] = {}
        self._known: set[str] = set()
        for entry in self.entries:
            self._note(entry)

    def _note(self, entry: Entry) -> None:
        self.files |= {name: digest or "" for name, digest in entry.files.items()}
        self._known |= entry.kept.keys()

    def add(self, kind: Any, **about: Any) -> Entry:
        """Write a line, with the files that differ from the line before; OSError."""
        try:
            now = workspace.snapshot(self._folder)
        except Refused as why:
            now, about = self.files, {"why": str(why), **about}
        files: dict[str, Any] = {k: v for k, v in now.items() if self.files.get(k) != v}
        files |= {name: None for name, own in self.files.items() if own and name not in now}
        kept = {own: self._keep(name) for name, own in files.items() if self._is_new(name, own)}
        number, before = len(self.entries) + 1, self.last.partition(":")[2]
        at = datetime.now(UTC).isoformat(timespec="milliseconds")
        entry = Entry(
            number=number, at=at, before=before, kind=kind, files=files, kept=kept, **about
        )
        line = msgspec.json.encode(entry)
        os.write(self._file, line + b"\n")
        os.fsync(self._file)
        self.last = f"{number}:{hashlib.sha256(line).hexdigest()}"
        os.pwrite(self._end, f"{self.last:80}".encode(), 0)
        self.entries.append(entry)
        self._note(entry)
        return entry

    @property
    def written_ns(self) -> int:
        """When the last line was written, by the clock of files."""
        return os.fstat(self._file).st_mtime_ns

    def _is_new(self, name: str, digest: str | None) -> bool:
        return digest not in {None, *self._known} and name.endswith((*workspace.KEPT, ".mcap"))

    def _keep(self, name: str) -> tuple[int, int]:
        """Append the content of a file; return where it lies."""
        begin = os.lseek(self._kept, 0, os.SEEK_END)
        with (self._folder / name).open("rb") as file:
            while data := file.read(_CHUNK):
                os.write(self._kept, data)
        return begin, os.lseek(self._kept, 0, os.SEEK_CUR)


def beside(path: Path, what: str) -> Path:
    """Return the file of an audit that is so called."""
    return path.with_name(f"{path.name}.{what}")


def content(path: Path, entries: list[Entry], digest: str) -> bytes:
    """Return what was kept of a digest; b"" for nothing, or another content."""
    begin, end = next((one.kept[digest] for one in entries if digest in one.kept), (0, 0))
    with beside(path, "kept").open("rb") as file:
        file.seek(begin)
        data = file.read(end - begin)
    return data if hashlib.sha256(data).hexdigest() == digest else b""


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
    end = beside(path, "end")
    told = end.read_text().strip() if end.exists() else ""
    if told != ends[-1] and (told or entries):
        problems.append(f"the last line is not the one that {end.name} knows: lines were cut")
    if known_end is not None and known_end not in ends:
        problems.append(f"{known_end} is no line of it: lines were cut or changed")
    return entries, ends[-1], problems
