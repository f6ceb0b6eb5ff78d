"""Modules of laws, evaluations and studies: imported once, under a name to keep compiled code by.

A law from outside the project may read tables at its import; what it opened is noted, because it
goes into the log, and because its content is in the compiled code.
"""

import hashlib
import importlib
import importlib.util
import json
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from types import ModuleType

from pcpc.drivers.compiled import compile_cache
from pcpc.drivers.compiled.compile_cache import cache_folder, keep_by
from pcpc.drivers.machine.patience import StalledError, patience
from pcpc.executive.own_laws import carried_files
from pcpc.executive.own_laws.carried_files import AREAS, Reads, add_reads

PROJECT = Path(__file__).resolve().parents[2]
OURS = "pcpc."  # modules of the project
LONG_S, ENDLESS_S = 5.0, 60.0  # of an import: until it is named; of the processor, until it ends
_outside: dict[Path, ModuleType] = {}
_read_by: dict[str, Reads] = {}  # what the import of a module opened, by its file or name
_contents: dict[Path, str] = {}  # SHA-256 of what the imports opened, as it was then
_ALONE = {  # a law that imports nothing else, and reads nothing, is what its text says
    "__future__", "collections", "dataclasses", "functools", "itertools", "math", "numpy", "pcpc",
    "typing",
}  # fmt: skip


def module_of(name: str, file: Path) -> ModuleType:
    """Import the module `name`, or that of `file` where the name is ""; ImportError for no end."""
    with _bounded_import(name or str(file)):
        return _import_module(name) if name else _import_file(file)


@contextmanager
def _bounded_import(subject: str) -> Iterator[None]:
    """Name an import that takes long; end it when it computes for ever and compiles nothing."""
    before = compile_cache.watch.done

    def say() -> None:
        if compile_cache.watch.done == before:  # else that is said
            print(f"{subject}: still importing; Ctrl-C ends it", file=sys.stderr)

    timer = threading.Timer(LONG_S, say)
    timer.start()
    try:
        with patience(ENDLESS_S, lambda: compile_cache.watch.done):
            yield
    except StalledError:
        why = f"it does not come to an end, it computed for {ENDLESS_S:g} s"
        raise ImportError(f"{subject}: {why}") from None
    finally:
        timer.cancel()
        timer.join()


def outside_module(file: Path) -> ModuleType | None:
    """Return the module of a file outside the project, if it was imported."""
    return _outside.get(file)


def reads_of(module: ModuleType) -> Reads:
    """Return what the import of a module opened."""
    return _read_by.get(_key(module), {})


def digest_at_import(file: Path) -> str | None:
    """Return the SHA-256 that a file had when a module's import opened it; None: none did."""
    return _contents.get(file)


def opened_files() -> Reads:
    """Return what the imports of this process opened, as far as a log is to carry it."""
    all_reads: Reads = {}
    for reads in _read_by.values():
        add_reads(all_reads, reads)
    return all_reads


def project_name(file: Path) -> str | None:
    """Return the dotted name of a module of this project, given its file; None for another file."""
    file = file.resolve()
    if not file.is_relative_to(PROJECT):
        return None
    parts = file.relative_to(PROJECT).with_suffix("").parts
    if parts[0] not in AREAS or not all(part.isidentifier() for part in parts):
        return None  # a file beside the packages has a dotted name in some processes only
    try:
        spec = importlib.util.find_spec(OURS + ".".join(parts))
    except ModuleNotFoundError:
        return None
    found = spec is not None and spec.origin is not None and Path(spec.origin).resolve() == file
    return spec.name if spec is not None and found else None


def project_file(name: str) -> Path | None:
    """Return the file of a module of this project by its dotted name; None for another name."""
    parts = name.removeprefix(OURS).split(".")
    if not name.startswith(OURS) or not all(part.isidentifier() for part in parts):
        return None
    file = PROJECT.joinpath(*parts).with_suffix(".py")
    return file if project_name(file) == name else None


