"""What `drivers.compiled.lanes` says of numbers in lanes, as numba types it and lowers it.

Sources: numba's documentation, "Low-level extension API"; LLVM's vectors.
"""

import operator
from collections.abc import Callable
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
from pcpc.drivers.compiled.lanes import WIDTH, LanesDiffer
from llvmlite import ir  # after ours, which set numba's environment
from numba.core import cgutils
from numba.core.typeconv.castgraph import Conversion
from numba.extending import (
    intrinsic,
    lower_builtin,
    lower_cast,
    models,
    register_model,
    type_callable,
)
# ruff: isort: on

_BIT, _WORD = ir.IntType(1), ir.IntType(WIDTH)


class Lane(types.Type):
    """The type of a number in each of the lanes."""

    def __init__(self) -> None:
        super().__init__(f"Lane({WIDTH})")

    def unify(self, context: TypingContext, other: types.Type) -> Any:
        """Return what a variable is that holds both: a number in each lane."""
        return self if isinstance(other, types.Float | types.Integer) else None

    def can_convert_from(self, context: TypingContext, other: types.Type) -> Any:
        """Return how a number gets into all lanes."""
        return Conversion.safe if isinstance(other, types.Float | types.Integer) else None


class Mask(types.Type):
    """The type of an answer in each of the lanes."""

    def __init__(self) -> None:
        super().__init__(f"Mask({WIDTH})")


LANE, MASK = Lane(), Mask()


@register_model(Lane)
class _LaneModel(models.PrimitiveModel):
    def __init__(self, manager: DataModelManager, kind: types.Type) -> None:
        super().__init__(manager, kind, ir.VectorType(ir.DoubleType(), WIDTH))


@register_model(Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: DataModelManager, kind: types.Type) -> None:
        super().__init__(manager, kind, ir.VectorType(_BIT, WIDTH))


def in_all(builder: ir.IRBuilder, number: ir.Value) -> Any:
    """Return the vector that holds a number in every lane."""
    vector = ir.VectorType(number.type, WIDTH)
    nothing = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(nothing, number, ir.Constant(ir.IntType(32), 0))
    places = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(first, nothing, places)


@lower_cast(types.Float, Lane)
@lower_cast(types.Integer, Lane)
def _from_number(
    context: Context, builder: ir.IRBuilder, given: types.Type, wanted: types.Type, number: ir.Value
) -> Any:
    return in_all(builder, context.cast(builder, number, given, f8))


def _is_number(kind: types.Type) -> bool:
    return isinstance(kind, types.Float | types.Integer)


def one_is_lane(*kinds: types.Type) -> bool:
    """Return whether these are lanes and numbers, and at least one is a lane."""
    return LANE in kinds and all(kind == LANE or _is_number(kind) for kind in kinds)


def _binary(
    function: Callable[..., Any], result: types.Type, emit: Callable[[Any, Any, Any], Any]
) -> None:
    @type_callable(function)
    def typed(context: TypingContext) -> Any:
        return lambda x, y: result if one_is_lane(x, y) else None

    def lower(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
    ) -> Any:
        given = zip(arguments, signature.args, strict=True)
        return emit(builder, *(context.cast(builder, value, kind, LANE) for value, kind in given))

    for kinds in ((Lane, Lane), (Lane, types.Number), (types.Number, Lane)):
        lower_builtin(function, *kinds)(lower)


def _unary(
    function: Callable[..., Any], kind: types.Type, result: types.Type, lower: Callable[..., Any]
) -> None:
    @type_callable(function)
    def typed(context: TypingContext) -> Any:
        return lambda x: result if x == kind else None

    lower_builtin(function, kind)(lower)


