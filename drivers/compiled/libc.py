"""libc calls and atomics for the loop: compiled, and a plain twin for when it runs interpreted.

Compiled: `types.ExternalFunction` binds the symbol, not an address, so numba can cache the caller.
Atomics are three-line intrinsics; on x86 an acquire load and a release store are plain moves, on
ARM they are not. Pointers travel as integers (`address(a)`): the caller keeps the array alive.
"""

import ctypes
from typing import Any

import numpy as np

from pcpc.drivers.compiled.jit import LOOP_INTERPRETED, carray, loop_inline, types

CLOCK_MONOTONIC = 1
TIMER_ABSTIME = 1
MSG_DONTWAIT = 0x40
EINTR = 4
EAGAIN = 11
POLLIN = 1

_i4, _i8 = types.int32, types.int64
_SIGNATURES = {
    "clock_nanosleep": (_i4, _i4, _i4, _i8, _i8),  # returns the error number itself
    "clock_gettime": (_i4, _i4, _i8),
    "getrusage": (_i4, _i4, _i8),
    "memcpy": (_i8, _i8, _i8, _i8),
    "poll": (_i4, _i8, _i8, _i4),
    "ppoll": (_i4, _i8, _i8, _i8, _i8),
    "recv": (_i8, _i4, _i8, _i8, _i4),
    "recvfrom": (_i8, _i4, _i8, _i8, _i4, _i8, _i8),
    "send": (_i8, _i4, _i8, _i8, _i4),
    "sched_yield": (_i4,),
}


def _untyped(function: Any) -> Any:
    """Return `function`: numba's intrinsics are called without their typing context."""
    return function


if not LOOP_INTERPRETED:
    from numba import extending

    from pcpc.drivers.compiled.views import Fields, address_of, data

    intrinsic: Any = extending.intrinsic  # its callers do not pass the typing context
    literal_intrinsic: Any = extending.intrinsic(prefer_literal=True)

    def _external(name: str) -> Any:
        result, *arguments = _SIGNATURES[name]
        return types.ExternalFunction(name, result(*arguments))

    clock_nanosleep = _external("clock_nanosleep")
    clock_gettime = _external("clock_gettime")
    getrusage = _external("getrusage")
    memcpy = _external("memcpy")
    poll = _external("poll")
    ppoll = _external("ppoll")
    recv = _external("recv")
    recvfrom = _external("recvfrom")
    send = _external("send")
    sched_yield = _external("sched_yield")
    _errno_location: Any = types.ExternalFunction("__errno_location", types.CPointer(_i4)())

    @loop_inline
    def errno() -> Any:
        """Return the calling thread's errno."""
        return np.int64(carray(_errno_location(), 1)[0])

    def _word(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        """Return the address of an array's element, or of a structure's word of that name."""
        kind, at = signature.args[:2]
        if isinstance(kind, Fields):
            return address_of(context, builder, args[0], kind.field(at.literal_value))[0]
        return builder.gep(data(context, builder, kind, args[0]), [args[1]])

    @_untyped
    @literal_intrinsic
    def load_acquire(typing_context: Any, array: Any, index: Any) -> Any:
        """Return array[index] (int64) with acquire order; of a structure, the word of that name."""

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.load_atomic(_word(context, builder, signature, args), "acquire", 8)

        return _i8(array, index if isinstance(array, Fields) else _i8), generate

    @_untyped
    @literal_intrinsic
    def store_release(typing_context: Any, array: Any, index: Any, value: Any) -> Any:
        """Set array[index] (int64) with release order; of a structure, the word of that name."""

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            word = _word(context, builder, signature, args)
            builder.store_atomic(args[2], word, "release", 8)
            return context.get_dummy_value()

        return types.void(array, index if isinstance(array, Fields) else _i8, _i8), generate

    @_untyped
    @intrinsic
    def fence_release(typing_context: Any) -> Any:
        """Keep earlier stores before later ones."""

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            builder.fence("release")
            return context.get_dummy_value()

        return types.void(), generate

    @_untyped
    @intrinsic
    def address(typing_context: Any, array: Any) -> Any:
        """Return the address of the array's first element."""

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            first = data(context, builder, signature.args[0], args[0])
            return builder.ptrtoint(first, context.get_value_type(_i8))

        return _i8(array), generate

else:
    _LIBC = ctypes.CDLL(None, use_errno=True)
    _CTYPES = {_i4: ctypes.c_int, _i8: ctypes.c_int64}

    def _bind(name: str) -> Any:
        function = getattr(_LIBC, name)
        result, *arguments = _SIGNATURES[name]
        function.restype = _CTYPES[result]
        function.argtypes = [_CTYPES[a] for a in arguments]
        return function

    clock_nanosleep = _bind("clock_nanosleep")
    clock_gettime = _bind("clock_gettime")
    getrusage = _bind("getrusage")
    memcpy = _bind("memcpy")
    poll = _bind("poll")
    ppoll = _bind("ppoll")
    recv = _bind("recv")
    recvfrom = _bind("recvfrom")
    send = _bind("send")
    sched_yield = _bind("sched_yield")
    errno = ctypes.get_errno

    def load_acquire(array: Any, index: int | str) -> int:
        """Return array[index]."""
        return int(array[index])

    def store_release(array: Any, index: int | str, value: int) -> None:
        """Set array[index]."""
        array[index] = value

    def fence_release() -> None:
        """Do nothing: the interpreter does not reorder."""

    def address(array: Any) -> int:
        """Return the address of the array's first element."""
        return int(array.ctypes.data)
