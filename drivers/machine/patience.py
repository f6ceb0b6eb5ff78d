"""A bound on the time that a parser of others may take: files can make one loop for ever."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


class StalledError(Exception):
    """A block took its CPU time and came no further."""


@contextmanager
def patience(limit_s: float, progress: Callable[[], int] = lambda: 0) -> Iterator[None]:
    """Raise StalledError inside of the block after `limit_s` in which `progress()` stayed equal.

    Seconds are those that the process computes, so that a loaded machine is no stall. Signals are
    the main thread's: in another one nothing is bounded.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    last = progress()

    def look(_number: int, _frame: Any) -> None:
        nonlocal last
        if progress() == last:
            raise StalledError
        last = progress()

    before = signal.signal(signal.SIGVTALRM, look)
    signal.setitimer(signal.ITIMER_VIRTUAL, limit_s, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)
