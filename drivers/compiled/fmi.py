"""The step of an FMU: inputs set, doStep, outputs got, from the compiled loop through addresses.

One function serves every FMU. Where its calls are described stands in its first state, an address
as a number; there lies HEAD, and from HEAD[GROUPS] on a row of GROUP for all variables of one type
and role, each with arrays of their references, values and places among the block's own.

    call k = 0    tunable parameters that have changed, inputs, outputs               t = 0
    call k > 0    tunable parameters that have changed, inputs, doStep, outputs       t = k T

Time is counted in steps: doStep goes from (k - 1) T to k T. What is not OK (nor a warning) makes
all outputs NaN from then on, which is a fault of the loop; HEAD says what it was.
"""

import ctypes
from functools import cache
from typing import Any

import numpy as np

# ruff: isort: off
from pcpc.drivers.compiled.in_numba import f8, i8, numba, types
from pcpc.drivers.compiled.jit import JIT_OFF, LOOP_INTERPRETED, OPTIONS
from pcpc.drivers.compiled.view_types import POINTER
from llvmlite import ir  # after ours, which set numba's environment
from numba.extending import intrinsic
# ruff: isort: on

# HEAD, int64
VERSION, INSTANCE, DO_STEP, STEPS, STATUS, FAILED, N_GROUPS, GROUPS, N_OUT = range(9)
HEAD_SIZE = 9
OK, WARNING, DISCARD, ERROR, FATAL = range(5)  # STATUS, and what an FMU asks for:
ENDED = 5  # to end the simulation, or it returned early
NO_INSTANCE, SETTING, STEPPING, GETTING = range(4)  # FAILED

# GROUP, int64: role, address of the function, type, how many references and values, and where
ROLE, FUNCTION, KIND, N_REFERENCES, REFERENCES, N_VALUES, VALUES, PLACES, LAST = range(9)
GROUP_SIZE = 9
PARAMETER, INPUT, OUTPUT = range(3)  # ROLE
F64, F32, I8, U8, I16, U16, I32, U32, I64, U64, BOOL8, BOOL32 = range(12)  # KIND
DTYPES = (
    np.float64, np.float32, np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64,
    np.uint64, np.uint8, np.int32,
)  # fmt: skip
_LOW = np.array([0, 0, -(2.0**7), 0, -(2.0**15), 0, -(2.0**31), 0, -(2.0**63), 0, 0, 0])
_HIGH = np.array(
    [0, 0, 2.0**7 - 1, 2.0**8 - 1, 2.0**15 - 1, 2.0**16 - 1, 2.0**31 - 1, 2.0**32 - 1,
     2.0**63 - 1024, 2.0**64 - 2048, 1, 1]
)  # fmt: skip  # the largest of 64 bits that are a float64

# ------------------------------------------------------------------ memory and calls by address

_I32, _I64, _F64, _BYTE = ir.IntType(32), ir.IntType(64), ir.DoubleType(), ir.IntType(8)


def _untyped(function: Any) -> Any:
    """Return `function`: numba's intrinsics are called without their typing context."""
    return function


