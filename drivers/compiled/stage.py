"""Stages: the compiled steps of blocks, all callable through one type of pointer.

A stage is `step(t, dt, p, x, u, y)`; the annotations of the last four name the declarations of its
parameters, states, inputs and outputs (`executive.laws.ports`), and by them numba knows where each
value lies. What the loop gets of it is an address: a function of two numbers and four pointers, the
same for every stage.
"""

import ctypes
import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

# ruff: isort: off
from pcpc.drivers.compiled.jit import JIT_OFF, LOOP_INTERPRETED, OPTIONS, f8, i8, numba, types
from pcpc.drivers.compiled.lanes import LANE
from pcpc.drivers.compiled.views import POINTER, Layout, View, pointer_at
from llvmlite import ir
from numba.core.compiler import Compiler  # after ours, which set numba's environment
from numba.extending import intrinsic
# ruff: isort: on

_IN_C = ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.c_double, *[ctypes.c_void_p] * 4)


class _NoAlias(Compiler):
    """Parameters, states, inputs and outputs are disjoint: stores to one change no other."""

    def __init__(self, *arguments: Any) -> None:
        typingctx, targetctx, library, args, return_type, flags, local = arguments
        flags.noalias = True
        super().__init__(typingctx, targetctx, library, args, return_type, flags, local)


_OPTIONS = OPTIONS | {"pipeline_class": _NoAlias, "_nrt": False, "no_cpython_wrapper": True}


class Stage:
    """A step; compiled, unless numba is switched off. TypeError: the arguments are not a step's."""

    def __init__(self, function: Callable[..., None]) -> None:
        self.py_func = function
        self.__doc__, self.__name__ = function.__doc__, function.__name__
        self.declared = _declared(function)
        self._single: Any = None if JIT_OFF else self._compiled(f8)
        self._of_lanes: Any = None
        self._in_c: Any = None

    @property
    def entry(self) -> Any:
        """What `call` takes: an address, for the compiled loop."""
        return self if LOOP_INTERPRETED else _address(self._single, "llvm_func_name")

    @property
    def entry_of_lanes(self) -> int:
        """What `call` takes for a step of all lanes at once; numba's TypingError if it cannot."""
        if self._of_lanes is None:
            self._of_lanes = self._compiled(LANE)
        return _address(self._of_lanes, "llvm_func_name")

    def __call__(self, t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
        """Step on float64 vectors, which may be longer than what is declared."""
        views = (p, x, u, y)
        if self._single is None:
            named = zip(self.declared, views, "pxuy", strict=True)
            self.py_func(t, dt, *(ports(view, letter) for ports, view, letter in named))
            return
        for ports, view, letter in zip(self.declared, views, "pxuy", strict=True):
            _check(view, ports.size, letter)
        if self._in_c is None:
            self._in_c = _IN_C(_address(self._single, "llvm_cfunc_wrapper_name"))
        self._in_c(t, dt, *(view.ctypes.data for view in views))

    def _compiled(self, element: Any) -> Any:
        kinds = [View(declared.layout, element) for declared in self.declared]
        return numba.njit(types.void(f8, f8, *kinds), **_OPTIONS)(self.py_func)


def _address(dispatcher: Any, name: str) -> int:
    (found,) = dispatcher.overloads.values()
    return int(found.library.get_pointer_to_function(getattr(found.fndesc, name)))


def stage(function: Callable[..., None]) -> Any:
    """Make `step(t, dt, p, x, u, y)` the step of a block: t, dt in s, ports by name; no result.

    It cannot allocate: numba refuses anything that needs memory of its own. TypeError: its
    arguments are not a step's.
    """
    return Stage(function)


def _declared(function: Callable[..., None]) -> tuple[Any, ...]:
    """Return what the annotations of p, x, u, y name; TypeError says what a step looks like."""
    names = list(inspect.signature(function).parameters)
    where = f"line {function.__code__.co_firstlineno}: the step"
    if len(names) != 6:
        raise TypeError(f"{where} is not step(t, dt, p, x, u, y)")
    notes = inspect.get_annotations(function, eval_str=True)
    found = tuple(notes.get(name) for name in names[2:])
    for name, ports in zip(names[2:], found, strict=True):
        if not isinstance(getattr(ports, "layout", None), Layout):
            raise TypeError(
                f"{where} does not say which ports {name} has: `{name}: Gains` with a class Gains "
                f"of ports, or `{name}: Nothing`"
            )
    return found


def _check(view: Any, size: int, letter: str) -> None:
    fits = isinstance(view, np.ndarray) and view.dtype == np.float64 and view.ndim == 1
    if not fits or not view.flags.c_contiguous or len(view) < size:
        raise TypeError(f"{letter}: expected a contiguous float64 vector of at least {size} values")


@intrinsic
def _call(
    typing: Any, entry: Any, t: Any, dt: Any, p: Any, x: Any, u: Any, y: Any
) -> Any:  # numba takes the arguments by position
    """Step the stage at an address; what it raises goes on to the caller."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        convention, kinds = context.call_conv, signature.args[1:]
        kind = ir.PointerType(convention.get_function_type(types.none, kinds))
        function = builder.inttoptr(arguments[0], kind)
        status, _ = convention.call_function(
            builder, function, types.none, kinds, list(arguments[1:])
        )
        with builder.if_then(status.is_error, likely=False):
            convention.return_status_propagate(builder, status)
        return context.get_dummy_value()

    return types.none(i8, f8, f8, POINTER, POINTER, POINTER, POINTER), generate


def _call_interpreted(entry: Stage, *arguments: Any) -> None:
    entry(*arguments)


def _part(values: Any, place: Any) -> Any:
    return values[place:]


ENTRY = i8  # the type of an address
call: Any = _call_interpreted if LOOP_INTERPRETED else _call
part: Any = _part if LOOP_INTERPRETED else pointer_at  # of the table, for a step