@contextmanager
def own_streams() -> Iterator[None]:
    """Keep what a module prints out of stdout, and the terminal from a module that reads it."""
    terminal = sys.stdin
    with open(os.devnull, encoding="utf-8") as nothing, redirect_stdout(sys.stderr):
        sys.stdin = nothing
        try:
            yield
        finally:
            sys.stdin = terminal


def _import_file(file: Path) -> ModuleType:
    """Import a Python file, once per process.

    A file of the project gets its dotted name, any other one a name made of its text or its path:
    the compile cache stores the module's name, so that it must be the same in every process.
    """
    if (own_name := project_name(file)) is not None:
        return importlib.import_module(own_name)
    if file in _outside:
        return _outside[file]
    known = _ReadMemory(file)
    with carried_files.noted_reads() as reads:
        module = _execute(file, known.module_name())
    reads.pop(file, None)
    if known.is_news(reads):
        module = _execute(file, known.module_name())
    _outside[file] = module
    _note(module, reads, file)
    return module


def _note(module: ModuleType, reads: Reads, *files: Path) -> None:
    """Remember what a module's import opened, and what was in that and in its own `files`."""
    _read_by[_key(module)] = reads
    for file in (*files, *reads):
        with suppress(OSError):
            _contents.setdefault(file, carried_files.sha256(file))


def _key(module: ModuleType) -> str:
    """Return what tells a module from others; equal laws in two folders have the same name."""
    return module.__file__ or module.__name__


def _import_module(name: str) -> ModuleType:
    """Import an installed module; note what a module from outside the project opens."""
    if name in sys.modules or name.startswith(OURS):
        return importlib.import_module(name)
    with carried_files.noted_reads() as reads:
        module = importlib.import_module(name)
    _note(module, reads)
    return module


def _standalone_text(file: Path) -> bytes:
    """Return the text of a law that depends on nothing else; b"" of another."""
    with suppress(OSError, SyntaxError, ValueError):
        text = file.read_bytes()
        if _ALONE.issuperset(carried_files.imported_names(text)) and b"__file__" not in text:
            return text
    return b""


class _ReadMemory:
    """What the import of a law opened the last time, kept beside the compiled code.

    Tables and modules that a law reads end up in its compiled code, so that their content is in the
    name under which that is cached. The code of a law that stands alone is cached by its text, for
    whatever folder that lies in: a copy, another version of a rig, a log.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self._path = hashlib.sha256(str(file).encode()).hexdigest()
        self._note = cache_folder() / "reads" / f"{self._path}.json"
        self._files: list[str] = []
        with suppress(OSError, ValueError):
            noted = json.loads(self._note.read_text(encoding="utf-8"))
            self._files = [str(name) for name in noted if isinstance(noted, list)]

    def module_name(self) -> str:
        """Return a name made of the law's text, or of its path and of what it read."""
        if not self._files and (text := _standalone_text(self.file)):
            name = f"{self.file.stem}_{hashlib.sha256(text).hexdigest()[:16]}"
            keep_by(self.file, name)
            return name
        keep_by(self.file, "")
        digest = hashlib.sha256(self._path.encode())
        for name in self._files:
            with suppress(OSError):
                digest.update(name.encode() + carried_files.sha256(Path(name)).encode())
        mark = digest.hexdigest() if self._files else self._path
        return f"{self.file.stem}_{mark[:16]}"

    def is_news(self, reads: Reads) -> bool:
        """Remember what was read; return whether it is other than the last time."""
        files = sorted(map(str, reads))
        if files == self._files:
            return False
        self._files = files
        with suppress(OSError):
            self._note.parent.mkdir(parents=True, exist_ok=True)
            new = self._note.with_suffix(f".{os.getpid()}")
            new.write_text(json.dumps(files), encoding="utf-8")
            new.replace(self._note)
        return True


def _execute(file: Path, name: str) -> ModuleType:
    """Run a file as module `name`; modules beside it can be imported by their names.

    No bytecode is kept: a disk that fills up cuts it, and Python takes what is cut for whole.
    """
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))  # last: it hides nothing
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None and spec.loader is not None, "a .py file has a loader"
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    finally:
        sys.dont_write_bytecode = before
    return module
