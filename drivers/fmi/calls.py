"""Memory and functions of an FMU by their addresses; a plain twin of each for when numba is off.

instance_at(address)             the structure Head that lies there
call(function, arguments)        its status; `arguments`: a tuple of numbers, as C has them
read(kind, address, i)           value `i` of an array of a type, as a float64
write(kind, address, i, value)   the other way round, for a value that the type has

Functions and arrays are addresses.
"""

import ctypes
from typing import Any

import numpy as np

from pcpc.drivers.compiled.deferred import Deferred, with_numba
from pcpc.drivers.compiled.jit import JIT_OFF
from pcpc.drivers.compiled.structures import structure
from pcpc.drivers.fmi.layout import DTYPES, Head

structure(Head.dtype)
_TYPES = "pcpc.drivers.fmi.calls_types"
_IN_C = {"i": ctypes.c_int32, "l": ctypes.c_int64, "d": ctypes.c_double}


def _array(address: int, dtype: Any, n: int) -> Any:
    return np.frombuffer((ctypes.c_byte * (dtype.itemsize * n)).from_address(int(address)), dtype)


def _instance_at(address: int) -> Any:
    return _array(address, Head.dtype, 1).view(np.recarray)[0]


def _call(function: int, arguments: tuple[Any, ...]) -> int:
    given = [_IN_C[np.asarray(one).dtype.char](np.asarray(one).item()) for one in arguments]
    return int(ctypes.CFUNCTYPE(ctypes.c_int32, *map(type, given))(int(function))(*given))


def _read(kind: int, address: int, i: int) -> float:
    return float(_array(address, DTYPES[kind], i + 1)[i])


def _write(kind: int, address: int, i: int, value: float) -> None:
    _array(address, DTYPES[kind], i + 1)[i] = value


if not JIT_OFF:
    with_numba(_TYPES)
instance_at: Any = _instance_at if JIT_OFF else Deferred(_TYPES, "instance_at")
call: Any = _call if JIT_OFF else Deferred(_TYPES, "call")
read: Any = _read if JIT_OFF else Deferred(_TYPES, "read")
write: Any = _write if JIT_OFF else Deferred(_TYPES, "write")
