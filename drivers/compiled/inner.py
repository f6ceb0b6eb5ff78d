"""Only what Python calls becomes machine code of its own; what that calls becomes part of it.

numba optimises, assembles and keeps each function for itself, and does it once more in each of its
callers, since a caller links in all that its callees linked in. Python calls some 20 of the 300
functions of a rig. So a function that is compiled while another one is stays `inner`: typed,
lowered and linked into its callers, not optimised alone. When Python calls it, or somebody asks for
its address, it becomes machine code, too: a root. What callers link in of a helper of laws and
plants is kept for further ones (`kept_code.for_callers`). A `part` is a root always, so that one
process can compile it while another one is at something else (`executive.nodes.first_start`).

The bits and the speed are the same, a first start takes half the processor time. Uses private
parts of numba: `install` names each of them.
"""

import gc
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite import binding
from numba.core import codegen, cpu, dispatcher, environment, sigutils

_COLLECT = 50_000, 20, 100  # thresholds of the garbage collector, which took a tenth of the time
_set_environment = codegen.JITCPUCodegen.set_env


class _Depth(threading.local):
    """How many functions this thread compiles, each one for the one before."""

    now = 0


_depth = _Depth()
_parts: set[Any] = set()


def part(function: Any) -> Any:
    """Let a compiled function be a root even where another one calls it; return it."""
    _parts.add(function)
    return function


def inside() -> bool:
    """Return whether what is compiled now is compiled for another function."""
    return _depth.now > 1


class Library(codegen.JITCodeLibrary):
    """The code of one function: `inner` is what its callers link in, and no more."""

    inner = False

    def add_linking_library(self, library: Any) -> None:
        """Link another's code in; what nobody has asked the address of by then is inner."""
        library.inner = library.inner or not library._finalized
        super().add_linking_library(library)

    def finalize(self) -> None:
        """Link; make machine code of a root."""
        if self.inner:
            for library in dict.fromkeys(self._linking_libraries):
                self._reload_init.update(library._reload_init)
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)
            self._finalize_dynamic_globals()
            self._finalized = True
            return
        super().finalize()
        self._set_environments()

    def get_pointer_to_function(self, name: str) -> int:
        """Return the address of a function of this code; 0 if there is none."""
        if self.inner and self._finalized:
            self.inner = False
            self._optimize_final_module()
            self._final_module.verify()
            self._finalize_final_module()
            self._set_environments()
        return int(super().get_pointer_to_function(name))

    def serialize_using_object_code(self) -> Any:
        """Return what is kept: of an inner function what its callers link in."""
        return (
            self.serialize_using_bitcode() if self.inner else super().serialize_using_object_code()
        )

    @classmethod
    def _unserialize(cls, own: Any, state: Any) -> Any:
        name, kind, content = state
        if kind != "bitcode":
            return super()._unserialize(own, state)
        library = cls(own, name)
        library._final_module = binding.parse_bitcode(content)
        library.inner = library._finalized = True
        return library

    def _set_environments(self) -> None:
        """Let inner functions find the constants that numba keeps as Python objects."""
        for name in [one.name for one in self._final_module.global_variables]:
            found = environment.lookup_environment(name)
            if found is not None:
                _set_environment(self.codegen, name, found)


class _Entry:
    """What the callers of an inner function know it by: nothing that Python could call."""


@contextmanager
def _deeper(root: bool) -> Iterator[None]:
    above, patience = _depth.now, gc.get_threshold()
    _depth.now = 1 if root else above + 1
    if above == 0:
        gc.set_threshold(*_COLLECT)
    try:
        yield
    finally:
        _depth.now = above
        if above == 0:
            gc.set_threshold(*patience)


@contextmanager
def outermost() -> Iterator[None]:
    """Let what is compiled in here be roots, even if another function is being compiled."""
    above, _depth.now = _depth.now, 0
    try:
        yield
    finally:
        _depth.now = above


def install() -> None:
    """Let numba compile so from now on, whoever's functions."""
    private: Any = dispatcher
    made, kinds = private.Dispatcher, private._FunctionCompiler
    compile_one, add_overload, result_of = made.compile, made.add_overload, made.get_compile_result
    customized, executable = kinds._customize_flags, cpu.CPUContext.get_executable

    def compiled(self: Any, signature: Any) -> Any:
        known = self.overloads.get(tuple(sigutils.normalize_signature(signature)[0]))
        if known is not None and (_depth.now or not known.library.inner):
            return known.entry_point
        if known is not None:  # Python calls it now: it is compiled again
            del self.overloads[tuple(known.signature.args)]
        with _deeper(root=self in _parts):
            try:
                return compile_one(self, signature)
            finally:
                if hasattr(self._cache, "release"):  # not where a function is not kept
                    self._cache.release()

    def with_address(self: Any, signature: Any) -> Any:
        with outermost():
            self.compile(signature)
        return result_of(self, signature)

    def add(self: Any, result: Any) -> None:
        if isinstance(result.entry_point, _Entry):
            self.overloads[tuple(result.signature.args)] = result
        else:
            add_overload(self, result)

    def flags_of(self: Any, flags: Any) -> Any:
        flags = customized(self, flags)
        if inside():
            flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        return flags

    def entry(self: Any, library: Any, described: Any, own: Any) -> Any:
        if not inside():
            return executable(self, library, described, own)
        library.inner = True
        return _Entry()

    def set_environment(self: Any, name: str, own: Any) -> None:
        if not inside():  # an inner function's is set with that of its caller
            _set_environment(self, name, own)

    codegen.JITCPUCodegen.set_env = set_environment  # type: ignore[method-assign]
    made.compile, made.add_overload = compiled, add
    made.get_compile_result = with_address
    kinds._customize_flags = flags_of
    cpu.CPUContext.get_executable = entry  # type: ignore[method-assign]
    codegen.JITCPUCodegen._library_class = Library
