"""Compiled code that Python calls, kept so that it is found and run without numba.

A file has the object code of one function for arguments of certain marks (`drivers.compiled.kinds`)
and what else it was made from. `llvmlite` puts it into memory; Python calls it by its address in
numba's convention: a place for the result, one for an exception, then the numbers and addresses of
which the arguments consist. A function that cannot be called so, since it needs memory of its own
or numba's runtime, has a file that says so.
"""

import ctypes
import hashlib
import os
import pickle
import platform
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, cached_property
from pathlib import Path
from typing import IO, Any, NamedTuple

from pcpc.drivers.compiled import compile_cache, kept_files
from pcpc.drivers.compiled.kinds import leaves_of

_RESULTS = {"d": ctypes.c_double, "q": ctypes.c_int64, "?": ctypes.c_bool}
_NONE = -2  # numba's status of a function that returns None
_SIMPLE = {"d": ctypes.c_double, "q": ctypes.c_int64}
_RUNTIME = ("NRT_", "numba_", "Py", "_Py")  # begin names that only numba and Python know together
_NEVER_CALLED = "NRT_MemInfo_call_dtor"  # where nothing is allocated, nothing is freed


class ReadyFunction(NamedTuple):
    """The address of a function, 0 if only numba can call it, and the mark of its result."""

    address: int
    result: str

    def bound(self, marks: tuple[str, ...]) -> Callable[..., Any]:
        """Return what calls it with arguments of these marks."""
        convention = [ctypes.c_void_p, ctypes.c_void_p, *_in_c(marks)]
        function = ctypes.CFUNCTYPE(ctypes.c_int, *convention)(self.address)
        several = self.result.startswith("(")
        kinds = self.result.strip("()").split(",") if self.result else []
        result_type: Any = ctypes.c_int64
        if kinds:
            result_type = _RESULTS[kinds[0]]
        if several:
            named = [(f"_{i}", _RESULTS[kind]) for i, kind in enumerate(kinds)]
            result_type = type("_Place", (ctypes.Structure,), {"_fields_": named})
        simple = all(mark == "d" for mark in marks)

        def call(*arguments: Any) -> Any:
            leaves: Any = arguments
            if not simple:
                leaves = []
                leaves_of(arguments, leaves)
            result, error = result_type(), ctypes.c_void_p()
            status = function(ctypes.byref(result), ctypes.byref(error), *leaves)
            if status > 0:
                _raise(error)
            if status not in (0, _NONE):
                raise RuntimeError(f"compiled code ended with status {status}")
            if several:
                return tuple(getattr(result, name) for name, _ in named)
            return result.value if kinds else None

        return call


def _in_c(marks: tuple[str, ...]) -> list[Any]:
    """Return the types in C of what `leaves_of` makes of arguments."""
    c_types: list[Any] = []
    for mark in ",".join(marks).replace("(", "").replace(")", "").split(","):
        if mark in _SIMPLE:
            c_types.append(_SIMPLE[mark])
        elif mark.startswith("s"):
            c_types.append(ctypes.c_void_p)
        elif mark:
            dimensions = int(mark.removeprefix("r")[2])
            c_types += [ctypes.c_void_p] * 2 + [ctypes.c_int64] * 2 + [ctypes.c_void_p]
            c_types += [ctypes.c_int64] * (2 * dimensions)
    return c_types


class _ExceptionRecord(ctypes.Structure):
    """What compiled code says of an exception that it raises."""

    _fields_ = (
        ("pickled", ctypes.c_void_p), ("size", ctypes.c_int32), ("hash", ctypes.c_void_p),
        ("unwrap", ctypes.c_void_p), ("dynamic", ctypes.c_int32),
    )  # fmt: skip


def _raise(error: ctypes.c_void_p) -> None:
    told = _ExceptionRecord.from_address(error.value or 0)
    kind, arguments, origin = pickle.loads(ctypes.string_at(told.pickled, told.size))
    raised = kind(*arguments or ())
    if origin is None:
        raise raised
    name, file, line = origin
    text = "\n" * (line - 1) + "raise _raised"  # so that the traceback names its line, as numba's
    code = compile(text, file, "exec").replace(co_name=name)
    exec(code, {"_raised": raised})


