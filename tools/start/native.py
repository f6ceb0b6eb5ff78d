"""Code for this machine's processor, in place of any: what numba is asked before it is imported."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

CPU = "PCPC_CPU"  # of drivers/compiled/jit.py, which reads it once


@contextmanager
def native(wanted: bool = True) -> Iterator[None]:
    """Let numba compile for this processor, if it is imported in here, or by a process begun here.

    A choice of the user's stays. Afterwards the environment is as it was.
    """
    if not wanted or CPU in os.environ:
        yield
        return
    os.environ[CPU] = "native"
    try:
        yield
    finally:
        del os.environ[CPU]