def _load_intrinsic(kind: Any) -> Any:
    """Return an intrinsic: `load(address, i)` of a number of this type."""

    @intrinsic
    def load(typing: Any, address: Any, i: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            into = context.get_value_type(kind).as_pointer()
            return builder.load(builder.gep(builder.inttoptr(arguments[0], into), [arguments[1]]))

        return kind(i8, i8), generate

    return load


def _store_intrinsic(kind: Any) -> Any:
    """Return an intrinsic: `store(address, i, value)`."""

    @intrinsic
    def store(typing: Any, address: Any, i: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            into = context.get_value_type(kind).as_pointer()
            place = builder.gep(builder.inttoptr(arguments[0], into), [arguments[1]])
            builder.store(arguments[2], place)
            return context.get_dummy_value()

        return types.void(i8, i8, kind), generate

    return store


def _call(builder: Any, address: Any, kinds: list[Any], values: list[Any]) -> Any:
    function = ir.FunctionType(_I32, kinds).as_pointer()
    return builder.sext(builder.call(builder.inttoptr(address, function), values), _I64)


@_untyped
@intrinsic
def _transfer(
    typing: Any,
    version: Any,
    function: Any,
    instance: Any,
    references: Any,
    n: Any,
    values: Any,
    n_values: Any,
) -> Any:
    """Call a setter or getter; FMI 3.0's also take the number of values."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        version, function, *rest = arguments
        is_3 = builder.icmp_signed("==", version, ir.Constant(_I64, 3))
        with builder.if_else(is_3) as (then, otherwise):
            with then:
                three = _call(builder, function, [_I64] * 5, rest)
                from_three = builder.block
            with otherwise:
                two = _call(builder, function, [_I64] * 4, rest[:4])
                from_two = builder.block
        status = builder.phi(_I64)
        status.add_incoming(three, from_three)
        status.add_incoming(two, from_two)
        return status

    return i8(i8, i8, i8, i8, i8, i8, i8), generate


@_untyped
@intrinsic
def _do_step(
    typing: Any, version: Any, function: Any, instance: Any, t: Any, h: Any, told: Any
) -> Any:
    """Call doStep; FMI 3.0's writes 3 bools and a time at `told`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        version, function, instance, t, h, told = arguments
        never = ir.Constant(_I32, 1)  # is an earlier state set again
        is_3 = builder.icmp_signed("==", version, ir.Constant(_I64, 3))
        with builder.if_else(is_3) as (then, otherwise):
            with then:
                places = [builder.add(told, ir.Constant(_I64, at)) for at in (0, 1, 2, 8)]
                kinds = [_I64, _F64, _F64, _I32, *[_I64] * 4]
                three = _call(builder, function, kinds, [instance, t, h, never, *places])
                from_three = builder.block
            with otherwise:
                two = _call(builder, function, [_I64, _F64, _F64, _I32], [instance, t, h, never])
                from_two = builder.block
        status = builder.phi(_I64)
        status.add_incoming(three, from_three)
        status.add_incoming(two, from_two)
        return status

    return i8(i8, i8, i8, f8, f8, i8), generate


@_untyped
@intrinsic
def _as_address(typing: Any, pointer: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ptrtoint(arguments[0], _I64)

    return i8(POINTER), generate


if JIT_OFF:

    def _array(address: int, dtype: Any, n: int) -> Any:
        buffer = (ctypes.c_byte * (np.dtype(dtype).itemsize * n)).from_address(int(address))
        return np.frombuffer(buffer, dtype)

    def _twin_of_load(dtype: Any) -> Any:
        return lambda address, i: _array(address, dtype, i + 1)[i]

    def _twin_of_store(dtype: Any) -> Any:
        def store(address: int, i: int, value: Any) -> None:
            _array(address, dtype, i + 1)[i] = value

        return store

    def _transfer(*given: int) -> int:
        version, function, *rest = map(int, given)
        kinds = [ctypes.c_void_p] * (5 if version == 3 else 4)
        return int(ctypes.CFUNCTYPE(ctypes.c_int, *kinds)(function)(*rest[: len(kinds)]))

    def _do_step(version: int, function: int, instance: int, t: float, h: float, told: int) -> int:
        kinds = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int]
        more = [told, told + 1, told + 2, told + 8] if version == 3 else []
        call = ctypes.CFUNCTYPE(ctypes.c_int, *kinds, *[ctypes.c_void_p] * len(more))
        return int(call(int(function))(int(instance), t, h, 1, *map(int, more)))

    def _as_address(pointer: Any) -> int:
        return int(pointer.ctypes.data)

    _load, _store = (
        {dtype: twin(dtype) for dtype in set(DTYPES)} for twin in (_twin_of_load, _twin_of_store)
    )
else:
    _load = {dtype: _load_intrinsic(numba.from_dtype(np.dtype(dtype))) for dtype in set(DTYPES)}
    _store = {dtype: _store_intrinsic(numba.from_dtype(np.dtype(dtype))) for dtype in set(DTYPES)}

_f64, _f32, _i64, _u64 = (_load[d] for d in (np.float64, np.float32, np.int64, np.uint64))
_i32, _u32, _i16, _u16 = (_load[d] for d in (np.int32, np.uint32, np.int16, np.uint16))
_i8, _u8 = _load[np.int8], _load[np.uint8]
_to_f64, _to_f32, _to_i64, _to_u64 = (
    _store[d] for d in (np.float64, np.float32, np.int64, np.uint64)
)
_to_i32, _to_u32, _to_i16, _to_u16 = (_store[d] for d in (np.int32, np.uint32, np.int16, np.uint16))
_to_i8, _to_u8 = _store[np.int8], _store[np.uint8]

# ------------------------------------------------------------------------------------- the step


def _function(*signature: Any) -> Any:
    return numba.njit(*signature, **OPTIONS)


@_function(f8(i8, i8, i8))
def _read(kind: Any, at: Any, i: Any) -> Any:
    """Return value `i` of an array of a type as a float64."""
    if kind == F64:
        return _f64(at, i)
    if kind == F32:
        return np.float64(_f32(at, i))
    if kind in (I32, BOOL32):
        return np.float64(_i32(at, i))
    if kind == I64:
        return np.float64(_i64(at, i))
    if kind in (U8, BOOL8):
        return np.float64(_u8(at, i))
    if kind == I8:
        return np.float64(_i8(at, i))
    if kind == I16:
        return np.float64(_i16(at, i))
    if kind == U16:
        return np.float64(_u16(at, i))
    if kind == U32:
        return np.float64(_u32(at, i))
    return np.float64(_u64(at, i))


@_function(types.void(i8, i8, i8, f8))
def _write(kind: Any, at: Any, i: Any, value: Any) -> None:
    """Set value `i` of an array: the nearest that the type has, 0 for NaN."""
    if kind == F64:
        _to_f64(at, i, value)
        return
    if kind == F32:
        _to_f32(at, i, np.float32(value))
        return
    if value != value:
        value = 0.0
    whole = np.floor(min(max(value, _LOW[kind]), _HIGH[kind]) + 0.5)
    if kind in (I32, BOOL32):
        _to_i32(at, i, np.int32(whole))
    elif kind == I64:
        _to_i64(at, i, np.int64(whole))
    elif kind in (U8, BOOL8):
        _to_u8(at, i, np.uint8(whole))
    elif kind == I8:
        _to_i8(at, i, np.int8(whole))
    elif kind == I16:
        _to_i16(at, i, np.int16(whole))
    elif kind == U16:
        _to_u16(at, i, np.uint16(whole))
    elif kind == U32:
        _to_u32(at, i, np.uint32(whole))
    else:
        _to_u64(at, i, np.uint64(whole))


@_function(i8(i8, i8))
def _exchange(head: Any, row: Any) -> Any:
    """Call the function of a group on its values; return its status."""
    return _transfer(
        _i64(head, VERSION),
        _i64(row, FUNCTION),
        _i64(head, INSTANCE),
        _i64(row, REFERENCES),
        _i64(row, N_REFERENCES),
        _i64(row, VALUES),
        _i64(row, N_VALUES),
    )


@_function(i8(i8, i8, i8))
def _set(head: Any, role: Any, own: Any) -> Any:
    """Give the FMU its inputs, or the parameters if one of them has changed; return the status."""
    worst = OK
    for g in range(_i64(head, N_GROUPS)):
        row = _i64(head, GROUPS) + 8 * GROUP_SIZE * g
        if _i64(row, ROLE) != role:
            continue
        changed = role == INPUT
        kind, values, places = _i64(row, KIND), _i64(row, VALUES), _i64(row, PLACES)
        for i in range(_i64(row, N_VALUES)):
            value = _f64(own, _i64(places, i))
            if role == PARAMETER and value != _f64(_i64(row, LAST), i):
                changed = True
                _to_f64(_i64(row, LAST), i, value)
                _write(kind, values, i, value)
            elif role == INPUT:
                _write(kind, values, i, value)
        if changed:
            worst = max(worst, _exchange(head, row))
    return worst


@_function(i8(i8, i8))
def _get(head: Any, own: Any) -> Any:
    """Take the outputs; return the status."""
    worst = OK
    for g in range(_i64(head, N_GROUPS)):
        row = _i64(head, GROUPS) + 8 * GROUP_SIZE * g
        if _i64(row, ROLE) != OUTPUT:
            continue
        worst = max(worst, _exchange(head, row))
        kind, values, places = _i64(row, KIND), _i64(row, VALUES), _i64(row, PLACES)
        for i in range(_i64(row, N_VALUES)):
            _to_f64(own, _i64(places, i), _read(kind, values, i))
    return worst


@_function(types.void(i8, i8, i8))
def _note(head: Any, status: Any, where: Any) -> None:
    """Keep the worst status, and where it came first."""
    if status > _i64(head, STATUS):
        _to_i64(head, STATUS, status)
        _to_i64(head, FAILED, where)


@_function(types.void(f8, i8, i8, i8, i8))
def _advance(dt: Any, head: Any, p: Any, u: Any, y: Any) -> None:
    k = _i64(head, STEPS)
    _to_i64(head, STEPS, k + 1)
    _note(head, max(_set(head, PARAMETER, p), _set(head, INPUT, u)), SETTING)
    if k > 0 and _i64(head, STATUS) <= WARNING:
        t, told = (k - 1) * dt, head + 8 * HEAD_SIZE
        status = _do_step(
            _i64(head, VERSION), _i64(head, DO_STEP), _i64(head, INSTANCE), t, k * dt - t, told
        )
        if status <= WARNING and (_u8(told, 1) != 0 or _u8(told, 2) != 0):
            status = ENDED
        _note(head, status, STEPPING)
    if _i64(head, STATUS) <= WARNING:
        _note(head, _get(head, y), GETTING)


def _step(t: Any, dt: Any, p: Any, x: Any, u: Any, y: Any) -> None:
    """Step the FMU whose calls are described at the address in x[0]; see above."""
    head, out = np.int64(_f64(_as_address(x), 0)), _as_address(y)
    if head == 0:
        return
    if _i64(head, STATUS) <= WARNING:
        _advance(dt, head, _as_address(p), _as_address(u), out)
    _to_f64(_as_address(x), 1, np.float64(_i64(head, STATUS)))
    if _i64(head, STATUS) > WARNING:
        for i in range(_i64(head, N_OUT)):
            _to_f64(out, i, np.nan)


step: Any = _step if JIT_OFF else _function(types.void(f8, f8, *[POINTER] * 4))(_step)


def entry() -> Any:
    """Return what `drivers.compiled.stage.call` takes for the step of an FMU."""
    if LOOP_INTERPRETED:
        return step_vectors
    (found,) = step.overloads.values()
    return int(found.library.get_pointer_to_function(found.fndesc.llvm_func_name))


def step_vectors(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Step on float64 vectors."""
    if JIT_OFF:
        step(t, dt, p, x, u, y)
    else:
        in_c()(t, dt, *(view.ctypes.data for view in (p, x, u, y)))


@cache
def in_c() -> Any:
    """Return the step as a function of two numbers and four addresses."""
    kinds = [ctypes.c_double, ctypes.c_double, *[ctypes.c_void_p] * 4]
    if JIT_OFF:
        return lambda t, dt, *at: step(t, dt, *(_array(one, np.float64, 1) for one in at))
    (found,) = step.overloads.values()
    address = found.library.get_pointer_to_function(found.fndesc.llvm_cfunc_wrapper_name)
    return ctypes.CFUNCTYPE(None, *kinds)(address)
