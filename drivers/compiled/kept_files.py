"""Files of compiled code: checked when they are read, written whole or not at all (no numba here).

A file is the SHA-256 of the rest and the rest, a pickle. Of processes that want the same function
one compiles it, the others wait.
"""

import fcntl
import hashlib
import os
import pickle
import sys
import sysconfig
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from enum import EnumMeta
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import IO, Any

import numpy as np

from pcpc.drivers.compiled import compile_cache

_INSTALLED = [
    Path(__file__).parents[2],
    *(Path(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib")),
]
_CONSTANT = (bool, int, float, complex, str, bytes, tuple, np.generic)
_SEAL = hashlib.sha256().digest_size


def write_sealed(path: Path, rest: bytes) -> None:
    """Write a file at once; OSError."""
    draft = path.with_name(f"{path.name}.{os.getpid()}.{os.urandom(4).hex()}")
    try:
        draft.write_bytes(hashlib.sha256(rest).digest() + rest)
        draft.replace(path)
    except OSError:
        draft.unlink(missing_ok=True)
        raise


def keep_first(folders: Sequence[Path], keep: Callable[[int], None]) -> None:
    """Let `keep` write into the first folder, by its place, that takes it; tell the user."""
    refused = ""
    for index, folder in enumerate(folders):
        try:
            compile_cache.make(folder)
            keep(index)
        except OSError as error:
            refused = refused or error.strerror or str(error) or type(error).__name__
            continue
        tell(refused, folder.parent)
        return
    tell(refused, None)


def read_sealed(path: Path) -> Any:
    """Return what a file has; OSError."""
    sealed = path.read_bytes()
    if hashlib.sha256(sealed[_SEAL:]).digest() != sealed[:_SEAL]:
        raise OSError(f"{path}: damaged")
    try:
        return pickle.loads(sealed[_SEAL:])
    except Exception as error:
        raise OSError(f"{path}: not readable here: {error}") from None


def claim(folder: Path, name: str) -> IO[bytes] | None:
    """Wait until nobody else compiles `name`, and let others wait until what is returned closes.

    None: no room, or a disk that knows no locks.
    """
    try:
        compile_cache.make(folder)
        lock = folder / f"{name}.lock"
        lock_file = open(lock, "a+b", 0)  # noqa: SIM115  closed by who asked
        if not _is_locked(lock_file):
            _wait_for_lock(lock_file, lock)
        lock_file.truncate(0)
        lock_file.write(str(os.getpid()).encode())
    except OSError:
        return None
    return lock_file


def _is_locked(lock_file: IO[bytes]) -> bool:
    """Lock a file; return False where another process has it locked. OSError: it knows no locks."""
    try:
        fcntl.flock(lock_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _wait_for_lock(lock_file: IO[bytes], lock: Path) -> None:
    """Lock a file that another process has locked; after SHORT_S its holder is told. OSError."""

    def tell_holder() -> None:
        compile_cache.watch.tell_holder(lock.read_text(errors="replace"))

    telling = threading.Timer(min(compile_cache.SHORT_S, threading.TIMEOUT_MAX), tell_holder)
    telling.daemon = True
    telling.start()
    try:
        fcntl.flock(lock_file, fcntl.LOCK_EX)
    finally:
        telling.cancel()
        telling.join()


State = tuple[int, int] | None
_last: list[Any] = [None, "", None]  # globals, file and state of the function before


def state_of(function: Any) -> State:
    """Return the state of a function's file when it was imported: when this is first called."""
    names, file = function.__globals__, function.__code__.co_filename
    if not hasattr(function, "_pcpc_read"):
        if _last[0] is not names or _last[1] != file:
            _last[:] = names, file, state_now(file)
        function._pcpc_read = _last[2]
    found: State = function._pcpc_read
    return found


def state_now(file: str) -> State:
    """Return by what a file is known to be the same as before; None without one."""
    try:
        status = os.stat(file)
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


def content(function: FunctionType) -> str:
    """Return a digest of the code and constants that a function from outside the project can name.

    "" for one of the project. Compiled code has in it what it calls, whose file may be another one,
    and constants as they were at the import, which may make them of the environment, of a clock or
    by lot: no file tells. Those of the modules and functions that it names count, too.
    """
    digest, seen = hashlib.sha256(), set()
    pending = [function.__globals__]
    while pending:
        names = pending.pop()
        if id(names) in seen or not _is_outside(names.get("__file__")):
            continue
        seen.add(id(names))
        for name, value in sorted(names.items()):
            if isinstance(value, ModuleType):
                pending.append(vars(value))
            elif isinstance(plain := getattr(value, "py_func", value), FunctionType):
                pending.append(plain.__globals__)
                if _is_outside(plain.__globals__.get("__file__")):
                    digest.update(f"{name} {meaning(plain)}\n".encode())
            elif isinstance(value, np.ndarray):
                digest.update(f"{name} {value.dtype} {value.shape}".encode() + value.tobytes())
            elif isinstance(value, _CONSTANT) and not name.startswith("__"):
                digest.update(f"{name} {value!r}\n".encode())
            elif isinstance(value, EnumMeta):
                digest.update(f"{name} {list(value)}\n".encode())
    return digest.hexdigest() if seen else ""


def meaning(function: FunctionType) -> str:
    """Return code, defaults and closed-over constants of a function, whatever its file."""
    fixed = []
    for cell in function.__closure__ or ():
        with suppress(ValueError):  # nothing is in it yet
            fixed += [cell.cell_contents] if isinstance(cell.cell_contents, _CONSTANT) else []
    return f"{_code(function.__code__)} {function.__defaults__} {fixed}"


def is_closed(function: FunctionType) -> bool:
    """Return whether a function closes over nothing but constants."""
    try:
        return all(_is_constant(cell.cell_contents) for cell in function.__closure__ or ())
    except ValueError:  # nothing is in it yet
        return False


def _is_constant(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_is_constant, value))
    return isinstance(value, _CONSTANT)


def _code(code: CodeType) -> str:
    values = []
    for value in code.co_consts:
        of_code = _code(value) if isinstance(value, CodeType) else repr(value)
        values.append(str(sorted(map(repr, value))) if isinstance(value, frozenset) else of_code)
    return f"{code.co_code.hex()} {values} {code.co_names} {code.co_varnames} {code.co_freevars}"


def _is_outside(file: str | None) -> bool:
    """Return whether a module's file belongs neither to the project nor to what is installed."""
    return bool(file) and not any(Path(str(file)).is_relative_to(one) for one in _INSTALLED)


_told: list[str] = []  # once a process
MENDED = "it was not fit for it when this process looked, and is now"


def tell(refused: str, folder: Path | None) -> None:
    """Say where compiled code went, if not where it belongs."""
    wanted = compile_cache.cache_folder()
    if _told or (folder == wanted and wanted != compile_cache.temporary_folder()):
        return
    why = compile_cache.distrust(wanted) or refused or MENDED
    instead = "it is compiled again at every start" if folder is None else f"it goes to {folder}"
    message = f"compiled code cannot be kept in {wanted}: {why}; {instead}"
    if folder == wanted:
        message = f"this user has no home folder: compiled code goes to {folder}"
    _told.append(message)
    print(_told[0], file=sys.stderr, flush=True)
