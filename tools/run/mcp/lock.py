"""Landlock(7): this process, and all that it begins, can write below some folders only.

From Linux 6.12 on it also reaches no abstract socket and signals no process of others, so that
`set` and `operate` find no run but their own.
"""

import ctypes
import os
import struct
from collections.abc import Sequence
from pathlib import Path

_CREATE, _ADD_RULE, _RESTRICT = 444, 445, 446  # system calls, the same on every machine
_VERSION_ONLY, _BENEATH, _OLDEST = 1, 1, 3  # the third version knows truncation
_SCOPED, _SCOPES = 3, 6  # sockets and signals, from this version on
_NO_NEW_PRIVILEGES, _ADOPTS_ORPHANS = 38, 36
_OF_FILES = 1 << 1 | 1 << 14  # write, truncate
_WRITES = _OF_FILES | sum(1 << bit for bit in range(4, 14))  # remove, make, rename

_libc = ctypes.CDLL(None, use_errno=True)


def adopt_orphans() -> None:
    """Become the parent of every process that this one began, once its own parent has ended."""
    _libc.prctl(_ADOPTS_ORPHANS, 1, 0, 0, 0)


def confine(writable: Sequence[Path]) -> bool:
    """Forbid to write anywhere else for good; False where this kernel cannot. OSError."""
    version = _libc.syscall(_CREATE, None, 0, _VERSION_ONLY)
    if version < _OLDEST:
        return False
    attributes = struct.pack("QQQ", _WRITES, 0, _SCOPED)[: 24 if version >= _SCOPES else 8]
    rules = _done(_libc.syscall(_CREATE, attributes, len(attributes), 0))
    for path in writable:
        place = os.open(path, os.O_PATH | os.O_CLOEXEC)
        allowed = _WRITES if path.is_dir() else _OF_FILES
        _done(_libc.syscall(_ADD_RULE, rules, _BENEATH, struct.pack("=Qi", allowed, place), 0))
        os.close(place)
    _done(_libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0))
    _done(_libc.syscall(_RESTRICT, rules, 0))
    os.close(rules)
    return True


def _done(result: int) -> int:
    if result < 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    return result
