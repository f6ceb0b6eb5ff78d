"""All memory of a process, held in RAM: nothing that the loop needs has to be read from disk.

`mlockall` alone gives a process its own copy of each page that it shares with the one it was forked
from, and fills all that was reserved and never used: 0.15 s and 250 MB for each node of a run. Here
pages stay shared until somebody writes to them, once, for a microsecond; what a loop writes it has
written when it was warmed up. What is mapped later comes whole. Pages of no file are there since
they were written, unless some have been swapped out.

Linux before 5.14 does not know how; there it is `mlockall` alone.
"""

import ctypes
import errno as codes
import os
from collections.abc import Iterator
from pathlib import Path

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_MADV_POPULATE_READ = 22

_libc = ctypes.CDLL(None, use_errno=True)
_libc.mlockall.argtypes = [ctypes.c_int]
_libc.madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]


def lock() -> None:
    """Lock what is mapped now and what will be; OSError if the kernel refuses."""
    if not _populated():
        _mlockall(_MCL_CURRENT | _MCL_FUTURE)
        return
    _mlockall(_MCL_CURRENT | _MCL_ONFAULT)  # with _MCL_FUTURE later mappings would come empty
    _mlockall(_MCL_FUTURE)


def _mlockall(flags: int) -> None:
    if _libc.mlockall(flags) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _populated() -> bool:
    """Bring every page that can be read into memory; return whether the kernel knows how."""
    return not any(
        _libc.madvise(start, size, _MADV_POPULATE_READ) and ctypes.get_errno() == codes.EINVAL
        for start, size in _readable()
    )


def _readable() -> Iterator[tuple[int, int]]:
    """Find what may be read and can lie on a disk, but for the kernel's own: (address, bytes)."""
    swapped = "VmSwap:\t       0 kB" not in Path("/proc/self/status").read_text()
    for line in Path("/proc/self/maps").read_text().splitlines():
        addresses, rights, _, _, inode, *_ = line.split(maxsplit=5)
        if rights[0] == "r" and "[v" not in line and (swapped or inode != "0"):
            start, end = (int(address, 16) for address in addresses.split("-"))
            yield start, end - start
