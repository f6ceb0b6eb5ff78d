"""What `drivers.compiled.views` declares, as numba types it and lowers it.

Types are equal when their layouts are, whatever class declared them. Sources: numba's
documentation, "Low-level extension API".
"""

import hashlib
import math
import operator
from typing import Any

# ruff: isort: off
from pcpc.drivers.compiled.in_numba import (
    CallSignature,
    Context,
    DataModelManager,
    TypingContext,
    Values,
    f8,
    types,
)
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
from pcpc.drivers.compiled.views import Layout
# ruff: isort: on

_I64 = ir.IntType(64)


class Fields(types.Type):
    """The type of a pointer to memory whose parts have names: a View or a Structure.

    `fields`: name, type, place in bytes. A part is a number, Cells, or has parts itself.
    """

    element = types.uint8

    def __init__(self, name: str, fields: tuple[tuple[str, Any, int], ...], size: int) -> None:
        self.fields = {part: (kind, place) for part, kind, place in fields}
        self.size = size
        super().__init__(name)


class CellsType(types.Type):
    """The type of a pointer to an array of a fixed shape, row by row: of numbers or structures."""

    def __init__(self, shape: tuple[int, ...], element: types.Type) -> None:
        self.extents, self.element = shape, element
        self.stride = element.size if isinstance(element, Fields) else 1  # a structure: bytes
        super().__init__(f"Cells({shape}, {element})")


POINTER = types.CPointer(f8)
_BYTES = {f8: 8, types.int64: 8, LANE: 8 * WIDTH}


def mark_of(layout: tuple[Any, ...]) -> str:
    """Return 12 digits for what lies where."""
    return hashlib.sha256(repr(layout).encode()).hexdigest()[:12]


def view(layout: Layout, element: types.Type = f8) -> Fields:
    """Return the type of a View, whose values are each a float64 or a LANE."""
    each, fields, size = _BYTES[element], [], 0
    for name, offset, shape, group in layout.fields:
        kind: Any = (
            view(group, element) if group else CellsType(shape, element) if shape else element
        )
        fields.append((name, kind, each * offset))
        size = each * offset + (kind.size if group else each * math.prod(shape))
    return Fields(f"View({layout.name}, {mark_of(layout.fields)}, {element})", tuple(fields), size)


class Pointer(models.PrimitiveModel):
    """How Cells and Fields are passed."""

    def __init__(self, manager: DataModelManager, kind: "CellsType | Fields") -> None:
        element = manager[kind.element].get_data_type()
        pointers = isinstance(kind.element, Fields)
        super().__init__(manager, kind, element if pointers else element.as_pointer())


register_model(Fields)(Pointer)
register_model(CellsType)(Pointer)


@infer_getattr
class _Attributes(AttributeTemplate):
    key = Fields

    def generic_resolve(self, kind: Fields, name: str) -> Any:  # type: ignore[override]
        return kind.fields.get(name, (None,))[0]


def address_of(
    context: Context, builder: ir.IRBuilder, pointer: ir.Value, field: Any
) -> tuple[Any, bool]:
    """Return the address of a part, and whether it is one number."""
    kind, place = field
    first = builder.bitcast(pointer, ir.IntType(8).as_pointer())
    address = builder.gep(first, [ir.Constant(_I64, place)], inbounds=True)
    into, number = context.get_value_type(kind), not isinstance(kind, CellsType | Fields)
    return builder.bitcast(address, into.as_pointer() if number else into), number


@lower_getattr_generic(Fields)
def _get(
    context: Context, builder: ir.IRBuilder, kind: Fields, pointer: ir.Value, name: str
) -> Any:
    address, number = address_of(context, builder, pointer, kind.fields[name])
    return builder.load(address) if number else address


@lower_setattr_generic(Fields)
def _set(
    context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values, name: str
) -> None:
    kind, value_type = signature.args
    field = kind.fields[name]
    address, number = address_of(context, builder, arguments[0], field)
    if not number:
        raise TypeError(f"{name} has several values: set them one by one")
    builder.store(context.cast(builder, arguments[1], value_type, field[0]), address)


def _indices(index: types.Type) -> tuple[Any, ...]:
    parts = tuple(index) if isinstance(index, types.BaseTuple) else (index,)  # type: ignore[arg-type]
    return parts if all(isinstance(part, types.Integer) for part in parts) else ()


