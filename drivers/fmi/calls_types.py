"""What `drivers.fmi.calls` names, as numba types it and lowers it."""

from collections.abc import Callable
from typing import Any

# ruff: isort: off
from pcpc.drivers.compiled.in_numba import f8, from_dtype, i8, types
from pcpc.drivers.compiled.structures import structure
from pcpc.drivers.fmi.layout import DTYPES, Head
from llvmlite import ir  # after ours, which set numba's environment
from numba.core import cgutils
from numba.extending import intrinsic
# ruff: isort: on

_I32, _I64 = ir.IntType(32), ir.IntType(64)


@intrinsic
def instance_at(typing: Any, address: Any) -> Any:
    """Return the instance that is described at an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return structure(Head.dtype).in_numba()(i8), generate


@intrinsic
def call(typing: Any, function: Any, arguments: Any) -> Any:
    """Call a function of FMI; return its status."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        kinds = [context.get_value_type(one) for one in signature.args[1]]
        pointer = builder.inttoptr(given[0], ir.FunctionType(_I32, kinds).as_pointer())
        status = builder.call(pointer, cgutils.unpack_tuple(builder, given[1]))
        return builder.sext(status, _I64)

    return i8(i8, arguments), generate


def _switch(context: Any, builder: Any, given: Any, do: Callable[[Any, Any], None]) -> None:
    """`do(type, pointer)` with value `i` of an array, in a case for each type that it may have."""
    kind, address, i = given
    past = builder.append_basic_block()
    cases = builder.switch(kind, past)
    for number, dtype in enumerate(DTYPES):
        case = builder.append_basic_block()
        cases.add_case(_I64(number), case)
        builder.position_at_end(case)
        typed = from_dtype(dtype)
        first = builder.inttoptr(address, context.get_value_type(typed).as_pointer())
        do(typed, builder.gep(first, [i]))
        builder.branch(past)
    builder.position_at_end(past)


@intrinsic
def read(typing: Any, kind: Any, address: Any, i: Any) -> Any:
    """Return value `i` of an array of a type."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value = cgutils.alloca_once(builder, ir.DoubleType())

        def load(typed: Any, pointer: Any) -> None:
            builder.store(context.cast(builder, builder.load(pointer), typed, f8), value)

        _switch(context, builder, arguments, load)
        return builder.load(value)

    return f8(i8, i8, i8), generate


@intrinsic
def write(typing: Any, kind: Any, address: Any, i: Any, value: Any) -> Any:
    """Set it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        *given, value = arguments

        def store(typed: Any, pointer: Any) -> None:
            builder.store(context.cast(builder, value, f8, typed), pointer)

        _switch(context, builder, given, store)
        return context.get_dummy_value()

    return types.void(i8, i8, i8, f8), generate
