"""Draws to rows on a Dask cluster, its own of this machine or one that is there.

A task is some hundred runs. Its worker writes each row to the task's own journal, in the campaign's
folder, before the next; a task that is sent again, as its worker is gone, takes the rows that are
there. The client takes the rows of a finished task into the shard's journal and drops the task's;
one that a killed client or scheduler left is taken in at the next start (`store`).

So folder and rig have to be on a disk that client and workers share: without one, the rows of a
lost worker would be lost, too. Who does a task, and when, is Dask's affair.
"""

import dataclasses
import functools
import gc
import itertools
import logging
import re
import signal
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import suppress
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import RigError
from pcpc.tools.study.engine import AHEAD, Engine, Piece, Pieces, Row
from pcpc.tools.study.sweep import store
from pcpc.tools.study.sweep.campaign import Campaign, read
from pcpc.tools.terminal.extras import need

TASK = 32  # pieces of WIDTH runs; a second or more of work
ANSWER_S = 10.0  # within which a scheduler answers and has a worker
_LOCAL = re.compile(r"local(?::([1-9]\d*))?")


class Cluster:
    """The workers of a scheduler, for one shard; ends what it has started when it is left."""

    def __init__(self, scheduler: str, campaign: Campaign, into: "store.Store") -> None:
        """Connect to it. UserError: no package, no answer, no worker."""
        need("--scheduler needs", "distributed")
        import distributed

        for name in logging.root.manager.loggerDict:  # what matters is told here
            if name.partition(".")[0] == "distributed":
                logging.getLogger(name).setLevel(logging.CRITICAL)
        self._scheduler, self._store = scheduler, into
        rig = str(Path(campaign.rig).resolve())
        self._campaign = dataclasses.replace(campaign, rig=rig)
        local = _LOCAL.fullmatch(scheduler)
        self._own: Any = local and distributed.LocalCluster(
            n_workers=int(local[1]) if local[1] else None,
            threads_per_worker=1,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
            preload=__name__,
        )
        with suppress(OSError, ValueError):
            self._client = distributed.Client(self._own or scheduler, timeout=ANSWER_S)
        if not hasattr(self, "_client"):
            gc.collect()  # what is half made closes itself now; beside the next one it deadlocks
            what = f"--scheduler {scheduler}: no answer; start `dask scheduler`"
            raise UserError(what, Exit.ENVIRONMENT)
        try:
            self._client.wait_for_workers(1, timeout=ANSWER_S)
        except TimeoutError:
            self.__exit__()
            what = f"--scheduler {scheduler}: it has no worker; start `dask worker {scheduler}`"
            raise UserError(what, Exit.ENVIRONMENT) from None

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(self, *error: object) -> None:
        self._client.close(timeout=1)
        if self._own:
            self._own.close()

    def rows(self, pieces: Pieces) -> Iterator[list[Row]]:
        """Yield the rows of tasks as they are done; what was yielded is on disk when asked on.

        UserError: the scheduler is gone, or a task that its workers do not survive.
        """
        from distributed import KilledWorker, as_completed

        try:
            tasks, flying = self._tasks(pieces), dict[Any, Path]()
            queue = as_completed()
            while True:
                wanted = AHEAD * self._threads() - len(flying)  # below 0 where a worker was lost
                for task in itertools.islice(tasks, max(wanted, 0)):
                    journal = self._store.task_journal(task[0][1][0].number, task[0][0])
                    about = self._campaign, journal.resolve(), task
                    future = self._client.submit(run_task, *about, pure=False)
                    flying[future] = journal
                    queue.add(future)
                if not flying:
                    return
                future = next(queue)
                yield future.result()
                flying.pop(future).unlink(missing_ok=True)
        except KilledWorker as error:
            what = f"{self._scheduler}: workers die at a task, again and again: {error}"
            raise UserError(what, Exit.ENVIRONMENT) from None
        except (CancelledError, OSError) as error:
            told = str(error).partition("\n")[0] or type(error).__name__
            what = f"--scheduler {self._scheduler}: lost ({told}); the same command goes on"
            raise UserError(f"{what} with -o {self._store.folder}", Exit.ENVIRONMENT) from None

    def _threads(self) -> int:
        """Return how many there are now; 1 where no worker is left, and one may come."""
        return max(1, sum(self._client.nthreads().values()))

    def _tasks(self, pieces: Pieces) -> Iterator[list[Piece]]:
        """Yield pieces in tasks: of TASK, or of fewer where all threads would not have one."""
        left, threads = iter(pieces), self._threads()
        first = list(itertools.islice(left, TASK * threads))
        size = -(-len(first) // threads)
        left = itertools.chain(first, left)
        while task := list(itertools.islice(left, size)):
            yield task


def dask_setup(worker: object) -> None:
    """Leave Ctrl-C to the client; Dask calls this at the start of a worker that it was to load."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


_turn = threading.Lock()


def run_task(campaign: Campaign, path: Path, pieces: list[Piece]) -> list[Row]:
    """Return a task's rows, on a worker; each is in the journal at `path` before the next piece."""
    with _turn:  # compiled once
        engine = _engine(campaign, path.parent)
    journal = store.Journal(path, wait=True)
    try:
        for controller, draws in pieces:
            left = [draw for draw in draws if (draw.number, controller) not in journal.rows]
            if left:
                journal.add(engine.piece(controller, left))
        return [
            journal.rows[draw.number, controller] for controller, draws in pieces for draw in draws
        ]
    finally:
        journal.close()


@functools.lru_cache(maxsize=1)
def _engine(campaign: Campaign, folder: Path) -> Engine:
    """Return this process's own, for any number of threads. RigError: another rig or no folder."""
    here = f"a worker on {socket.gethostname()}"
    if not (folder / store.SPEC).exists():
        cure = "give -o a folder on a disk that all of them share"
        raise RigError(f"{folder}: {here} does not see it; {cure}")
    if differ := campaign.changed(read(folder / store.SPEC)):
        raise RigError(f"{campaign.rig}: {here} differs from the campaign in {differ}")
    return Engine(Path(campaign.rig), campaign.controllers, campaign.settings, threads=1)