@type_callable(operator.getitem)
def _type_of_item(context: TypingContext) -> Any:
    def typer(cells: types.Type, index: types.Type) -> Any:
        if not isinstance(cells, CellsType) or not 0 < len(_indices(index)) <= len(cells.extents):
            return None
        rest = cells.extents[len(_indices(index)) :]
        return CellsType(rest, cells.element) if rest else cells.element

    return typer


@type_callable(operator.setitem)
def _type_of_assignment(context: TypingContext) -> Any:
    def typer(cells: Any, index: types.Type, value: types.Type) -> Any:
        whole = isinstance(cells, CellsType) and len(_indices(index)) == len(cells.extents)
        return types.none if whole and not isinstance(cells.element, Fields) else None

    return typer


@type_callable(len)
def _type_of_len(context: TypingContext) -> Any:
    def typer(cells: types.Type) -> Any:
        return types.intp if isinstance(cells, CellsType) else None

    return typer


def _element(
    context: Context,
    builder: ir.IRBuilder,
    kind: CellsType,
    pointer: ir.Value,
    index: Values,
    index_type: Any,
) -> Any:
    single = not isinstance(index_type, types.BaseTuple)
    values = (
        [index] if single else [builder.extract_value(index, i) for i in range(len(index_type))]
    )
    offset = ir.Constant(_I64, 0)
    for i, (value, its) in enumerate(zip(values, _indices(index_type), strict=True)):
        stride = kind.stride * math.prod(kind.extents[i + 1 :])
        step = builder.mul(
            context.cast(builder, value, its, types.int64), ir.Constant(_I64, stride), flags=["nsw"]
        )
        offset = builder.add(offset, step, flags=["nsw"])
    return builder.gep(pointer, [offset], inbounds=True)


def _item(
    context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
) -> Any:
    cells, index = signature.args
    address = _element(context, builder, cells, arguments[0], arguments[1], index)
    part = isinstance(signature.return_type, CellsType | Fields)
    return address if part else builder.load(address)


def _assign(
    context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
) -> Any:
    cells, index, given = signature.args
    address = _element(context, builder, cells, arguments[0], arguments[1], index)
    builder.store(context.cast(builder, arguments[2], given, cells.element), address)
    return context.get_dummy_value()


for _index in (types.Integer, types.BaseTuple):
    lower_builtin(operator.getitem, CellsType, _index)(_item)
    for _value in (types.Float, types.Integer, types.Boolean, Lane):
        lower_builtin(operator.setitem, CellsType, _index, _value)(_assign)


@lower_builtin(len, CellsType)
def _length(
    context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
) -> Any:
    return context.get_constant(types.intp, signature.args[0].extents[0])


@intrinsic
def flat(typing: TypingContext, whole: types.Type) -> Any:
    """Return all numbers of a View or Structure, which has them of one type alone, as Cells."""
    if not isinstance(whole, Fields) or len(kinds := _numbers(whole) or {f8}) > 1:
        return None
    (number,) = kinds

    def generate(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
    ) -> Any:
        return builder.bitcast(arguments[0], context.get_value_type(signature.return_type))

    return CellsType((whole.size // _BYTES[number],), number)(whole), generate


def _numbers(kind: Any) -> set[types.Type]:
    """Return the types of the numbers in a part."""
    if isinstance(kind, Fields):
        return set().union(*(_numbers(part) for part, _ in kind.fields.values()))
    return _numbers(kind.element) if isinstance(kind, CellsType) else {kind}


def data(context: Context, builder: ir.IRBuilder, kind: types.Type, values: ir.Value) -> Any:
    """Return the pointer to the first element of Cells or of a contiguous array, for intrinsics."""
    if isinstance(kind, CellsType):
        return values
    return context.make_array(kind)(context, builder, values).data


@intrinsic
def pointer_at(typing: TypingContext, values: types.Type, place: types.Type) -> Any:
    """Return the POINTER to element `place` of float64 Cells or of a contiguous array."""

    def generate(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
    ) -> Any:
        place = context.cast(builder, arguments[1], signature.args[1], types.intp)
        return builder.gep(data(context, builder, signature.args[0], arguments[0]), [place])

    return POINTER(values, place), generate


@intrinsic
def lane_rows(typing: TypingContext, values: types.Type) -> Any:
    """Return a `compiled.lanes.table` as Cells, a LANE for each of its rows (of any number)."""

    def generate(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
    ) -> Any:
        first = data(context, builder, signature.args[0], arguments[0])
        return builder.bitcast(first, context.get_value_type(signature.return_type))

    return CellsType((1,), LANE)(values), generate
