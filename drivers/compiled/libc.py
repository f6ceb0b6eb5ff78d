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

SIGNATURES: dict[str, str] = {}  # by name: result, arguments


def _deferred(name: str) -> Any:
    return Deferred("pcpc.drivers.compiled.libc_types", name)


def _function(name: str, signature: str) -> Any:
    """Return a function of libc, of these int32 and int64."""
    SIGNATURES[name] = signature
    if not LOOP_INTERPRETED:
        return _deferred(name)
    numbers = {"i4": ctypes.c_int, "i8": ctypes.c_int64}
    found = getattr(ctypes.CDLL(None, use_errno=True), name)
    found.restype, *found.argtypes = (numbers[one] for one in signature.split())
    return found


clock_nanosleep = _function("clock_nanosleep", "i4 i4 i4 i8 i8")  # returns the error number itself
clock_gettime = _function("clock_gettime", "i4 i4 i8")
getrusage = _function("getrusage", "i4 i4 i8")
memcpy = _function("memcpy", "i8 i8 i8 i8")
poll = _function("poll", "i4 i8 i8 i4")
ppoll = _function("ppoll", "i4 i8 i8 i8 i8")
recv = _function("recv", "i8 i4 i8 i8 i4")
recvfrom = _function("recvfrom", "i8 i4 i8 i8 i4 i8 i8")
send = _function("send", "i8 i4 i8 i8 i4")
sched_yield = _function("sched_yield", "i4")

if not LOOP_INTERPRETED:
    errno: Any = _deferred("errno")
    load_acquire: Any = _deferred("load_acquire")
    store_release: Any = _deferred("store_release")
    fence_release: Any = _deferred("fence_release")
    address: Any = _deferred("address")
else:
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
