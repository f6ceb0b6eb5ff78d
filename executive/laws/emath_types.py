"""`where`, `pow2` and `sqrt` of `executive.laws.emath`, as numba types and lowers them."""

from collections.abc import Sequence
from typing import Any

# ruff: isort: off
from pcpc.drivers.compiled.in_numba import types
from llvmlite import ir  # after ours, which set numba's environment
from numba.core.base import BaseContext
from numba.core.errors import TypingError
from numba.core.typing.templates import Signature
from numba.extending import lower_builtin, type_callable
from pcpc.drivers.compiled.lane_types import LANE, Lane, Mask, intrinsic_lowering
from pcpc.drivers.compiled.lanes import WIDTH
from pcpc.executive.laws.emath import ROUND, pow2, sqrt, where
# ruff: isort: on


@type_callable(where)
def _type_where(context: Any) -> Any:
    def typer(c: types.Type, a: types.Type, b: types.Type) -> types.Type:
        if isinstance(c, types.Boolean) and a == b == types.float64:
            return types.float64
        if isinstance(c, types.Boolean | Mask) and {a, b} <= {LANE, types.float64}:
            return LANE
        raise TypingError(
            f"where({c}, {a}, {b}): needs a comparison and two float64 (write 0.0, not 0)"
        )

    return typer


@lower_builtin(where, types.Boolean, types.Number, types.Number)
@lower_builtin(where, types.Boolean, types.Number, Lane)
@lower_builtin(where, types.Boolean, Lane, types.Number)
@lower_builtin(where, types.Boolean, Lane, Lane)
@lower_builtin(where, Mask, types.Number, types.Number)
@lower_builtin(where, Mask, types.Number, Lane)
@lower_builtin(where, Mask, Lane, types.Number)
@lower_builtin(where, Mask, Lane, Lane)
def _lower_where(
    context: BaseContext, builder: ir.IRBuilder, signature: Signature, args: Sequence[ir.Value]
) -> ir.Value:
    result, kinds = signature.return_type, signature.args[1:]
    chosen = zip(args[1:], kinds, strict=True)
    a, b = (context.cast(builder, value, kind, result) for value, kind in chosen)
    return builder.select(args[0], a, b)


@type_callable(pow2)
@type_callable(sqrt)
def _type_float(context: Any) -> Any:
    def typer(x: types.Type) -> types.Type | None:
        return x if x in (types.float64, LANE) else None

    return typer


@lower_builtin(pow2, types.float64)
@lower_builtin(pow2, Lane)
def _lower_pow2(
    context: BaseContext, builder: ir.IRBuilder, signature: Signature, args: Sequence[ir.Value]
) -> ir.Value:
    double, word = args[0].type, ir.IntType(64)
    is_lane = signature.args[0] == LANE
    words = ir.VectorType(word, WIDTH) if is_lane else word

    def constant(kind: ir.Type, value: float) -> ir.Constant:
        return ir.Constant(kind, [value] * WIDTH if is_lane else value)

    shifted = builder.fadd(args[0], constant(double, ROUND))
    biased = builder.add(builder.bitcast(shifted, words), constant(words, 1023))
    return builder.bitcast(builder.shl(biased, constant(words, 52)), double)


@lower_builtin(sqrt, types.float64)
@lower_builtin(sqrt, Lane)
def _lower_sqrt(
    context: BaseContext, builder: ir.IRBuilder, signature: Signature, args: Sequence[ir.Value]
) -> ir.Value:
    return intrinsic_lowering("llvm.sqrt")(context, builder, signature, args)
