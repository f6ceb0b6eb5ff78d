"""The files that a log carries, so that it can be recomputed and drawn where they do not lie.

A law from outside the project may import modules beside it and read tables, also in `prepare`. What
it opens then is noted (Python's audit event `open`), and goes into the log with where it lay.

Not noted: Python's and the project's own files, what is installed, and devices.
"""

import ast
import hashlib
import importlib.util
import os
import site
import stat
import sys
import sysconfig
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, TypedDict

from pcpc.drivers.compiled.compile_cache import cache_folder
from pcpc.drivers.machine import outside

MOST_BYTES = 64 << 20  # of all carried files of a node together
AREAS = ("drivers", "executive", "plants", "tools")
_PROJECT = Path(__file__).resolve().parents[2]
_SYSTEM = ("/proc", "/sys", "/dev", "/etc", "/usr/lib", "/usr/share")

Reads = dict[Path, set[str]]  # a file, and the relative texts by which it was opened
_listening: list[tuple[int, Reads]] = []  # thread, what it opened
_hooked: list[bool] = []


@contextmanager
def noted_reads() -> Iterator[Reads]:
    """Yield what this thread opens for reading until the end, as far as it is to be carried."""
    if not _hooked:  # a hook stays for good
        _hooked.append(True)
        sys.addaudithook(_hook)
    opened: Reads = {}
    carried: Reads = {}
    _listening.append((threading.get_ident(), opened))
    try:
        yield carried
    finally:
        _listening.pop()
        add_reads(carried, {file: texts for file, texts in opened.items() if is_outside(file)})


def add_reads(into: Reads, more: Mapping[Path, set[str]]) -> None:
    """Add `more` to `into`."""
    for file, texts in more.items():
        into.setdefault(file, set()).update(texts)


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if event != "open" or not _listening:
        return
    thread, opened = _listening[-1]
    name, mode, flags = arguments
    if thread != threading.get_ident() or isinstance(name, int):
        return
    writes = any(c in mode for c in "wax") if mode else flags & (os.O_WRONLY | os.O_CREAT)
    if writes:
        return
    text = os.fsdecode(name)
    file = Path(os.path.abspath(text))
    if file.suffix == ".pyc":
        try:
            file = Path(importlib.util.source_from_cache(file))
        except ValueError:
            return
    opened.setdefault(file, set()).update([] if os.path.isabs(text) else [text])


def is_outside(file: Path) -> bool:
    """Return whether a file is an ordinary one, and neither installed nor the project's own.

    What pip notes of a package, beside its source if that is editable, is read by many an import.
    """
    is_pips = any(part.endswith((".egg-info", ".dist-info")) for part in file.parts)
    if is_pips or not is_ordinary(file):
        return False
    return not str(file).startswith(_inside()) or _is_of_plant(file)


def _is_of_plant(file: Path) -> bool:
    """Return whether a file belongs to a system that an installed package brings."""
    return any(file.is_relative_to(one.folder) for one in outside.additions("plants"))


def is_ordinary(file: Path) -> bool:
    """Return whether `file` is a regular file that can be read."""
    try:
        return stat.S_ISREG(file.stat().st_mode) and os.access(file, os.R_OK)
    except (OSError, ValueError):
        return False


def _inside() -> tuple[str, ...]:
    """Return how the paths begin that are not outside."""
    folders = [*_installed_folders(), str(cache_folder()), os.environ.get("NUMBA_CACHE_DIR", "")]
    return tuple(os.path.join(os.path.normpath(folder), "") for folder in folders if folder)


@lru_cache
def _installed_folders() -> list[str]:
    paths = sysconfig.get_paths()
    folders = [paths[key] for key in ("stdlib", "platstdlib", "purelib", "platlib")]
    folders += [*site.getsitepackages(), site.getusersitepackages(), *_SYSTEM]
    return folders + [str(_PROJECT / area) for area in (*AREAS, "pcpc")]


