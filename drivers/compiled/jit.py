"""How everything here is compiled: one set of numba options and a cache that cannot go stale.

Compiled code is kept by `drivers.compiled.kept_code`, and what Python calls so that numba is not
needed to find it, by `drivers.compiled.ready_code`. The processor is `generic`, so that the cache
also serves another machine or an emulated one.

Everything else gets numba from `drivers.compiled.in_numba`, because numba reads its environment
when it is first imported. `numba`, `njit` (of `drivers.compiled.target`), `from_dtype`, `carray` of
this module import it, and so does what `types` has but `void`, `Array`, `UniTuple`.

Switches, read once at import (they select what is compiled, so they cannot be arguments):

    NUMBA_DISABLE_JIT=1      everything runs interpreted: debugging, and the bit-identity tests
    PCPC_LOOP=interpreted    only the loop runs interpreted: for buses that only python-can has
    PCPC_CPU=native          for this machine's processor: lanes in its widest registers; equal bits
"""

import os
import platform
from collections.abc import Callable
from functools import update_wrapper
from threading import RLock
from typing import Any, TypeVar

from pcpc.drivers.compiled import kinds, ready_code
from pcpc.drivers.compiled.deferred import open_numba
from pcpc.drivers.compiled.kinds import Kind, Signature, UnmarkedValue, f8, i8, u1

__all__ = [
    "JIT_OFF", "LOOP_INTERPRETED", "OPTIONS", "VIEW", "Function", "compiled", "f8", "i8", "inline",
    "loop", "loop_function", "loop_inline", "loop_part", "types", "u1",
]  # fmt: skip

_FEATURES = {  # every machine of the kind has these; empty means what this one has
    "x86_64": "+64bit,+cmov,+cx8,+fxsr,+mmx,+sse,+sse2",
    "aarch64": "+fp-armv8,+neon",
}
_WIDE = {  # LLVM halves a lane on Intel's processors, whose name says that they prefer it
    "x86_64": ",-prefer-256-bit",
}
if os.environ.get("PCPC_CPU") == "native":
    from llvmlite import binding

    os.environ.setdefault("NUMBA_CPU_NAME", binding.get_host_cpu_name())
    _OWN = binding.get_host_cpu_features().flatten() + _WIDE.get(platform.machine(), "")
    os.environ.setdefault("NUMBA_CPU_FEATURES", _OWN)
os.environ.setdefault("NUMBA_CPU_NAME", "generic")
os.environ.setdefault("NUMBA_CPU_FEATURES", _FEATURES.get(platform.machine(), ""))


def _is_off() -> bool:
    """Return whether numba is switched off, as numba reads it."""
    try:
        return bool(int(os.environ.get("NUMBA_DISABLE_JIT", "0")))
    except ValueError:
        return False


JIT_OFF = _is_off()
LOOP_INTERPRETED = JIT_OFF or os.environ.get("PCPC_LOOP") == "interpreted"

OPTIONS: dict[str, Any] = {
    "nogil": True,
    "cache": True,
    "error_model": "numpy",
    "fastmath": False,
    "boundscheck": False,
}
_BARE = OPTIONS | {"cache": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}

VIEW = f8[::1]


class _Types:
    """Types for signatures; all others are numba's."""

    void, float64, int64, uint8 = kinds.nothing, f8, i8, u1

    @staticmethod
    def UniTuple(kind: Kind, count: int) -> Kind:
        """Return the type of a tuple of so many alike."""
        return kinds.tuple_of(kind, count)

    @staticmethod
    def Array(kind: Kind, dimensions: int, order: str) -> Kind:
        """Return the type of an array."""
        return kinds.array(kind, dimensions, order)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "py_func":  # who looks for functions among names
            raise AttributeError(name)
        return getattr(open_numba().types, name)


types: Any = _Types()


def __getattr__(name: str) -> Any:
    if name not in ("numba", "njit", "from_dtype", "carray"):
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(open_numba(), name)


_one_at_a_time = RLock()
_F = TypeVar("_F", bound=Callable[..., Any])