class ImportedFunction:
    """A function as it was imported, and the files of its compiled code."""

    def __init__(self, function: Any, more: str = "") -> None:
        """`more`: how else it is compiled."""
        self._function, self._more = function, more
        self._read = kept_files.state_of(function)

    @property
    def can_be_kept(self) -> bool:
        """Whether it is known what its code depends on: a file, and constants."""
        return bool(self._place)

    def has(self, key: str) -> bool:
        """Return whether there is a file for arguments and result of these marks."""
        return any(path.is_file() for path in self._files(key))

    def load(self, key: str) -> ReadyFunction | None:
        """Put what is kept into memory; None if there is nothing, or nothing whole."""
        for path in self._files(key):
            try:
                text, file, symbol, result, content = kept_files.read_sealed(path)
            except (OSError, ValueError):
                continue
            if text != self._text(key):
                continue
            compile_cache.was_compiled(file, self._function.__code__.co_filename)
            return ReadyFunction(_address(content, symbol) if symbol else 0, result)
        return None

    def keep(self, key: str, symbol: str, result: str, content: bytes) -> None:
        """Keep object code, if it can be; no `symbol`: only numba can call the function."""
        if not self.can_be_kept:
            return
        file = self._function.__code__.co_filename
        rest = pickle.dumps((self._text(key), file, symbol, result, content), -1)
        kept_files.keep_first(
            self._folders,
            lambda place: kept_files.write_sealed(self._folders[place] / self._name(key), rest),
        )

    @contextmanager
    def claim(self) -> Iterator[None]:
        """Let one process at a time compile it."""
        lock: IO[bytes] | None = None
        if self._folders:
            lock = kept_files.claim(self._folders[0], f"{self._base}.run")
        try:
            yield
        finally:
            if lock is not None:
                lock.close()

    @cached_property
    def _place(self) -> str:
        """The subfolder, as `kept_code` has it; "" for a function without a file."""
        file = self._function.__code__.co_filename
        closed = kept_files.is_closed(self._function)
        if self._read is None or not closed or not os.path.isfile(file):
            return ""
        above = os.path.dirname(os.path.abspath(file))
        by_path = f"{os.path.basename(above)}_{hashlib.sha1(above.encode()).hexdigest()}"
        return compile_cache.place(file) or f"{by_path}_{compile_cache.full_hash()}"

    @cached_property
    def _base(self) -> str:
        code = self._function.__code__
        module = os.path.splitext(os.path.basename(code.co_filename))[0]
        name = f"{module}.{self._function.__qualname__}".replace("<", "").replace(">", "")
        major, minor = sys.version_info[:2]
        return f"{name}-{code.co_firstlineno}.py{major}{minor}{sys.abiflags}"

    @cached_property
    def _folders(self) -> list[Path]:
        """Where it is written."""
        return [one / self._place for one in compile_cache.folders()] if self._place else []

    def _name(self, key: str) -> str:
        digest = hashlib.sha256(self._text(key).encode()).hexdigest()
        return f"{self._base}.{digest[:12]}.nbc"

    def _files(self, key: str) -> list[Path]:
        if not self._place:
            return []
        brought = [one / self._place for one in compile_cache.shipped_folders()]
        return [folder / self._name(key) for folder in (*self._folders, *brought)]

    def _text(self, key: str) -> str:
        return f"{key}\n{self._made_from}"

    @cached_property
    def _made_from(self) -> str:
        """All that the code depends on but its arguments and what the folder's name says."""
        function = self._function
        file = function.__code__.co_filename
        cpu = [os.environ.get(f"NUMBA_CPU_{name}", "") for name in ("NAME", "FEATURES")]
        now = kept_files.state_now(file)
        edited = "" if now == self._read else f"edited since {self._read}"
        what = kept_files.meaning(function), kept_files.content(function), _digest(file, now)
        return "\n".join((self._base, self._more, platform.machine(), *cpu, *what, edited))


@cache
def _digest(file: str, state: Any) -> str:
    """Return 64 digits for the text of a file in a certain state."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


@cache
def _engine() -> Any:
    from llvmlite import binding  # here, because its library is large

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    if not binding.address_of_symbol(_NEVER_CALLED):  # numba, should it come, puts its own there
        abort = ctypes.cast(ctypes.CDLL(None).abort, ctypes.c_void_p).value
        binding.add_symbol(_NEVER_CALLED, abort)
    machine = binding.Target.from_default_triple().create_target_machine(jit=True)
    return binding.create_mcjit_compiler(binding.parse_assembly(""), machine)


def _address(content: bytes, symbol: str) -> int:
    """Put object code into memory for good and return the address of a function in it."""
    from llvmlite.binding import object_file

    engine = _engine()
    engine.add_object_file(object_file.ObjectFileRef.from_data(content))
    engine.finalize_object()
    return int(engine.get_function_address(symbol))


def needs_runtime(declared: Iterator[str]) -> bool:
    """Return whether one of the names that object code asks for is known to numba alone."""
    return any(name.startswith(_RUNTIME) and name != _NEVER_CALLED for name in declared)
