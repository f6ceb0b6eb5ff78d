"""The target of numba's that everything here is compiled for: numba's processor, in our way.

Dispatcher, context and code generator are classes derived from numba's (as in
`numba.core.target_extension`); what they do otherwise is `drivers.compiled.inner` and
`drivers.compiled.kept_code`. What somebody else compiles in the same process with `numba.njit` goes
numba's own way. It may be called from here, and call what is here.
"""

from functools import cached_property, partial
from typing import Any

import numba
from numba.core import codegen, cpu, dispatcher, registry, sigutils, target_extension, types

from pcpc.drivers.compiled import inner, kept_code

TARGET = "pcpc"
_untyped: Any = dispatcher  # numba's types do not name all that a target derives from


class _Codegen(codegen.JITCPUCodegen):
    """Numba's code generator, of libraries that may be inner."""

    _library_class = inner.Library

    def set_env(self, env_name: str, env: Any) -> None:
        """Let a root's code find its constants; an inner function's are set with its caller's."""
        if not inner.inside():
            super().set_env(env_name, env)


class _Context(cpu.CPUContext):
    """How a function is lowered and becomes something to call."""

    def init(self) -> None:
        """Set up the code generator, as numba's context does, but of ours."""
        super().init()
        self._internal_codegen = _Codegen("pcpc.exec")

    def get_executable(self, library: Any, fndesc: Any, env: Any) -> Any:
        """Return what Python calls; of an inner function what callers know it by."""
        if not inner.inside():
            return super().get_executable(library, fndesc, env)
        library.inner = True
        return inner.InnerFunction()

    def get_function(self, fn: Any, sig: Any, _firstcall: bool = True) -> Any:
        """Return how a function is called, also one that was compiled for numba's own target.

        Numba keeps what it compiled of its own helpers, of an array's slice say, once for all
        targets: it may be of either.
        """
        if isinstance(fn, types.Callable):
            key, theirs = fn.get_impl_key(sig.as_function()), registry.cpu_target.target_context
            if key not in self._defns and key in theirs._defns:
                self._defns[key] = theirs._defns[key]
        return super().get_function(fn, sig, _firstcall)


class _Descriptor(registry.CPUTarget):
    """The target: contexts of its own, made when they are first asked for."""

    @cached_property
    def _toplevel_target_context(self) -> Any:
        return _Context(self.typing_context, self._target_name)


class _Compiler(_untyped._FunctionCompiler):
    """Numba's compiler of one function, without wrappers for Python where it stays inner."""

    def _customize_flags(self, flags: Any) -> Any:
        if inner.inside():
            flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        return flags


class Dispatcher(_untyped.Dispatcher):
    """A function of ours, for numba: its code by the types of its arguments."""

    targetdescr = _Descriptor(TARGET)

    def __init__(self, py_func: Any, locals: Any, targetoptions: Any, **others: Any) -> None:
        super().__init__(py_func, locals, targetoptions, **others)
        made: Any = self._compiler
        self._compiler: Any = _Compiler(
            py_func, self.targetdescr, targetoptions, made.locals, made.pipeline_class
        )

    def enable_caching(self) -> None:
        """Keep its code where ours is kept."""
        self._cache = kept_code.CodeCache(self.py_func)

    def compile(self, sig: Any) -> Any:
        """Compile it for a signature, inner if it is compiled for another function."""
        known = self.overloads.get(tuple(sigutils.normalize_signature(sig)[0]))
        if known is not None and (inner.depth() or not known.library.inner):
            return known.entry_point
        if known is not None:  # Python calls it now: it is compiled again
            del self.overloads[tuple(known.signature.args)]
        with inner.deeper(root=inner.is_part(self)):
            try:
                return super().compile(sig)
            finally:
                if isinstance(self._cache, kept_code.CodeCache):
                    self._cache.release()

    def get_compile_result(self, sig: Any) -> Any:
        """Return its code with an address, for who calls it by one."""
        with inner.outermost():
            self.compile(sig)
        return super().get_compile_result(sig)

    def add_overload(self, cres: Any) -> None:
        """Add its code for a signature; Python calls no inner one."""
        if isinstance(cres.entry_point, inner.InnerFunction):
            self.overloads[tuple(cres.signature.args)] = cres
        else:
            super().add_overload(cres)
        theirs = registry.cpu_target.target_context  # whose functions may call it
        theirs.insert_user_function(cres.entry_point, cres.fndesc, [cres.library])

    def _compilation_chain_init_hook(self) -> None:
        """Look for others' extensions of numba only to compile what is not kept."""
        if not isinstance(self._cache, kept_code.CodeCache):
            super()._compilation_chain_init_hook()


def njit(*signature: Any, **options: Any) -> Any:
    """Return numba's `njit`, for this target."""
    untyped: Any = numba
    return untyped.njit(*signature, _target=TARGET, **options)


class _Pcpc(target_extension.CPU):
    """A processor like numba's own: what is made for that one serves here, too."""


target_extension.target_registry[TARGET] = _Pcpc
target_extension.dispatcher_registry[_Pcpc] = Dispatcher
target_extension.jit_registry[_Pcpc] = partial(numba.jit, _target=TARGET)
