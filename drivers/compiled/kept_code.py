"""Compiled code on disk, under numba: checked when it is read, and never in the way of a run.

    truncated, damaged or of another user    compiled again
    cannot be kept (disk full, read-only)    kept in a temporary folder, else compiled at each start
    shipped with a wheel                     read, where the user has none; never written

It stands in the place of numba's own cache, whose errors end the program. A file is the
SHA-256 of the rest and the rest: what it is of, as a text, and numba's code of one function and
signature. There is no index, in which processes would lose each other's entries. Of processes that
want the same function one compiles it, the others wait. The one place that uses private parts of
numba's cache.

numba tells functions of one name and signature apart by a number, which it counts anew in each
process: kept code of two processes could have one name for two functions, and whoever links or
loads both gets one of them for both. So the numbers of a process begin where no other's do.
"""

import hashlib
import itertools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numba
from numba.core import bytecode, caching, serialize, sigutils, types
from numba.core.runtime.nrt import rtsys

from pcpc.drivers.compiled import compile_cache, inner, kept_files
from pcpc.drivers.compiled.kept_files import content, state_of


class _Place(caching.UserProvidedCacheLocator):
    """A subfolder for the functions of a folder; nothing is made before there is what to keep."""

    def __init__(self, function: Any, file: str) -> None:
        self._py_file, self._lineno = file, function.__code__.co_firstlineno
        by_path = f"{self.get_suitable_cache_subpath(file)}_{compile_cache.full_hash()}"
        self._cache_path = compile_cache.place(file) or by_path

    @classmethod
    def from_function(cls, function: Any, file: str) -> "_Place | None":
        return cls(function, file) if Path(file).exists() else None

    def ensure_cache_path(self) -> None:
        """Do nothing."""


class _Results(caching.CompileResultCacheImpl):
    _locator_classes = [_Place]  # noqa: RUF012  numba's name


class _Files:
    """The code of one function in one folder: a file for each key.

    What a file has is unpickled only if its name says that it is wanted. A signature may have
    functions in it, of which unpickling makes new ones, of another process, and compiles them.
    """

    def __init__(self, folder: Path, base: str, stamp: str) -> None:
        self._folder, self._base, self._stamp = folder, base, stamp

    def save(self, key: str, data: Any) -> None:
        """Keep `data`; OSError."""
        kept_files.write_sealed(self._path(key), serialize.dumps((self._stamp, key, data)))

    def load(self, key: str) -> Any:
        """Return what was kept; None if there is nothing, or nothing whole."""
        try:
            stamp, of, data = kept_files.read_sealed(self._path(key))
        except (OSError, ValueError):
            return None
        return data if (stamp, of) == (self._stamp, key) else None

    def _path(self, key: str) -> Path:
        digest = hashlib.sha256(key.encode()).hexdigest()
        return self._folder / f"{self._base}.{digest[:16]}.nbc"