@lru_cache(maxsize=64)  # a campaign asks of the same few texts for every run
def imported_names(text: bytes) -> tuple[str, ...]:
    """Return the outermost names of the modules that a Python text imports; SyntaxError."""
    tree = list(ast.walk(ast.parse(text)))
    names = [name.name for node in tree if isinstance(node, ast.Import) for name in node.names]
    names += [node.module or "" for node in tree if isinstance(node, ast.ImportFrom)]
    return tuple(name.partition(".")[0] for name in names)


def with_local_imports(file: Path) -> list[Path]:
    """Return a Python file and the modules in its folder that it imports, and they in turn."""
    files = {file: None}
    for module_file in (todo := [file]):
        try:
            names = imported_names(module_file.read_bytes())
        except (OSError, SyntaxError, ValueError):
            continue
        paths = [file.with_name(f"{name}.py") for name in names]
        todo += [path for path in paths if path not in files and is_ordinary(path)]
        files |= dict.fromkeys(todo)
    return list(files)


class CarriedFile(TypedDict):
    """What a description says of a file.

    The first of those that judge is the rig's evaluation, the first that draws its drawing; others
    are imported by it.
    """

    name: str  # from the rig's folder
    path: str  # absolute
    given: list[str]  # relative texts that it was opened by
    laws: list[str]  # the laws of the rig that it is
    sha256: str
    bytes: int
    left_out: bool  # more than the log carries
    judges: bool  # no law needs it
    draws: bool


def file_entries(
    reads: Reads, laws: Reads, judges: Sequence[Path], draws: Sequence[Path], rig: Path
) -> list[CarriedFile]:
    """Return the entries of a description: `reads`, `laws` by their texts, `judges`, `draws`."""
    entries: list[CarriedFile] = []
    total, needed = 0, sorted({*reads, *laws}, key=lambda f: (f not in laws, str(f)))
    purposes = [(file, "") for file in needed]
    purposes += [(file, "judges") for file in judges if file not in needed]
    purposes += [(file, "draws") for file in draws]
    for file, purpose in purposes:
        try:
            size, digest = file.stat().st_size, sha256(file)
        except OSError:
            continue  # it was there a moment ago, and is no law's any more
        total += size
        entries.append(
            {
                "name": Path(os.path.relpath(file, rig.parent)).as_posix(),
                "path": str(file),
                "given": sorted(reads.get(file, ())),
                "laws": sorted(laws.get(file, ())),
                "sha256": digest,
                "bytes": size,
                "left_out": total > MOST_BYTES,
                "judges": purpose == "judges",
                "draws": purpose == "draws",
            }
        )
        total -= size if total > MOST_BYTES else 0
    return entries


def sha256(file: Path) -> str:
    """Return the SHA-256 of a file's content in hexadecimal; OSError."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def attachments(
    description: Mapping[str, Any], more: Mapping[str, str]
) -> Iterator[tuple[str, bytes, str]]:
    """Yield name, content and SHA-256 of what a log holds of a node: texts, `more`, files.

    A file that has changed since it was listed is left out.
    """
    for name, text in {**description["attachments"], **more}.items():
        data = text.encode()
        yield name, data, hashlib.sha256(data).hexdigest()
    for entry in description.get("files", ()):
        with suppress(OSError):
            data = b"" if entry["left_out"] else Path(entry["path"]).read_bytes()
            if (digest := hashlib.sha256(data).hexdigest()) == entry["sha256"]:
                yield attachment_name(entry), data, digest


def missing_warning(entries: Sequence[CarriedFile]) -> str:
    """Return what the log will lack, in a line; "" if it is whole."""
    names = [f"{entry['path']} ({entry['bytes']} bytes)" for entry in entries if entry["left_out"]]
    if not names:
        return ""
    return (
        f"the log does not carry {', '.join(names)}: more than {MOST_BYTES >> 20} MiB; "
        "replay it on a machine that has them"
    )


def attachment_name(entry: CarriedFile) -> str:
    """Return the name under which a log holds the content of a file."""
    parts = ["up" if part == ".." else part for part in entry["name"].split("/")]
    return f"files/{entry['sha256'][:12]}/{'/'.join(parts)}"