def _instruction(name: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, x, y: getattr(builder, name)(x, y)


def _comparison(how: str, sign: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, x, y: getattr(builder, f"fcmp_{how}")(sign, x, y)


for _name, _its in (("add", "fadd"), ("sub", "fsub"), ("mul", "fmul"), ("truediv", "fdiv")):
    for _function in (getattr(operator, _name), getattr(operator, f"i{_name}")):
        _binary(_function, LANE, _instruction(_its))
for _name, _sign in (("lt", "<"), ("le", "<="), ("gt", ">"), ("ge", ">="), ("eq", "==")):
    _binary(getattr(operator, _name), MASK, _comparison("ordered", _sign))
_binary(operator.ne, MASK, _comparison("unordered", "!="))
_unary(operator.neg, LANE, LANE, lambda context, b, signature, x: b.fneg(x[0]))
_unary(operator.pos, LANE, LANE, lambda context, b, signature, x: x[0])
for _function in (operator.invert, operator.not_):
    _unary(_function, MASK, MASK, lambda context, b, signature, x: b.not_(x[0]))


def intrinsic_lowering(name: str) -> Callable[..., Any]:
    """Return the lowering of an LLVM intrinsic of one double or LANE."""

    def lower(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
    ) -> Any:
        kind = arguments[0].type
        suffix = f"v{WIDTH}f64" if isinstance(kind, ir.VectorType) else "f64"
        wanted = ir.FunctionType(kind, [kind])
        function = cgutils.get_or_insert_function(builder.module, wanted, f"{name}.{suffix}")
        return builder.call(function, arguments)

    return lower


_unary(abs, LANE, LANE, intrinsic_lowering("llvm.fabs"))


for _function, _its in ((operator.and_, "and_"), (operator.or_, "or_"), (operator.xor, "xor")):

    @type_callable(_function)
    def _type_of_both(context: TypingContext) -> Any:
        return lambda x, y: MASK if MASK in (x, y) and {x, y} <= {MASK, types.boolean} else None

    def _both(
        context: Context,
        builder: ir.IRBuilder,
        signature: CallSignature,
        arguments: Values,
        name: str = _its,
    ) -> Any:
        masks = (
            value if kind == MASK else in_all(builder, builder.trunc(value, _BIT))
            for value, kind in zip(arguments, signature.args, strict=True)
        )
        return getattr(builder, name)(*masks)

    for _kinds in ((Mask, Mask), (Mask, types.Boolean), (types.Boolean, Mask)):
        lower_builtin(_function, *_kinds)(_both)


def _bits(builder: ir.IRBuilder, mask: ir.Value) -> Any:
    return builder.bitcast(mask, _WORD)


def _end_if(context: Context, builder: ir.IRBuilder, differs: ir.Value) -> None:
    with builder.if_then(differs, likely=False):
        context.call_conv.return_user_exc(builder, LanesDiffer, ("the lanes differ",))


def _decision(
    context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
) -> Any:
    bits = _bits(builder, arguments[0])
    some = builder.icmp_unsigned("!=", bits, ir.Constant(_WORD, 0))
    some_not = builder.icmp_unsigned("!=", bits, ir.Constant(_WORD, 2**WIDTH - 1))
    _end_if(context, builder, builder.and_(some, some_not))
    return some


_unary(bool, MASK, types.boolean, _decision)


def _count(
    context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
) -> Any:
    first = builder.extract_element(arguments[0], ir.Constant(ir.IntType(32), 0))
    differ = builder.fcmp_unordered("!=", arguments[0], in_all(builder, first))
    bits = _bits(builder, differ)
    _end_if(context, builder, builder.icmp_unsigned("!=", bits, ir.Constant(_WORD, 0)))
    return builder.fptosi(first, ir.IntType(64))


_unary(int, LANE, types.int64, _count)


@intrinsic
def in_single(typing: TypingContext, x: types.Type) -> Any:
    """Return a LANE rounded to the precision of float32."""

    def generate(
        context: Context, builder: ir.IRBuilder, signature: CallSignature, arguments: Values
    ) -> Any:
        narrow = ir.VectorType(ir.FloatType(), WIDTH)
        return builder.fpext(builder.fptrunc(arguments[0], narrow), arguments[0].type)

    return LANE(x), generate
