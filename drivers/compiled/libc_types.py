"""What `drivers.compiled.libc` names, as numba types it and lowers it."""

from collections.abc import Callable
from typing import Any

import numpy as np

# ruff: isort: off
from pcpc.drivers.compiled.in_numba import (
    CallSignature,
    Context,
    TypingContext,
    Values,
    carray,
    types,
)
from pcpc.drivers.compiled.jit import loop_inline
from pcpc.drivers.compiled.libc import SIGNATURES
from llvmlite import ir
from numba import extending
from pcpc.drivers.compiled.view_types import Fields, address_of, data
# ruff: isort: on

_i4, _i8 = types.int32, types.int64
_NUMBERS: dict[str, Any] = {"i4": _i4, "i8": _i8}


def _untyped(function: Callable[..., Any]) -> Any:
    """Return `function`: numba's intrinsics are called without their typing context."""
    return function


intrinsic: Any = extending.intrinsic  # its callers do not pass the typing context
literal_intrinsic: Any = extending.intrinsic(prefer_literal=True)

for _name, _signature in SIGNATURES.items():
    _result, *_arguments = (_NUMBERS[one] for one in _signature.split())
    globals()[_name] = types.ExternalFunction(_name, _result(*_arguments))
_errno_location: Any = types.ExternalFunction("__errno_location", types.CPointer(_i4)())


@loop_inline
def errno() -> Any:
    """Return the calling thread's errno."""
    return np.int64(carray(_errno_location(), 1)[0])


def _word(context: Context, builder: ir.IRBuilder, signature: CallSignature, args: Values) -> Any:
    """Return the address of an array's element, or of a structure's word of that name."""
    kind, at = signature.args[:2]
    if isinstance(kind, Fields):
        return address_of(context, builder, args[0], kind.fields[at.literal_value])[0]
    return builder.gep(data(context, builder, kind, args[0]), [args[1]])


@_untyped
@literal_intrinsic
def load_acquire(typing_context: TypingContext, array: types.Type, index: types.Type) -> Any:
    """Return array[index] (int64) with acquire order; of a structure, the word of that name."""

    def generate(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, args: Values
    ) -> Any:
        return builder.load_atomic(_word(context, builder, signature, args), "acquire", 8)

    return _i8(array, index if isinstance(array, Fields) else _i8), generate


@_untyped
@literal_intrinsic
def store_release(
    typing_context: TypingContext, array: types.Type, index: types.Type, value: types.Type
) -> Any:
    """Set array[index] (int64) with release order; of a structure, the word of that name."""

    def generate(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, args: Values
    ) -> Any:
        word = _word(context, builder, signature, args)
        builder.store_atomic(args[2], word, "release", 8)
        return context.get_dummy_value()

    return types.void(array, index if isinstance(array, Fields) else _i8, _i8), generate


@_untyped
@intrinsic
def fence_release(typing_context: TypingContext) -> Any:
    """Keep earlier stores before later ones."""

    def generate(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, args: Values
    ) -> Any:
        builder.fence("release")
        return context.get_dummy_value()

    return types.void(), generate


@_untyped
@intrinsic
def address(typing_context: TypingContext, array: types.Type) -> Any:
    """Return the address of the array's first element."""

    def generate(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, args: Values
    ) -> Any:
        first = data(context, builder, signature.args[0], args[0])
        return builder.ptrtoint(first, context.get_value_type(_i8))

    return _i8(array), generate