class CodeCache(caching.Cache):
    """The cache of one function: read from the first folder that has it, kept in the first one.

    It is set up when it is asked: that of a helper, whose code lies in that of its callers, never
    is at a warm start, and there are two hundred.
    """

    _impl_class: Any = _Results
    keeps_inner = False  # also for those that call it, see `inner`

    def __init__(self, function: Any) -> None:
        self._function, self._read = function, state_of(function)
        self._claim: IO[bytes] | None = None

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or "_impl" in vars(self):
            raise AttributeError(name)
        super().__init__(self._function)
        where, base = self._impl.locator.get_cache_path(), self._impl.filename_base
        stamp = self._impl.locator.get_source_stamp()
        if (
            kept_files.state_now(self._function.__code__.co_filename) != self._read
        ):  # it is not this text that was imported
            stamp = f"{stamp} edited since {self._read}"
        self._folders = [folder / where for folder in compile_cache.folders()]
        stamp = f"{numba.__version__} {stamp}"
        self._places = [_Files(folder, base, stamp) for folder in self._folders]
        brought = [folder / where for folder in compile_cache.shipped_folders()]
        self._readable = [*self._places, *(_Files(one, base, stamp) for one in brought)]
        return getattr(self, name)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return what was kept, without numba's registries: a tenth of a start, for compiling."""
        rtsys.initialize(context)
        return self._load_overload(signature, context)

    def _key(self, signature: Any, codegen: Any, inner: bool) -> str:
        """Return what the code is of; "" where no other process can know that it is the same.

        That is so of a function that takes functions, or closes over them.
        """
        arguments, result = sigutils.normalize_signature(signature)
        kinds = [_name_of(kind) for kind in arguments]
        if not (self._enabled and all(kinds) and kept_files.is_closed(self._function)):
            return ""
        own = kept_files.meaning(self._function), content(self._function)
        parts = (*kinds, str(result), *codegen.magic_tuple(), *own, "inner" if inner else "root")
        return "\n".join(parts)

    def _load_overload(self, signature: Any, context: Any) -> Any:
        if not inner.inside():
            return self._cached_code(signature, context) or self._wait(signature, context)
        return self._cached_code(signature, context, inner=True) if self.keeps_inner else None

    def _cached_code(self, signature: Any, context: Any, inner: bool = False) -> Any:
        """Return what a folder has; None, and the progress of compiling is told."""
        key = self._key(signature, context.codegen(), inner)
        for place in self._readable if key else ():
            if found := place.load(key):
                file, data = found
                compile_cache.was_compiled(file, self._function.__code__.co_filename)
                return self._impl.rebuild(context, data)
        watch = compile_cache.watch
        if watch.listener is not None:
            watch.listener(watch.done)
        return None

    def _wait(self, signature: Any, context: Any) -> Any:
        """Wait for who compiles this function, return what it has kept; None: it is on us now."""
        if not self._folders or self._claim is not None:
            return None
        self._claim = kept_files.claim(self._folders[0], self._impl.filename_base)
        if self._claim is None:
            return None
        return self._cached_code(signature, context)

    def release(self) -> None:
        """Let other processes compile this function."""
        if self._claim is not None:
            self._claim.close()
            self._claim = None

    def _save_overload(self, signature: Any, data: Any) -> None:
        compile_cache.watch.done += 1
        library = data.library
        if data.lifted or library.has_dynamic_globals or (library.inner and not self.keeps_inner):
            return
        if key := self._key(signature, data.codegen, library.inner):
            file = self._function.__code__.co_filename
            content = file, self._impl.reduce(data)
            kept_files.keep_first(
                self._folders, lambda place: self._places[place].save(key, content)
            )

    @contextmanager
    def _guard_against_spurious_io_errors(self) -> Iterator[None]:
        yield


def _name_of(kind: Any) -> str:
    """Return what a type of an argument is the same by in all processes; "" for a function."""
    if isinstance(kind, types.Callable):
        return ""
    if not isinstance(kind, types.BaseTuple):
        return str(kind)
    members: Any = kind
    names = [_name_of(member) for member in members]
    made = getattr(kind, "instance_class", tuple)
    of = made.__module__, made.__qualname__, getattr(kind, "fields", ()), names
    return str(of) if all(names) else ""


def _number_anew() -> None:
    """Let the names of functions that are compiled from now on be those of no other process."""
    identity: Any = bytecode.FunctionIdentity
    identity._unique_ids = itertools.count(int.from_bytes(os.urandom(6)))


def for_callers(function: Any) -> Any:
    """Let what callers link in of a compiled function be kept for further ones; return it.

    Laws and plants share such helpers; those of the loop are part of one function.
    """
    if isinstance(getattr(function, "_cache", None), CodeCache):
        function._cache.keeps_inner = True
    return function


_number_anew()
os.register_at_fork(after_in_child=_number_anew)
