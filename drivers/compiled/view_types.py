"""What `drivers.compiled.views` declares, as numba types it and lowers it.

Types are equal when their layouts are, whatever class declared them. Sources: numba's
documentation, "Low-level extension API".
"""

import hashlib
import math
import operator
from typing import Any

# ruff: isort: off
from pcpc.drivers.compiled.in_numba import f8, types
from llvmlite import ir  # after ours, which set numba's environment
from numba.core.imputils import lower_getattr_generic, lower_setattr_generic
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    infer_getattr,
    intrinsic,
    lower_builtin,
    models,
    register_model,
    type_callable,
)
from pcpc.drivers.compiled.lane_types import LANE, Lane
from pcpc.drivers.compiled.lanes import WIDTH
from pcpc.drivers.compiled.views import Field, Layout
# ruff: isort: on

_I64 = ir.IntType(64)


class Fields(types.Type):
    """The type of a pointer to memory whose parts have names: a View or a Structure."""

    element: Any
    size: int  # bytes, where there are Cells of them

    def field(self, name: str) -> tuple[Any, int] | None:
        """Return the type of a part and its place in bytes; None if there is none."""
        raise NotImplementedError


class View(Fields):
    """The type of a pointer to values with the names of a layout, each a float64 or a LANE."""

    def __init__(self, layout: Layout, element: Any = f8) -> None:
        self.layout, self.element = layout, element
        mark = hashlib.sha256(repr(layout.fields).encode()).hexdigest()[:12]
        super().__init__(f"View({layout.name}, {mark}, {element})")

    def field(self, name: str) -> tuple[Any, int] | None:
        """Return a value, Cells or a group."""
        found = self.layout.field(name)
        if found is None:
            return None
        each, place = self.element, _BYTES[self.element] * found.place
        if found.group:
            return View(found.group, each), place
        return Cells(found.shape, each) if found.shape else each, place


class Cells(types.Type):
    """The type of a pointer to an array of a fixed shape, row by row: of numbers or structures."""

    def __init__(self, shape: tuple[int, ...], element: Any) -> None:
        self.extents, self.element = shape, element
        self.stride = element.size if isinstance(element, Fields) else 1  # a structure: bytes
        super().__init__(f"Cells({shape}, {element})")


POINTER = types.CPointer(f8)
_BYTES = {f8: 8, LANE: 8 * WIDTH}


class Pointer(models.PrimitiveModel):
    """How Cells and Fields are passed."""

    def __init__(self, manager: Any, kind: Any) -> None:
        element = manager[kind.element].get_data_type()
        pointers = isinstance(kind.element, Fields)
        super().__init__(manager, kind, element if pointers else element.as_pointer())


register_model(View)(Pointer)
register_model(Cells)(Pointer)


@infer_getattr
class _Attributes(AttributeTemplate):
    key = Fields

    def generic_resolve(self, kind: Fields, name: str) -> Any:  # type: ignore[override]
        found = kind.field(name)
        return None if found is None else found[0]


def address_of(context: Any, builder: Any, pointer: Any, found: Any) -> tuple[Any, bool]:
    """Return the address of a part, and whether it is one number."""
    kind, place = found
    first = builder.bitcast(pointer, ir.IntType(8).as_pointer())
    address = builder.gep(first, [ir.Constant(_I64, place)], inbounds=True)
    into, number = context.get_value_type(kind), not isinstance(kind, Cells | Fields)
    return builder.bitcast(address, into.as_pointer() if number else into), number


@lower_getattr_generic(Fields)
def _get(context: Any, builder: Any, kind: Fields, pointer: Any, name: str) -> Any:
    address, number = address_of(context, builder, pointer, kind.field(name))
    return builder.load(address) if number else address


@lower_setattr_generic(Fields)
def _set(context: Any, builder: Any, signature: Any, arguments: Any, name: str) -> None:
    kind, given = signature.args
    found = kind.field(name)
    address, number = address_of(context, builder, arguments[0], found)
    if not number:
        raise TypeError(f"{name} has several values: set them one by one")
    builder.store(context.cast(builder, arguments[1], given, found[0]), address)


