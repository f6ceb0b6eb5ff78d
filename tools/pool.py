"""Processes that share the work of a study and end with it, also when it is ended early."""

import multiprocessing
import os
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

from pcpc.drivers.errors import Exit, UserError

_CURE = "end other programs, or give it fewer with --jobs"


class PoolError(UserError):
    """A process of a study died."""

    code = Exit.ENVIRONMENT


@contextmanager
def workers(jobs: int | None, most: int | None = None) -> Iterator[ProcessPoolExecutor]:
    """Give `jobs` processes (all processors), not more than `most`; PoolError if one dies.

    Ctrl-C is for this process; after it, or any error, none of the processes lives on.
    """
    count = max(1, min(jobs or os.cpu_count() or 1, most or jobs or os.cpu_count() or 1))
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(count, context, initializer=_leave_ctrl_c)
    try:
        yield pool
    except BaseException as error:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            process.terminate()
        if isinstance(error, BrokenProcessPool):
            raise PoolError(
                f"a process of the study was killed (no memory left?); {_CURE}"
            ) from None
        raise
    pool.shutdown()


def _leave_ctrl_c() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
