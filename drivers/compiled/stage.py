"""Stages: the compiled steps of blocks, all callable through one type of pointer.

A stage is `step(t, dt, p, x, u, y)`; the annotations of the last four name the declarations of its
parameters, states, inputs and outputs (`executive.laws.ports`), and by them numba knows where each
value lies. What the loop gets of it is an address: a function of two numbers and four pointers, the
same for every stage.
"""

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

from pcpc.drivers.compiled import ready_code
from pcpc.drivers.compiled.deferred import Deferred
from pcpc.drivers.compiled.jit import JIT_OFF, LOOP_INTERPRETED, i8
from pcpc.drivers.compiled.kinds import Kind
from pcpc.drivers.compiled.records import Record
from pcpc.drivers.compiled.views import Layout, pointer_at

_MARKS = ("d", "d", "s", "s", "s", "s")
_step_of = Deferred("pcpc.drivers.compiled.stage_types", "step_of")


class Stage:
    """A step; compiled, unless numba is switched off. TypeError: the arguments are not a step's."""

    def __init__(self, function: Callable[..., None]) -> None:
        self.py_func = function
        self.__doc__, self.__name__ = function.__doc__, function.__name__
        self.declared = _annotated_ports(function)
        self._source = ready_code.ImportedFunction(function, "stage")
        self._in_memory: dict[str, ready_code.ReadyFunction] = {}
        self._bound: Any = None
        if not JIT_OFF and not self._source.has(self._key("f8")):
            self._code("f8")  # says what is wrong with it

    @property
    def entry(self) -> Any:
        """What `call` takes: an address, for the compiled loop."""
        return self if LOOP_INTERPRETED else self._code("f8").address

    @property
    def entry_of_lanes(self) -> int:
        """What `call` takes for a step of all lanes at once; numba's TypingError if it cannot."""
        return self._code("lane").address

    @property
    def in_c(self) -> Callable[..., None]:
        """The same as a function of two numbers and four addresses, unless numba is off."""
        if self._bound is None:
            self._bound = self._code("f8").bound(_MARKS)
        bound: Callable[..., None] = self._bound
        return bound

    def __call__(self, t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
        """Step on float64 vectors, which may be longer than what is declared."""
        views = (p, x, u, y)
        if JIT_OFF:
            named = zip(self.declared, views, "pxuy", strict=True)
            self.py_func(t, dt, *(ports(view, letter) for ports, view, letter in named))
            return
        for ports, view, letter in zip(self.declared, views, "pxuy", strict=True):
            _check(view, ports.size, letter)
        self.in_c(t, dt, *(view.ctypes.data for view in views))

    def _key(self, element: str) -> str:
        return f"{element} {[ports.layout for ports in self.declared]}"

    def _code(self, element: str) -> ready_code.ReadyFunction:
        """Return the code for values that are each one number, or a lane: kept or compiled now."""
        if element not in self._in_memory:
            key = self._key(element)
            self._in_memory[element] = self._source.load(key) or _step_of.in_numba(
                self._source, key, self.py_func, tuple(one.layout for one in self.declared), element
            )
        return self._in_memory[element]


def stage(function: Callable[..., None]) -> Any:
    """Make `step(t, dt, p, x, u, y)` the step of a block: t, dt in s, ports by name; no result.

    It cannot allocate: numba refuses anything that needs memory of its own. TypeError: its
    arguments are not a step's.
    """
    return Stage(function)


def _annotated_ports(function: Callable[..., None]) -> tuple[Any, ...]:
    """Return what the annotations of p, x, u, y name; TypeError says what a step looks like."""
    names = list(inspect.signature(function).parameters)
    where = f"line {function.__code__.co_firstlineno}: the step"
    if len(names) != 6:
        raise TypeError(f"{where} is not step(t, dt, p, x, u, y)")
    notes = inspect.get_annotations(function, eval_str=True)
    port_classes = tuple(notes.get(name) for name in names[2:])
    for name, ports in zip(names[2:], port_classes, strict=True):
        if not isinstance(getattr(ports, "layout", None), Layout):
            raise TypeError(
                f"{where} does not say which ports {name} has: `{name}: Gains` with a class Gains "
                f"of ports, or `{name}: Nothing`"
            )
    return port_classes


def _check(view: Any, size: int, letter: str) -> None:
    fits = isinstance(view, np.ndarray) and view.dtype == np.float64 and view.ndim == 1
    if not fits or not view.flags.c_contiguous or len(view) < size:
        raise TypeError(f"{letter}: expected a contiguous float64 vector of at least {size} values")


def _call_interpreted(entry: Stage, *arguments: Any) -> None:
    entry(*arguments)


def _part(values: Any, place: Any) -> Any:
    return values[place:]


_by_number: list[Any] = []  # of the interpreted loop


def entry_of(function: Any, kind: Kind) -> int:
    """Return what `call_at` takes for a loop function of one structure; its result is an int64.

    Only rigs that need such a function compile it.
    """
    if not LOOP_INTERPRETED:
        return int(function.address((kind,)))
    if function not in _by_number:
        _by_number.append(function)
    return _by_number.index(function)


def _call_by_number(entry: int, n: Record) -> Any:
    return _by_number[entry](n)


Entry = int | Stage  # what `call` takes, see `Stage.entry`
Steps = tuple[Entry, ...]
ENTRY = i8  # the type of an address
_TYPES = "pcpc.drivers.compiled.stage_types"
call_at: Any = _call_by_number if LOOP_INTERPRETED else Deferred(_TYPES, "call_at")
call: Any = (
    _call_interpreted if LOOP_INTERPRETED else Deferred("pcpc.drivers.compiled.stage_types", "call")
)
part: Any = _part if LOOP_INTERPRETED else pointer_at  # of the table, for a step
