"""libc calls and atomics for the loop: compiled, and a plain twin for when it runs interpreted.

Compiled: `types.ExternalFunction` binds the symbol, not an address, so numba can cache the caller.
Atomics are three-line intrinsics; on x86 an acquire load and a release store are plain moves, on
ARM they are not. Pointers travel as integers (`address(a)`): the caller keeps the array alive.
"""

import ctypes
from typing import Any

from pcpc.drivers.compiled.deferred import Deferred
from pcpc.drivers.compiled.jit import LOOP_INTERPRETED

CLOCK_MONOTONIC = 1
TIMER_ABSTIME = 1
MSG_DONTWAIT = 0x40
EINTR = 4
EAGAIN = 11
POLLIN = 1

SIGNATURES = {  # result, arguments
    "clock_nanosleep": "i4 i4 i4 i8 i8",  # returns the error number itself
    "clock_gettime": "i4 i4 i8",
    "getrusage": "i4 i4 i8",
    "memcpy": "i8 i8 i8 i8",
    "poll": "i4 i8 i8 i4",
    "ppoll": "i4 i8 i8 i8 i8",
    "recv": "i8 i4 i8 i8 i4",
    "recvfrom": "i8 i4 i8 i8 i4 i8 i8",
    "send": "i8 i4 i8 i8 i4",
    "sched_yield": "i4",
}


def _deferred_function(name: str) -> Any:
    return Deferred("pcpc.drivers.compiled.libc_types", name)


if not LOOP_INTERPRETED:
    clock_nanosleep = _deferred_function("clock_nanosleep")
    clock_gettime = _deferred_function("clock_gettime")
    getrusage = _deferred_function("getrusage")
    memcpy = _deferred_function("memcpy")
    poll = _deferred_function("poll")
    ppoll = _deferred_function("ppoll")
    recv = _deferred_function("recv")
    recvfrom = _deferred_function("recvfrom")
    send = _deferred_function("send")
    sched_yield = _deferred_function("sched_yield")
    errno: Any = _deferred_function("errno")
    load_acquire: Any = _deferred_function("load_acquire")
    store_release: Any = _deferred_function("store_release")
    fence_release: Any = _deferred_function("fence_release")
    address: Any = _deferred_function("address")
else:
    _LIBC = ctypes.CDLL(None, use_errno=True)
    _CTYPES = {"i4": ctypes.c_int, "i8": ctypes.c_int64}

    def _bind(name: str) -> Any:
        function = getattr(_LIBC, name)
        result, *arguments = SIGNATURES[name].split()
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