def _indices(index: Any) -> tuple[Any, ...]:
    parts = tuple(index) if isinstance(index, types.BaseTuple) else (index,)  # type: ignore[arg-type]
    return parts if all(isinstance(part, types.Integer) for part in parts) else ()


@type_callable(operator.getitem)
def _type_of_item(context: Any) -> Any:
    def typer(cells: Any, index: Any) -> Any:
        if not isinstance(cells, Cells) or not 0 < len(_indices(index)) <= len(cells.extents):
            return None
        rest = cells.extents[len(_indices(index)) :]
        return Cells(rest, cells.element) if rest else cells.element

    return typer


@type_callable(operator.setitem)
def _type_of_assignment(context: Any) -> Any:
    def typer(cells: Any, index: Any, value: Any) -> Any:
        whole = isinstance(cells, Cells) and len(_indices(index)) == len(cells.extents)
        return types.none if whole and not isinstance(cells.element, Fields) else None

    return typer


@type_callable(len)
def _type_of_len(context: Any) -> Any:
    def typer(cells: Any) -> Any:
        return types.intp if isinstance(cells, Cells) else None

    return typer


def _element(context: Any, builder: Any, kind: Cells, pointer: Any, index: Any, of: Any) -> Any:
    single = not isinstance(of, types.BaseTuple)
    values = [index] if single else [builder.extract_value(index, i) for i in range(len(of))]
    at = ir.Constant(_I64, 0)
    for i, (value, its) in enumerate(zip(values, _indices(of), strict=True)):
        stride = kind.stride * math.prod(kind.extents[i + 1 :])
        step = builder.mul(
            context.cast(builder, value, its, types.int64), ir.Constant(_I64, stride), flags=["nsw"]
        )
        at = builder.add(at, step, flags=["nsw"])
    return builder.gep(pointer, [at], inbounds=True)


def _item(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    cells, index = signature.args
    address = _element(context, builder, cells, arguments[0], arguments[1], index)
    part = isinstance(signature.return_type, Cells | Fields)
    return address if part else builder.load(address)


def _assign(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    cells, index, given = signature.args
    address = _element(context, builder, cells, arguments[0], arguments[1], index)
    builder.store(context.cast(builder, arguments[2], given, cells.element), address)
    return context.get_dummy_value()


for _index in (types.Integer, types.BaseTuple):
    lower_builtin(operator.getitem, Cells, _index)(_item)
    for _value in (types.Float, types.Integer, types.Boolean, Lane):
        lower_builtin(operator.setitem, Cells, _index, _value)(_assign)


@lower_builtin(len, Cells)
def _length(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return context.get_constant(types.intp, signature.args[0].extents[0])


@intrinsic
def flat(typing: Any, view: Any) -> Any:
    """Return all values of a View, one after the other, as Cells."""
    size = sum(_size(field) for field in view.layout.fields)
    return Cells((size,), view.element)(view), lambda c, b, signature, arguments: arguments[0]


def _size(field: Field) -> int:
    if field.group is not None:
        return sum(_size(one) for one in field.group.fields)
    return math.prod(field.shape)


def data(context: Any, builder: Any, kind: Any, values: Any) -> Any:
    """Return the pointer to the first element of Cells or of a contiguous array, for intrinsics."""
    if isinstance(kind, Cells):
        return values
    return context.make_array(kind)(context, builder, values).data


@intrinsic
def pointer_at(typing: Any, values: Any, place: Any) -> Any:
    """Return the POINTER to element `place` of float64 Cells or of a contiguous array."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = context.cast(builder, arguments[1], signature.args[1], types.intp)
        return builder.gep(data(context, builder, signature.args[0], arguments[0]), [place])

    return POINTER(values, place), generate


@intrinsic
def lane_rows(typing: Any, values: Any) -> Any:
    """Return a `compiled.lanes.table` as Cells, a LANE for each of its rows (of any number)."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first = data(context, builder, signature.args[0], arguments[0])
        return builder.bitcast(first, context.get_value_type(signature.return_type))

    return Cells((1,), LANE)(values), generate
