"""Only what Python calls becomes machine code of its own; what that calls becomes part of it.

numba optimises, assembles and keeps each function for itself, and does it once more in each of its
callers, since a caller links in all that its callees linked in. Python calls some 20 of the 300
functions of a rig. So a function that is compiled while another one is stays `inner`: typed,
lowered and linked into its callers, not optimised alone. When Python calls it, or somebody asks for
its address, it becomes machine code, too: a root. What callers link in of a helper of laws and
plants is kept for further ones (`kept_code.for_callers`). A `part` is a root always, so that one
process can compile it while another one is at something else (`executive.nodes.first_start`).

The bits and the speed are the same, a first start takes half the processor time.
"""

import gc
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite import binding
from numba.core import codegen, environment

_COLLECT = 50_000, 20, 100  # thresholds of the garbage collector, which took a tenth of the time


class _Depth(threading.local):
    """How many functions this thread compiles, each one for the one before."""

    now = 0


_depth = _Depth()
_parts: set[Any] = set()


def part(function: Any) -> Any:
    """Let a compiled function be a root even where another one calls it; return it."""
    _parts.add(function)
    return function


def is_part(function: Any) -> bool:
    """Return whether a function is a root even where another one calls it."""
    return function in _parts


def depth() -> int:
    """Return how many functions this thread compiles now, each for the one before."""
    return _depth.now


def inside() -> bool:
    """Return whether what is compiled now is compiled for another function."""
    return _depth.now > 1


class Library(codegen.JITCodeLibrary):
    """The code of one function: `inner` is what its callers link in, and no more."""

    inner = False

    def add_linking_library(self, library: Any) -> None:
        """Link another's code in; what nobody has asked the address of by then is inner."""
        if isinstance(library, Library):  # not numba's runtime, or what is compiled for others
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
                codegen.JITCPUCodegen.set_env(self.codegen, name, found)


class InnerFunction:
    """What the callers of an inner function know it by: nothing that Python could call."""


@contextmanager
def deeper(root: bool) -> Iterator[None]:
    """Count one function more that is compiled, or let a root begin anew."""
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
