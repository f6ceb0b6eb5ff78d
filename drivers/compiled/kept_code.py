"""Compiled code on disk, under numba: checked when it is read, and never in the way of a run.

    truncated, damaged or of another user    compiled again
    cannot be kept (disk full, read-only)    kept in a temporary folder, else compiled at each start
    shipped with a wheel                     read, where the user has none; never written

`install` puts it in the place of numba's own cache, whose errors end the program. A file is the
SHA-256 of the rest and the rest, which is numba's: an index (source stamp, signature -> name) or
the code of one function and signature. Of processes that want the same function one compiles it,
the others wait. The one place that uses private parts of numba's cache.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from numba.core import caching, dispatcher, entrypoints
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


class _Files(caching.CompileResultCacheImpl):
    _locator_classes = [_Place]  # noqa: RUF012  numba's name


class _SealedFile(caching.IndexDataCacheFile):
    """The index and the code of one function in one folder.

    Code says itself what it is of: of two processes that write at once one may take the other's
    name for it.
    """

    def save(self, key: Any, data: Any) -> None:
        """Keep `data`; OSError."""
        super().save(key, (self._index_name, key, data))

    def load(self, key: Any) -> Any:
        """Return what was kept; None if there is nothing, or nothing whole."""
        found = super().load(key)
        if found is None or found[:2] != (self._index_name, key):
            return None
        return found[2]

    def _load_index(self) -> dict[Any, str]:
        try:
            version, stamp, overloads = kept_files.read_sealed(Path(self._index_path))
        except OSError:
            return {}
        fresh = (version, stamp) == (self._version, self._source_stamp)
        return dict(overloads) if fresh else {}

    def _save_index(self, overloads: dict[Any, str]) -> None:
        self._seal(self._index_path, (self._version, self._source_stamp, overloads))

    def _load_data(self, name: str) -> Any:
        return kept_files.read_sealed(Path(self._data_path(name)))

    def _save_data(self, name: str, data: Any) -> None:
        self._seal(self._data_path(name), data)

    def _seal(self, path: str, content: Any) -> None:
        kept_files.write_sealed(Path(path), self._dump(content))


class CodeCache(caching.Cache):
    """The cache of one function: read from the first folder that has it, kept in the first one.

    It is set up when it is asked: that of a helper, whose code lies in that of its callers, never
    is at a warm start, and there are two hundred.
    """

    _impl_class: Any = _Files
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
        self._places = [_SealedFile(str(folder), base, stamp) for folder in self._folders]
        brought = [folder / where for folder in compile_cache.shipped_folders()]
        self._readable = [*self._places, *(_SealedFile(str(one), base, stamp) for one in brought)]
        return getattr(self, name)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return what was kept, without numba's registries: a tenth of a start, for compiling."""
        rtsys.initialize(context)
        return self._load_overload(signature, context)

    def _index_key(self, signature: Any, codegen: Any) -> Any:
        return (*super()._index_key(signature, codegen), content(self._function))

    def _load_overload(self, signature: Any, context: Any) -> Any:
        if not inner.inside():
            return self._cached_code(signature, context) or self._wait(signature, context)
        return self._cached_code(signature, context, "inner") if self.keeps_inner else None

    def _cached_code(self, signature: Any, context: Any, *kind: str) -> Any:
        """Return what a folder has; None, and the progress of compiling is told."""
        key = (*self._index_key(signature, context.codegen()), *kind)
        for place in self._readable if self._enabled else ():
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
        if not (self._enabled and self._impl.check_cachable(data)):
            return
        if data.library.inner and not self.keeps_inner:
            return
        key = self._index_key(signature, data.codegen)
        key = (*key, "inner") if data.library.inner else key
        content = self._function.__code__.co_filename, self._impl.reduce(data)
        kept_files.keep_first(self._folders, lambda place: self._places[place].save(key, content))

    @contextmanager
    def _guard_against_spurious_io_errors(self) -> Iterator[None]:
        yield


def for_callers(function: Any) -> Any:
    """Let what callers link in of a compiled function be kept for further ones; return it.

    Laws and plants share such helpers; those of the loop are part of one function.
    """
    if isinstance(getattr(function, "_cache", None), CodeCache):
        function._cache.keeps_inner = True
    return function


def install() -> None:
    """Let numba keep compiled code here, and look for others' extensions only to compile."""
    dispatcher.FunctionCache = CodeCache  # type: ignore[attr-defined]
    made: Any = dispatcher.Dispatcher
    made._compilation_chain_init_hook = _extend


def _extend(function: Any) -> None:
    """Look for extensions of numba before a function's arguments have types, but for ours."""
    if not isinstance(function._cache, CodeCache):
        entrypoints.init_all()
