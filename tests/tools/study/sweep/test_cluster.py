"""Campaigns on Dask's workers: the same table, and no finished row is lost or done again."""

import dataclasses
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import distributed
import pytest
from copies import end_with_the_tests
from places import PATIENCE_S, ROOT

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import RigError
from pcpc.tools.study.engine import Engine, pieces
from pcpc.tools.study.sweep import cluster, shards
from pcpc.tools.study.sweep.campaign import Campaign, Shard
from pcpc.tools.study.sweep.store import Store
from pcpc.tools.study.sweep.work import Work
from pcpc.tools.terminal.progress import Progress

pytestmark = pytest.mark.deep

RIG = str(ROOT / "tools/make/template/rig.yaml")
SHORT = ("duration_s=0.6", "evaluation.window_s=[0.1, 0.6]", "evaluation.rest_from_s=0.4")
VARY = ("motor.coulomb_Nm=x0.5:2",)
MANY = Campaign(RIG, ("pid", "pd"), VARY, 160, "random", 5, SHORT)
GENERIC = os.environ | {"PCPC_CPU": "generic"}
TASK = 4

Start = Callable[..., "subprocess.Popen[str]"]


def done(folder: Path, scheduler: str | None = None) -> None:
    work = Work(MANY, Shard(), folder, None, None, scheduler)
    try:
        work.to_end(Progress(quiet=True))
    finally:
        work.store.close()


def table(folder: Path) -> list[dict[str, object]]:
    return [
        {name: repr(value) for name, value in row.items()}
        for row in shards.merge([folder])[0].to_pylist()
    ]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    done(folder)
    return folder


@pytest.fixture
def start() -> Iterator[Start]:
    """Start processes of Python; those that are left at the end are killed."""
    started = []

    def starting(*words: str, pipe: bool = False) -> "subprocess.Popen[str]":
        where = subprocess.PIPE if pipe else subprocess.DEVNULL
        started.append(
            subprocess.Popen(
                [sys.executable, *words],
                env=GENERIC,
                stdout=subprocess.DEVNULL,
                stderr=where,
                text=True,
                start_new_session=True,
                preexec_fn=end_with_the_tests,
            )
        )
        return started[-1]

    yield starting
    for process in started:
        process.kill()
        process.wait()
        if process.stderr:
            process.stderr.close()


def scheduler(start: Start) -> tuple["subprocess.Popen[str]", str]:
    words = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard")
    process = start("-m", "distributed.cli.dask_scheduler", *words, pipe=True)
    assert process.stderr
    for line in process.stderr:
        if found := re.search(r"Scheduler at:\s*(tcp://\S+)", line):
            return process, found[1]
    raise AssertionError("the scheduler ended")


def worker(start: Start, address: str) -> "subprocess.Popen[str]":
    words = (address, "--nthreads", "1", "--no-nanny", "--no-dashboard")
    return start("-m", "distributed.cli.dask_worker", *words)


def client(start: Start, address: str, folder: Path) -> "subprocess.Popen[str]":
    words = ["--controllers", "pid,pd", "--sampling", "random", "--seed", "5", "--draws", "160"]
    words += ["--scheduler", address, "--quiet", "-o", str(folder), "--vary", *VARY]
    words += [word for one in SHORT for word in ("--set", one)]
    code = (
        "from pcpc.tools import cli\n"
        "from pcpc.tools.study.sweep import cluster\n"
        f"cluster.TASK = {TASK}\n"
        "raise SystemExit(cli.main())"
    )
    return start("-c", code, "sweep", RIG, *words, pipe=True)


def written(folder: Path) -> int:
    """Return how many rows a process has kept so far, which has their file to itself."""
    with tempfile.TemporaryDirectory() as copy:
        with suppress(FileNotFoundError):
            for path in folder.glob("*.sqlite*"):
                shutil.copy(path, copy)
        try:
            with closing(sqlite3.connect(f"{copy}/shard-1-of-1.sqlite")) as db:
                return int(db.execute("SELECT count(*) FROM run").fetchone()[0])
        except sqlite3.OperationalError:  # it has not begun
            return 0


def wait_for(rows: int, folder: Path, process: "subprocess.Popen[str]") -> None:
    """Wait until this many rows are on disk; `process` has to go on meanwhile."""
    for _ in range(int(PATIENCE_S / 0.02)):
        try:
            process.wait(0.02)
        except subprocess.TimeoutExpired:
            if written(folder) >= rows:
                return
            continue
        raise AssertionError(f"it ended: {process.stderr.read() if process.stderr else ''}")
    raise AssertionError(f"{written(folder)} rows of {rows}")


