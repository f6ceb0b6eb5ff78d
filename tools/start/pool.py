"""Processes that share the work of a study and end with it, also when it is ended early."""

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from pcpc.drivers.errors import Exit, UserError
from pcpc.tools.start.children import end_with
from pcpc.tools.terminal.progress import Compiling, Progress

Item = TypeVar("Item")
Result = TypeVar("Result")
_LOOK_S = 0.5
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
    pool = ProcessPoolExecutor(count, context, initializer=_begin, initargs=(os.getpid(),))
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


def each(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    progress: Progress,
    jobs: int | None = None,
    runs: Callable[[Item], int] = lambda item: 1,
) -> list[Result]:
    """Call `function` with every item on `jobs` processes; results in the order of the items.

    `runs`: how many of them an item stands for, of which the progress tells.
    """
    results: dict[int, Result] = {}
    begin, compiling = time.monotonic(), Compiling()
    total = sum(map(runs, items))
    with workers(jobs, len(items)) as pool:
        futures = {pool.submit(function, item): i for i, item in enumerate(items)}
        pending = set(futures)
        while pending:
            over, pending = wait(pending, _LOOK_S, FIRST_COMPLETED)
            results |= {futures[future]: future.result() for future in over}
            done, spent = sum(runs(items[i]) for i in results), time.monotonic() - begin
            if not done:
                progress.show(compiling.text() or f"starting, {spent:.0f} s")
                continue
            left = spent / done * (total - done)
            progress.show(f"run {done}/{total}, {spent:.0f} s, about {left:.0f} s left")
    progress.close()
    return [results[i] for i in range(len(items))]


def _begin(host: int) -> None:
    """Leave Ctrl-C to `host`, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(host)
