"""Draws to rows on a Dask cluster, its own of this machine or one that is there.

A task is some dozen runs, whose rows come back to the client: it alone writes. Workers need the
rig at the same path, and no folder. Who does a task, and when, is Dask's affair; one of a worker
that is lost is done again, and so are those that were on their way when a client was killed.
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
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import RigError
from pcpc.tools.study.engine import AHEAD, Engine, Piece, Pieces, RunVerdict
from pcpc.tools.study.sweep.campaign import Campaign
from pcpc.tools.study.sweep.store import Store
from pcpc.tools.terminal.extras import need

TASK = 8  # pieces of WIDTH runs; some tenths of a second of work, which a kill loses
ANSWER_S = 10.0  # within which a scheduler answers and has a worker
Origin = tuple[tuple[str, str], ...]
_LOCAL = re.compile(r"local(?::([1-9]\d*))?")


def connected(option: str, scheduler: str) -> tuple[Any, Any]:
    """Return a client of it and, for local[:N], its cluster; UserError: none, or no worker."""
    need(f"{option} needs", "distributed")
    import distributed

    for name in logging.root.manager.loggerDict:  # what matters is told here
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL)
    local = _LOCAL.fullmatch(scheduler)
    own: Any = local and distributed.LocalCluster(
        n_workers=int(local[1]) if local[1] else None,
        threads_per_worker=1,
        dashboard_address=None,
        silence_logs=logging.CRITICAL,
        preload=__name__,
    )
    client: Any = None
    with suppress(OSError, ValueError):
        client = distributed.Client(own or scheduler, timeout=ANSWER_S)
    if client is None:
        gc.collect()  # what is half made closes itself now; beside the next one it deadlocks
        what = f"{option} {scheduler}: no answer; start `dask scheduler`"
        raise UserError(what, Exit.ENVIRONMENT)
    try:
        client.wait_for_workers(1, timeout=ANSWER_S)
    except TimeoutError:
        close(client, own)
        what = f"{option} {scheduler}: it has no worker; start `dask worker {scheduler}`"
        raise UserError(what, Exit.ENVIRONMENT) from None
    return client, own


def close(client: Any, own: Any) -> None:
    """End a client, and the cluster that was started for it."""
    client.close(timeout=1)
    if own:
        own.close()


@contextmanager
def executor(option: str, scheduler: str) -> Iterator[tuple[Any, int]]:
    """Give an executor of `concurrent.futures` on it, and how many threads it has."""
    client, own = connected(option, scheduler)
    try:
        yield client.get_executor(pure=False), sum(client.nthreads().values())
    finally:
        close(client, own)


class Cluster:
    """The workers of a scheduler, for one shard; ends what it has started when it is left."""

    def __init__(self, scheduler: str, campaign: Campaign, into: Store) -> None:
        """Connect to it. UserError: no package, no answer, no worker."""
        self._scheduler, self._store = scheduler, into
        self._origin = tuple(into.spec["origin"].items())
        rig = str(Path(campaign.rig).resolve())
        self._campaign = dataclasses.replace(campaign, rig=rig)
        self._client, self._own = connected("--scheduler", scheduler)

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(self, *error: object) -> None:
        close(self._client, self._own)

    def rows(self, pieces: Pieces) -> Iterator[list[RunVerdict]]:
        """Yield the rows of tasks as they are done.

        UserError: the scheduler is gone, or a task that its workers do not survive.
        """
        from distributed import KilledWorker, as_completed

        try:
            tasks, flying = self._tasks(pieces), 0
            queue = as_completed()
            while True:
                wanted = AHEAD * self._threads() - flying  # below 0 where a worker was lost
                for task in itertools.islice(tasks, max(wanted, 0)):
                    about = self._campaign, self._origin, task
                    queue.add(self._client.submit(run_task, *about, pure=False))
                    flying += 1
                if not flying:
                    return
                yield next(queue).result()
                flying -= 1
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


def run_task(campaign: Campaign, origin: Origin, pieces: list[Piece]) -> list[RunVerdict]:
    """Return a task's rows, on a worker. RigError: its rig or code is not that of `origin`."""
    with _turn:  # compiled once
        engine = _engine(campaign, origin)
    return [row for piece in pieces for row in engine.piece(*piece)]


@functools.lru_cache(maxsize=1)
def _engine(campaign: Campaign, origin: Origin) -> Engine:
    """Return this process's own, for any number of threads."""
    if differ := campaign.changed({"origin": dict(origin)}):
        here = f"a worker on {socket.gethostname()}"
        raise RigError(f"{campaign.rig}: {here} differs from the campaign in {differ}")
    return Engine(Path(campaign.rig), campaign.controllers, campaign.settings, threads=1)