def test_workers_make_the_table_that_threads_make(whole: Path, tmp_path: Path) -> None:
    done(tmp_path, "local:2")
    assert table(tmp_path) == table(whole)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "shard-1-of-1.sqlite",
        "sweep.json",
        "sweep.parquet",
    ]


def test_a_killed_worker_client_and_scheduler_lose_no_finished_row(
    whole: Path, tmp_path: Path, start: Start
) -> None:
    dask, address = scheduler(start)
    first = worker(start, address)
    sweep = client(start, address, tmp_path)
    wait_for(24, tmp_path, sweep)
    first.kill()
    first.wait()
    before = written(tmp_path)

    worker(start, address)
    wait_for(before + 8, tmp_path, sweep)
    sweep.kill()
    sweep.wait()
    before = written(tmp_path)
    rows = Store(tmp_path, MANY.spec(), Shard())
    kept = [dataclasses.replace(row, why="kept") for row in rows.values()]
    rows.close()
    (tmp_path / "shard-1-of-1.sqlite").unlink()
    rows = Store(tmp_path, MANY.spec(), Shard())
    rows.add(kept)
    rows.close()

    sweep = client(start, address, tmp_path)
    wait_for(before + 8, tmp_path, sweep)
    dask.kill()
    _, error = sweep.communicate(timeout=PATIENCE_S)
    assert sweep.returncode == Exit.ENVIRONMENT
    assert error.count("\n") == 1, error
    assert f"the same command goes on with -o {tmp_path}" in error
    assert written(tmp_path) < 320, "it ended before it was killed"

    done(tmp_path)
    marked, plain = table(tmp_path), table(whole)
    assert sum(row["why"] == "'kept'" for row in marked) == len(kept) == before
    without = [{k: v for k, v in row.items() if k != "why"} for row in plain]
    assert [{k: v for k, v in row.items() if k != "why"} for row in marked] == without


def test_a_worker_that_is_lost_leaves_its_tasks_to_the_other(
    whole: Path, tmp_path: Path, start: Start
) -> None:
    _, address = scheduler(start)
    both = [worker(start, address) for _ in range(2)]
    with distributed.Client(address) as waiting:
        waiting.wait_for_workers(2, timeout=PATIENCE_S)
    sweep = client(start, address, tmp_path)
    wait_for(24, tmp_path, sweep)
    both[0].kill()
    _, error = sweep.communicate(timeout=PATIENCE_S)
    assert (sweep.returncode, error) == (Exit.NOT_MET, "")
    assert table(tmp_path) == table(whole)


def test_ctrl_c_ends_a_local_cluster_without_a_traceback(tmp_path: Path, start: Start) -> None:
    sweep = client(start, "local:1", tmp_path)
    wait_for(8, tmp_path, sweep)
    os.killpg(sweep.pid, signal.SIGINT)  # as a terminal sends it: to the workers, too
    _, error = sweep.communicate(timeout=PATIENCE_S)
    assert (sweep.returncode, error) == (Exit.INTERRUPTED, "")
    assert 8 <= written(tmp_path) < 320


def test_a_task_is_what_this_process_would_do_or_is_refused() -> None:
    engine = Engine(Path(RIG), MANY.controllers, SHORT, 1)
    task = list(pieces([(i, [0.01 * i + 0.1]) for i in range(12)], MANY.controllers, MANY.draw))
    origin = tuple(MANY.spec()["origin"].items())
    rows = [row for piece in task for row in engine.piece(*piece)]
    assert cluster.run_task(MANY, origin, task) == rows and len(rows) == 24
    other = tuple({**dict(origin), "motor.dbc": "another"}.items())
    with pytest.raises(RigError, match=r"a worker on .* differs from the campaign in motor\.dbc"):
        cluster.run_task(MANY, other, task)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "there", "tcp://no_such_host:8786"])
def test_a_scheduler_that_does_not_answer_is_told(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "ANSWER_S", 0.2)
    with pytest.raises(UserError, match=f"{address}: no answer; start") as error:
        done(tmp_path, address)
    assert error.value.code == Exit.ENVIRONMENT
    assert not distributed.Client._instances, "one is left to close itself at any time"


def test_without_the_package_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UserError, match=r"needs distributed: .* -m pip install 'distributed>="):
        done(tmp_path, "local")
