"""Two calls of Linux that Python does not have: memory mapped at a place, signals as a file."""

import ctypes
import mmap
import os
from collections.abc import Iterable

_MAP_SHARED, _MAP_FIXED, _MAP_POPULATE = 0x01, 0x10, 0x8000
_PROT_READ_AND_WRITE = 1 | 2
_SFD_FLAGS = os.O_NONBLOCK | os.O_CLOEXEC
_SIGNALS = 1024  # of a sigset_t of the C libraries

_libc = ctypes.CDLL(None, use_errno=True)
_libc.mmap.restype = ctypes.c_void_p
_libc.mmap.argtypes = [
    ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_long,
]  # fmt: skip
_FAILED = ctypes.c_void_p(-1).value


def map_over(memory: mmap.mmap, at: int, size: int, descriptor: int, offset: int) -> None:
    """Put `size` bytes of a file over a part of `memory`, shared and resident; OSError.

    `memory` unmaps it with the rest.
    """
    if at < 0 or size <= 0 or at + size > len(memory):
        raise ValueError(f"{at}..{at + size} is not inside {len(memory)} bytes")
    begin = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    address = _libc.mmap(
        begin + at,
        size,
        _PROT_READ_AND_WRITE,
        _MAP_SHARED | _MAP_FIXED | _MAP_POPULATE,
        descriptor,
        offset,
    )
    if address == _FAILED:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))


def signal_file(numbers: Iterable[int]) -> int:
    """Return a descriptor that is readable when one of these signals, blocked, has come; OSError.

    Reading 128 bytes takes one of them.
    """
    bits = sum(1 << (number - 1) for number in numbers)
    mask = ctypes.create_string_buffer(bits.to_bytes(_SIGNALS // 8, "little"), _SIGNALS // 8)
    descriptor: int = _libc.signalfd(-1, mask, _SFD_FLAGS)
    if descriptor < 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    return descriptor
