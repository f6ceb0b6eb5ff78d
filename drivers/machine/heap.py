"""Memory of a process that runs for days: what it does not need any more goes back to the kernel.

glibc lets the size from which it asks the kernel for a block of its own grow up to the largest one
that was freed. From then on blocks of 100 kB lie among small ones in its heap, and each batch that
is larger than all before leaves it larger for good: a recorder beside stalls grew by 3 % an hour.
"""

import ctypes

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h
_OWN_BYTES, _TRIM_BYTES = 64 << 10, 128 << 10


def give_back() -> None:
    """Take each block of 64 kB and more from the kernel, and return it whole; glibc alone can."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _OWN_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _TRIM_BYTES)