class Function:
    """A function of compiled code. What Python calls of them is kept ready; numba has the rest.

    For its arguments, if they have marks (`drivers.compiled.kinds`), it is machine code called by
    its address. Else, and where compiled code calls it, it is what numba makes of it.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        signature: Signature | None = None,
        for_callers: bool = False,
        part: bool = False,
        **options: Any,
    ) -> None:
        """`for_callers`, `part`: see `kept_code`, `inner`. Compiles what has a signature."""
        self.py_func, self._signature = function, signature
        self._options, self._for_callers, self._part = options, for_callers, part
        update_wrapper(self, function)
        self._source = ready_code.ImportedFunction(function)
        self._made: Any = None
        self._bound: dict[Any, Callable[..., Any]] = {}
        self._places: dict[tuple[str, ...], int] = {}
        if signature is not None and not self._source.has(self._key(signature.marks)):
            self._bind(signature.marks)

    def __call__(self, *arguments: Any) -> Any:
        """Call it; what numba raises for arguments that it cannot take."""
        try:
            marks = tuple(map(kinds.mark_of, arguments))
        except UnmarkedValue:
            return self.in_numba(*arguments)
        bound = self._bound.get(marks)
        if bound is None:
            if self._signature is not None and marks != self._signature.marks:
                return self.in_numba(*arguments)
            bound = self._bind(marks, arguments)
        return bound(*arguments)

    @property
    def in_numba(self) -> Any:
        """The same as numba has it, for what else is compiled."""
        if self._made is None:
            with _one_at_a_time:
                self._made = open_numba().dispatcher(
                    self.py_func,
                    self._signature,
                    OPTIONS | self._options,
                    self._for_callers,
                    self._part,
                )
        return self._made

    def compile(self, arguments: tuple[Kind, ...]) -> None:
        """Compile it, unless it is kept; a part for its callers."""
        if self._part:
            self.in_numba.compile(tuple(kind.in_numba() for kind in arguments))
        else:
            self._bind(tuple(kind.mark for kind in arguments), kinds=arguments)

    def address(self, arguments: tuple[Kind, ...]) -> int:
        """Return where its code for these arguments lies; compile it if it is not kept."""
        marks = tuple(kind.mark for kind in arguments)
        with _one_at_a_time:
            if marks not in self._places:
                code = self._source.load(self._key(marks)) or self._compiled_code(
                    marks, (), arguments
                )
                self._places[marks] = code.address
        return self._places[marks]

    def __reduce__(self) -> Any:
        return _itself, (self.in_numba,)

    def _key(self, marks: tuple[str, ...]) -> str:
        result = self._signature.result.mark if self._signature is not None else "?"
        return f"{result}({','.join(marks)})"

    def _bind(
        self,
        marks: tuple[str, ...],
        arguments: tuple[Any, ...] = (),
        kinds: tuple[Kind, ...] = (),
    ) -> Callable[..., Any]:
        """Return machine code for these arguments, kept or compiled now; else numba's function."""
        with _one_at_a_time:
            code = self._source.load(self._key(marks)) or self._compiled_code(
                marks, arguments, kinds
            )
            found = code.bound(marks) if code.address else self.in_numba
            self._bound[marks] = found
        return found

    def _compiled_code(
        self, marks: tuple[str, ...], arguments: tuple[Any, ...], kinds: tuple[Kind, ...]
    ) -> ready_code.ReadyFunction:
        if not self._source.can_be_kept:
            return ready_code.ReadyFunction(0, "")
        with_numba = open_numba()

        def kinds_in_numba() -> Any:
            if self._signature is not None:
                return self._signature.in_numba()
            return with_numba.types_of(arguments, kinds)

        try:
            ready: ready_code.ReadyFunction = with_numba.compiled(
                self._source, self._key(marks), self.py_func, kinds_in_numba, _BARE | self._options
            )
        except Exception:
            if self._signature is not None:
                raise
            return ready_code.ReadyFunction(0, "")  # numba says more when it is called
        return ready


def _itself(made: Any) -> Any:
    return made


def _function(signature: tuple[Any, ...], for_callers: bool = False) -> Callable[..., Any]:
    """Return what compiles a function with a signature of ours, of numba's, or none."""
    if JIT_OFF:
        return lambda function: function
    if len(signature) > 1 or not all(isinstance(one, Signature) for one in signature):
        found: Callable[..., Any] = open_numba().decorator(signature, OPTIONS, for_callers)
        return found
    ours = signature[0] if signature else None
    return lambda function: Function(function, ours, for_callers=for_callers)


def inline(function: Callable[..., Any]) -> Any:
    """Compile a helper that stages and loops call; always inlined."""
    return function if JIT_OFF else Function(function, for_callers=True, forceinline=True)


def compiled(*signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function with one explicit signature, or on first call when none is given."""
    return _function(signature, for_callers=True)


def loop(*signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """As `compiled`, for what is plain Python when the loop runs interpreted (libc, bus, cycle)."""
    if LOOP_INTERPRETED:
        return lambda function: function
    return _function(signature)


def loop_function(function: _F) -> _F:
    """As `loop`, on first call: the loop's larger parts, which stay functions (compile time)."""
    return function if LOOP_INTERPRETED else _typed(Function(function))


def loop_part(function: _F) -> _F:
    """As `loop_function`, compiled and kept by itself: perhaps by another process meanwhile."""
    return function if LOOP_INTERPRETED else _typed(Function(function, part=True))


def loop_inline(function: _F) -> _F:
    """As `inline`, for what must be plain Python when the loop runs interpreted."""
    return function if LOOP_INTERPRETED else _typed(Function(function, forceinline=True))


def _typed(function: Any) -> Any:
    """Let mypy take it for what it was made of, so that its arguments are checked."""
    return function
