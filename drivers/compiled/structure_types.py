"""What `drivers.compiled.structures` names, as numba types it and lowers it."""

from typing import Any

import numpy as np

# ruff: isort: off
from pcpc.drivers.compiled.in_numba import (
    CallSignature,
    Context,
    TypingContext,
    Values,
    numba,
    types,
)
from pcpc.drivers.compiled.kinds import plain
from pcpc.drivers.compiled.numbered import NumberedEnum, NumberedKind
from pcpc.drivers.compiled.rows import CLASSIC_BYTES, FRAME_BYTES, HEAD_BYTES, Flag
from pcpc.drivers.compiled.view_types import CellsType, Fields, data, mark_of
from llvmlite import ir  # after ours, which set numba's environment
from numba.core.imputils import lower_constant, lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    intrinsic,
    models,
    register_model,
    typeof_impl,
    unbox,
)
# ruff: isort: on

_I64 = ir.IntType(64)
_known: dict[np.dtype[Any], Fields] = {}


def structure(dtype: np.dtype[Any]) -> Any:
    """Return the type of a structure of `dtype`, which from now on has it everywhere."""
    bare = plain(dtype)
    if bare not in _known:
        places: Any = bare.fields
        fields = tuple((name, _kind(places[name][0]), places[name][1]) for name in places)
        mark = mark_of((fields, bare.itemsize))
        _known[bare] = Fields(f"Structure({mark})", fields, bare.itemsize)
    return _known[bare]


def _kind(dtype: np.dtype[Any]) -> Any:
    if dtype.fields is not None:
        return structure(dtype)
    base, shape = dtype.subdtype or (dtype, ())
    number = numba.from_dtype(base) if base.fields is None else structure(base)
    return CellsType(shape, number) if shape else number


@typeof_impl.register(np.record)
def _typeof(value: np.record, context: Any) -> Any:
    return _known.get(plain(value.dtype)) or numba.from_dtype(value.dtype)


@unbox(Fields)
def _unbox(kind: types.Type, value: ir.Value, c: Any) -> Any:
    buffer = c.pyapi.alloca_buffer()
    pointer = c.pyapi.extract_record_data(value, buffer)
    failed = c.builder.icmp_unsigned("==", pointer, ir.Constant(pointer.type, None))
    pointer = c.builder.bitcast(pointer, c.context.get_value_type(kind))
    return NativeValue(pointer, failed, lambda: c.pyapi.release_buffer(buffer))


class EnumType(types.Type):
    """The type of a Numbered class, whose members are int64."""

    def __init__(self, numbered: NumberedKind) -> None:
        self.numbered = numbered
        super().__init__(f"Names({numbered.__module__}.{numbered.__qualname__})")


register_model(EnumType)(models.OpaqueModel)
typeof_impl.register(NumberedKind)(lambda numbered, context: EnumType(numbered))
typeof_impl.register(NumberedEnum)(lambda member, context: types.int64)


@infer_getattr
class _Members(AttributeTemplate):
    key = EnumType

    def generic_resolve(self, kind: EnumType, name: str) -> Any:  # type: ignore[override]
        return types.int64 if name in kind.numbered.__members__ else None


@lower_constant(EnumType)
def _no_value(
    context: Context, builder: ir.IRBuilder, kind: EnumType, numbered: NumberedKind
) -> Any:
    return context.get_dummy_value()


@lower_getattr_generic(EnumType)
def _member(
    context: Context, builder: ir.IRBuilder, kind: EnumType, value: ir.Value, name: str
) -> Any:
    return context.get_constant(types.int64, int(kind.numbered[name]))


@intrinsic
def data_of(typing: TypingContext, frame: types.Type) -> Any:
    """Return the data bytes of a frame."""

    def generate(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
    ) -> Any:
        return builder.gep(arguments[0], [ir.Constant(_I64, HEAD_BYTES)], inbounds=True)

    return CellsType((FRAME_BYTES - HEAD_BYTES,), types.uint8)(frame), generate


@intrinsic
def copy(typing: TypingContext, target: types.Type, source: types.Type) -> Any:
    """Load 16 bytes, then store them, of an FD frame the rest too: source and target lie apart."""
    byte = ir.IntType(8)

    def generate(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
    ) -> Any:
        into, out_of = (
            builder.bitcast(data(context, builder, kind, value), byte.as_pointer())
            for kind, value in zip(signature.args, arguments, strict=True)
        )

        def move(first: int, past: int) -> None:
            offset, piece = ir.Constant(_I64, first), ir.VectorType(byte, past - first).as_pointer()
            here, there = (builder.bitcast(builder.gep(p, [offset]), piece) for p in (out_of, into))
            builder.store(builder.load(here, align=1), there, align=1)

        move(0, CLASSIC_BYTES)
        flags = builder.load(builder.gep(out_of, [ir.Constant(_I64, 5)]))
        with builder.if_then(
            builder.icmp_unsigned("!=", builder.and_(flags, byte(Flag.FD)), byte(0)), likely=False
        ):
            for first in range(CLASSIC_BYTES, FRAME_BYTES, 8):
                move(first, first + 8)
        return context.get_dummy_value()

    return types.void(target, source), generate
