"""How numba compiles a step, and calls it by its address: see `drivers.compiled.stage`."""

from collections.abc import Callable
from typing import Any

# ruff: isort: off
from pcpc.drivers.compiled import ready_code
from pcpc.drivers.compiled.in_numba import (
    CallSignature,
    Context,
    TypingContext,
    Values,
    compiled,
    f8,
    i8,
    types,
)
from pcpc.drivers.compiled.jit import OPTIONS
from pcpc.drivers.compiled.lane_types import LANE
from pcpc.drivers.compiled.view_types import POINTER, view
from pcpc.drivers.compiled.views import Layout
from llvmlite import ir
from numba.core.compiler import Compiler
from numba.extending import intrinsic
# ruff: isort: on


class _NoAlias(Compiler):
    """Parameters, states, inputs and outputs are disjoint: stores to one change no other."""

    def __init__(self, *arguments: Any) -> None:
        typingctx, targetctx, library, args, return_type, flags, local = arguments
        flags.noalias = True
        super().__init__(typingctx, targetctx, library, args, return_type, flags, local)


_OPTIONS = OPTIONS | {
    "cache": False, "pipeline_class": _NoAlias, "_nrt": False, "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}  # fmt: skip
_ELEMENTS = {"f8": f8, "lane": LANE}


def step_of(
    source: ready_code.ImportedFunction,
    key: str,
    function: Callable[..., Any],
    layouts: tuple[Layout, ...],
    element: str,
) -> ready_code.ReadyFunction:
    """Return the code of a step on values that are each one number, or a lane."""
    views = [view(layout, _ELEMENTS[element]) for layout in layouts]
    return compiled(
        source, key, function, lambda: types.void(f8, f8, *views), _OPTIONS, by_address=True
    )


@intrinsic
def call(
    typing: TypingContext,
    entry: types.Type,
    t: types.Type,
    dt: types.Type,
    p: types.Type,
    x: types.Type,
    u: types.Type,
    y: types.Type,
) -> Any:  # numba takes the arguments by position
    """Step the stage at an address; what it raises goes on to the caller."""

    def generate(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
    ) -> Any:
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


@intrinsic
def call_at(typing: TypingContext, entry: types.Type, n: types.Type) -> Any:
    """Call what is at an address with a structure; what it raises goes on to the caller."""

    def generate(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
    ) -> Any:
        convention, kinds = context.call_conv, signature.args[1:]
        kind = ir.PointerType(convention.get_function_type(types.int64, kinds))
        function = builder.inttoptr(arguments[0], kind)
        status, result = convention.call_function(
            builder, function, types.int64, kinds, [arguments[1]]
        )
        with builder.if_then(status.is_error, likely=False):
            convention.return_status_propagate(builder, status)
        return result

    return types.int64(i8, n), generate
