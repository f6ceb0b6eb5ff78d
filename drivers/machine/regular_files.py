"""Regular files, opened for reading: no pipe is waited for, no device is read without an end."""

import errno
import fcntl
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO


def open_regular(path: Path, flags: int = 0) -> BinaryIO:
    """Return an open regular file; OSError with the reason where it is none, or cannot be read.

    `flags`: of os.open, besides those for reading.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | flags)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            is_folder = stat.S_ISDIR(status.st_mode)
            raise OSError(0, "Is a directory" if is_folder else "is no regular file")
        if not status.st_size and _says_more(descriptor):
            raise OSError(0, "is no regular file")
        return open(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def _says_more(descriptor: int) -> bool:
    """Return whether a file without a size has data: it is the kernel's, perhaps without end."""
    try:
        return bool(os.pread(descriptor, 1, 0))
    except OSError:
        return True


def read_text(path: Path) -> str:
    """Return the text of a regular file; OSError, UnicodeDecodeError."""
    with open_regular(path) as file:
        return file.read().decode("utf-8")


def show_being_written(file: BinaryIO) -> None:
    """Lock a file until it is closed, for `is_being_written`; without effect where none can be."""
    with suppress(OSError):
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_being_written(file: BinaryIO) -> bool:
    """Return whether another open file shows that it is being written."""
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        fcntl.flock(file, fcntl.LOCK_UN)
    except OSError as error:
        return error.errno in (errno.EWOULDBLOCK, errno.EACCES)
    return False
