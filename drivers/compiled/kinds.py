"""Types of arguments and results, said before numba is there: `i8(N, i8[:, ::1], f8)`.

A Kind has a mark, by which kept code is found (`drivers.compiled.ready_code`), and makes the type
of numba when something is compiled. `mark_of` is the same of a value that Python passes.

    d q            float64, int64, also Python's own
    aC2<u1         array: order, dimensions, type of its elements; r in front: read only
    s1f0c...       structure, one element of a structured array, by what lies where
    (d,q)          tuple
"""

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np

_FIRST, _LAST = -(1 << 63), (1 << 63) - 1


class UnmarkedValue(Exception):
    """A value of which numba itself must say what it is."""


class Signature:
    """A result and arguments."""

    def __init__(self, result: "Kind", arguments: tuple["Kind", ...]) -> None:
        self.result, self.arguments = result, arguments
        self.marks = tuple(one.mark for one in arguments)

    def in_numba(self) -> Any:
        """Return numba's signature."""
        return self.result.in_numba()(*(one.in_numba() for one in self.arguments))


class Kind:
    """A type; `make` returns that of numba."""

    def __init__(self, mark: str, make: Callable[[], Any]) -> None:
        self.mark, self.in_numba = mark, make

    def __call__(self, *arguments: "Kind") -> Any:
        """Return a signature with this as its result."""
        return Signature(self, arguments)

    def __getitem__(self, axes: Any) -> "Kind":
        """Return the type of arrays of it, as numba writes it: [:, ::1] by rows."""
        axes = axes if isinstance(axes, tuple) else (axes,)
        order = "C" if axes[-1].step == 1 else "F" if axes[0].step == 1 else "A"
        return array(self, len(axes), order)


def _number(name: str, mark: str) -> Kind:
    def make() -> Any:
        from numba.core import types  # the caller has opened it

        return getattr(types, name)

    return Kind(mark, make)


f8, i8, u1 = _number("float64", "d"), _number("int64", "q"), _number("uint8", "u1")
nothing = _number("void", "")
_ELEMENTS = {"d": "<f8", "q": "<i8", "u1": "|u1"}


def array(element: Kind, dimensions: int, order: str) -> Kind:
    """Return the type of an array."""

    def make() -> Any:
        from numba.core import types

        made: Any = types.Array
        return made(element.in_numba(), dimensions, order)

    return Kind(f"a{order}{dimensions}{_ELEMENTS[element.mark]}", make)


def tuple_of(kind: Kind, count: int) -> Kind:
    """Return the type of a tuple of so many alike."""

    def make() -> Any:
        from numba.core import types

        return types.UniTuple(kind.in_numba(), count)

    return Kind(f"({','.join([kind.mark] * count)})", make)


def tuple_with(*members: Kind) -> Kind:
    """Return the type of a tuple of these."""

    def make() -> Any:
        from numba.core import types

        return types.Tuple(tuple(one.in_numba() for one in members))

    return Kind(f"({','.join(one.mark for one in members)})", make)


_structures: dict[np.dtype[Any], Kind] = {}


def plain(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return `dtype` as numpy makes it of a list, also of an element of a recarray."""
    return np.dtype((np.void, dtype)) if dtype.type is np.record else dtype


def structure(dtype: np.dtype[Any], make: Callable[[np.dtype[Any]], Any]) -> Kind:
    """Return the type of an element of a structured array; `make` returns numba's."""
    if (kind := _structures.get(dtype)) is None:
        bare = plain(dtype)
        kind = Kind(f"s{dtype_mark(bare)}", lambda: make(bare))
        _structures.update({bare: kind, dtype: kind, np.dtype((np.record, bare)): kind})
    return kind


def complete() -> None:
    """Let numba know all structures that were named."""
    for kind in list(_structures.values()):
        kind.in_numba()


_marks: dict[np.dtype[Any], str] = {}


def dtype_mark(dtype: np.dtype[Any]) -> str:
    """Return 12 digits for what lies where in a structured type."""
    if (mark := _marks.get(dtype)) is None:
        text = repr(_record_layout(dtype))
        mark = _marks[dtype] = hashlib.sha256(text.encode()).hexdigest()[:12]
    return mark


def _record_layout(dtype: np.dtype[Any]) -> Any:
    base, shape = dtype.subdtype or (dtype, ())
    if base.fields is None:
        return base.str, shape
    inner = [(name, place[1], _record_layout(place[0])) for name, place in base.fields.items()]
    return inner, base.itemsize, shape


def mark_of(value: Any) -> str:
    """Return the mark of what Python passes; Unmarked."""
    kind = type(value)
    if kind is float or kind is np.float64:
        return "d"
    if kind is np.int64 or (kind is int and _FIRST <= value <= _LAST):
        return "q"
    if kind is np.ndarray or kind is np.recarray:
        return _of_array(value)
    if kind is np.record and value.dtype in _structures:
        return _structures[value.dtype].mark
    if kind is tuple:
        return f"({','.join(map(mark_of, value))})"
    raise UnmarkedValue


def _of_array(value: Any) -> str:
    flags, dtype = value.flags, value.dtype
    if not flags.aligned or not dtype.isnative or dtype.kind not in "fiuV":
        raise UnmarkedValue
    element = dtype.str if dtype.fields is None else dtype_mark(dtype)
    if dtype.subdtype is not None or (dtype.kind == "V" and dtype.fields is None):
        raise UnmarkedValue
    order = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
    return f"{'' if flags.writeable else 'r'}a{order}{value.ndim}{element}"


def leaves_of(value: Any, into: list[Any]) -> None:
    """Append the numbers and addresses that are passed for a value that has a mark."""
    if isinstance(value, tuple):
        for one in value:
            leaves_of(one, into)
    elif isinstance(value, np.ndarray):
        into += (None, None, value.size, value.itemsize, value.ctypes.data)
        into += (*value.shape, *value.strides)
    elif isinstance(value, np.record):
        into.append(np.asarray(value).ctypes.data)  # its own interface lists each field
    else:
        into.append(int(value) if isinstance(value, np.int64) else value)
