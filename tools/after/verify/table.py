r"""The table of verified logs: a text that a person, `sha256sum` and `ssh-keygen` understand.

    pcpc verify 1: digest, verdict, versions, path
    DIGEST  VERDICT  NAME=VERSION,...  PATH      sorted by path; - for no digest
    SHA256  all lines above

PATH is below the folder of the table, with `/`; what is not ASCII, and `\`, is escaped as in
Python. A table is ASCII, its lines end with a newline. Its signature is FILE.sig, of the namespace
pcpc.
"""

import hashlib
import os
import posixpath
import re
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from msgspec import Struct

from pcpc.drivers.errors import Exit, UserError
from pcpc.tools.after.verify.one import CODES, VerifiedLog
from pcpc.tools.terminal.outfile import new_file

_HEAD, _END = "pcpc verify 1: digest, verdict, versions, path", "all lines above"
_LINE = re.compile(rf"([0-9a-f]{{64}}|-)  ({'|'.join(CODES)})  (\S+)  (.+)")
_CURE = "the table is damaged; take another copy of it"


@dataclass(frozen=True)
class TableLine:
    """A line of a table."""

    digest: str | None
    verdict: str


class TableProblem(Struct):
    """How a log is not as in the table of --check."""

    what: Literal["missing", "additional", "changed", "judged"]
    line: str
    "the log, and what it is"


def signature_of(table: Path) -> Path:
    """Return where the signature of a table lies."""
    return table.with_name(f"{table.name}.sig")


def relative(log: str, table: Path) -> str:
    """Return the path of a log as its table has it; UserError where it does not lie below."""
    path = path_below(log, table)
    if path.startswith("../") or os.path.isabs(path):
        what = f"does not lie below {table.parent}, the folder of the table"
        raise UserError(f"{log}: {what}; put the table into a folder above all logs")
    return path


def text_of(rows: Iterable[VerifiedLog], table: Path) -> bytes:
    """Return the table of logs."""
    lines = [_HEAD]
    for path, row in sorted({relative(row.log, table): row for row in rows}.items()):
        told = ",".join(f"{key}={_word(text)}" for key, text in row.versions.items()) or "-"
        name = path.encode("unicode_escape").decode()
        lines.append(f"{row.digest or '-'}  {row.verdict}  {told}  {name}")
    above = "".join(f"{line}\n" for line in lines).encode("ascii")
    return above + f"{hashlib.sha256(above).hexdigest()}  {_END}\n".encode()


def _word(text: str) -> str:
    return re.sub(r"[^!-~]|,", "_", text)


def entries(table: Path, data: bytes) -> dict[str, TableLine]:
    """Return the lines of a table by the paths of the logs; UserError."""
    above, _, last = data.removesuffix(b"\n").rpartition(b"\n")
    above += b"\n"
    if b"\r" in data:
        raise UserError(f"{table}: has Windows line ends: {_CURE}")
    if not data.endswith(b"\n") or last.decode("latin-1") != (
        f"{hashlib.sha256(above).hexdigest()}  {_END}"
    ):
        raise UserError(f"{table}: its last line is not the SHA-256 of those above: {_CURE}")
    head, *lines = above.decode("latin-1").split("\n")[:-1]
    found: dict[str, TableLine] = {}
    if head != _HEAD or not lines:
        raise UserError(
            f"{table}: {'lists no log' if head == _HEAD else 'no table'} of pcpc verify"
        )
    for number, line in enumerate(lines, 2):
        parts = _LINE.fullmatch(line)
        path = _path(parts[4]) if parts else ""
        if parts is None or not path or path in found:
            what = "is no line of it" if parts is None else "a path that is wrong, or there twice"
            raise UserError(f"{table}:{number}: {what}: {_CURE}")
        found[path] = TableLine(None if parts[1] == "-" else parts[1], parts[2])
    return found


def _path(text: str) -> str:
    """Return a path of a table; "" for one that does not lie below it."""
    try:
        path = text.encode("ascii").decode("unicode_escape")
    except ValueError:
        return ""
    wrong = path.startswith(("/", "../")) or path in ("..", ".") or "\0" in path
    wrong = wrong or posixpath.normpath(path) != path
    return "" if wrong or path.encode("unicode_escape").decode() != text else path


def table_differences(
    rows: Sequence[VerifiedLog], known: Mapping[str, TableLine], table: Path
) -> list[TableProblem]:
    """Return how logs are not as in a table, by line."""
    found = list[TableProblem]()
    here = {path_below(row.log, table): row for row in rows}
    for path in known.keys() - here.keys():
        found.append(TableProblem("missing", f"{path}: in the table, but not here"))
    for path, row in here.items():
        if path not in known:
            found.append(TableProblem("additional", f"{path}: here, but not in the table"))
        elif known[path].digest != row.digest:
            found.append(TableProblem("changed", f"{path}: its digest is not that of the table"))
        elif known[path].verdict != row.verdict:
            was = known[path].verdict
            found.append(TableProblem("judged", f"{path}: {was} in the table, {row.verdict} now"))
    return sorted(found, key=lambda one: one.line)


def path_below(log: str, table: Path) -> str:
    """Return the path of a log from the folder of a table, wherever it lies."""
    return Path(os.path.relpath(log, table.parent)).as_posix()


# Files, and who signed them


def write(table: Path, data: bytes, key: str | None) -> None:
    """Write a table, and its signature; UserError."""
    signed = _ssh_keygen(["sign", "-f", key], data, f"--sign {key}") if key else b""
    with new_file(table, force=False, cure="choose another name, or remove it") as unfinished:
        unfinished.write_bytes(data)
        if key:
            with new_file(signature_of(table), force=False, cure="remove it") as beside:
                beside.write_bytes(signed)


def check_signature(table: Path, data: bytes, signers: str, who: str) -> None:
    """Hold a table against its signature; UserError, NOT_MET if it is not signed by `who`."""
    beside = signature_of(table)
    for path in (beside, Path(signers)):
        if not path.is_file():
            raise UserError(f"{path}: no such file; without it the signature cannot be checked")
    words = ["verify", "-f", signers, "-I", who, "-s", str(beside)]
    _ssh_keygen(words, data, f"{table}: not signed by {who}", Exit.NOT_MET)


def without_ssh_keygen() -> UserError:
    """Return the error where the program is not there."""
    return UserError("ssh-keygen: not installed; install openssh-client", Exit.ENVIRONMENT)


def _ssh_keygen(
    words: Sequence[str], data: bytes, failed: str, code: Exit = Exit.WRONG_INPUT
) -> bytes:
    command = ["ssh-keygen", "-Y", words[0], "-n", "pcpc", *words[1:]]
    try:
        done = subprocess.run(command, input=data, capture_output=True)
    except FileNotFoundError:
        raise without_ssh_keygen() from None
    if done.returncode:
        said = done.stderr.decode("utf-8", "replace").strip().splitlines() or ["no reason given"]
        raise UserError(f"{failed}: {said[0]}", code)
    return done.stdout
