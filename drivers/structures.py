"""Structures: what `n.k`, `n.wire.errno` and `n.v[i]` are in compiled code.

A Structure is a pointer to one element of a structured numpy array. Its fields are numbers, Cells
(`drivers.views`) and further Structures, so that every access is a load or store at an address that
the compiler knows, up to the index. numba's own record makes an array of each field and takes a
negative index from its end: that was a quarter of the loop's cycle.

    structure(dtype)       the type of `array[0]` for functions with a signature; without one it is
                           known once the dtype was named here
    data_of(frame)         the data bytes of a frame, Cells
    copy(target, source)   a frame's bytes into another's place
"""

import hashlib
from typing import Any

import numpy as np

# ruff: isort: off
from pcpc.drivers.jit import LOOP_INTERPRETED, numba, types
from pcpc.drivers.views import Cells, Fields, Pointer, data
from llvmlite import ir  # after ours, which set numba's environment
from numba.extending import NativeValue, intrinsic, register_model, typeof_impl, unbox
# ruff: isort: on

_I64 = ir.IntType(64)


class Structure(Fields):
    """The type of a pointer to a structure; `fields`: name, type, place in bytes."""

    element = types.uint8

    def __init__(self, fields: tuple[tuple[str, Any, int], ...]) -> None:
        self.fields = {name: (kind, place) for name, kind, place in fields}
        mark = hashlib.sha256(repr(fields).encode()).hexdigest()[:12]
        super().__init__(f"Structure({mark})")

    def field(self, name: str) -> tuple[Any, int] | None:
        """Return a number, Cells or a nested structure."""
        return self.fields.get(name)


register_model(Structure)(Pointer)
_known: dict[np.dtype[Any], Structure] = {}


def structure(dtype: np.dtype[Any]) -> Any:
    """Return the type of a structure of `dtype`, which from now on has it everywhere."""
    plain = _plain(dtype)
    if plain not in _known:
        places: Any = plain.fields
        fields = ((name, _kind(places[name][0]), places[name][1]) for name in places)
        _known[plain] = Structure(tuple(fields))
    return _known[plain]


def _plain(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return `dtype` as numpy makes it of a list, also of an element of a recarray."""
    return np.dtype((np.void, dtype)) if dtype.type is np.record else dtype


def _kind(dtype: np.dtype[Any]) -> Any:
    if dtype.fields is not None:
        return structure(dtype)
    base, shape = dtype.subdtype or (dtype, ())
    number = numba.from_dtype(base)
    return Cells(shape, number) if shape else number


@typeof_impl.register(np.record)
def _typeof(value: np.record, context: Any) -> Any:
    return _known.get(_plain(value.dtype)) or numba.from_dtype(value.dtype)


@unbox(Structure)
def _unbox(kind: Any, value: Any, c: Any) -> Any:
    buffer = c.pyapi.alloca_buffer()
    pointer = c.pyapi.extract_record_data(value, buffer)
    failed = c.builder.icmp_unsigned("==", pointer, ir.Constant(pointer.type, None))
    pointer = c.builder.bitcast(pointer, c.context.get_value_type(kind))
    return NativeValue(pointer, failed, lambda: c.pyapi.release_buffer(buffer))


@intrinsic
def _data_of(typing: Any, frame: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.gep(arguments[0], [ir.Constant(_I64, 8)], inbounds=True)

    return Cells((8,), types.uint8)(frame), generate


@intrinsic
def _copy(typing: Any, target: Any, source: Any) -> Any:
    """Load all 16 bytes, then store them: no byte of one may be one of the other."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        frame = ir.VectorType(ir.IntType(8), 16).as_pointer()
        into, out_of = (
            builder.bitcast(data(context, builder, kind, value), frame)
            for kind, value in zip(signature.args, arguments, strict=True)
        )
        builder.store(builder.load(out_of, align=1), into, align=1)
        return context.get_dummy_value()

    return types.void(target, source), generate


def _data_interpreted(frame: Any) -> Any:
    return frame[8:16]


def _copy_interpreted(target: Any, source: Any) -> None:
    target[:] = source


data_of: Any = _data_interpreted if LOOP_INTERPRETED else _data_of
copy: Any = _copy_interpreted if LOOP_INTERPRETED else _copy
