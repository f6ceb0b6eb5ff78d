"""The rows of a campaign on disk: a journal while it runs, one Parquet file a shard at its end.

    sweep.json               what the campaign is; another one is refused in the same folder
    shard-1-of-4.jsonl       a row a line, written before anybody is told that it is done
    shard-1-of-4.0.64.jsonl  the same of a worker's task, until its rows are in the journal
    shard-1-of-4.parquet     the same rows in the order of draws and controllers; takes its place

A process that is killed loses no finished row: a line that is not whole is dropped, and the draws
that are there are not done again.
"""

import dataclasses
import fcntl
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import RigError, code_of
from pcpc.tools.log.outfile import new_file
from pcpc.tools.sweep.campaign import Shard, read
from pcpc.tools.sweep.engine import Row

if TYPE_CHECKING:
    import pyarrow

SPEC = "sweep.json"
_PACKAGES = ("scipy", "pyarrow", "matplotlib", "cma")


class Journal:
    """Rows in a file, a row a line; one process at a time has it."""

    def __init__(self, path: Path, wait: bool = False) -> None:
        """Open it and take its rows; OSError. BlockingIOError, or `wait`: another one has it."""
        self.path = path
        self.rows: dict[tuple[int, str], Row] = {}
        self._file: IO[str] = path.open("a+", encoding="utf-8")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            self._file.close()
            raise
        self._read()

    def _read(self) -> None:
        """Take the whole lines; cut off what a killed process left of another."""
        self._file.seek(0)
        whole = 0
        for line in iter(self._file.readline, ""):
            try:
                row = row_of(json.loads(line)) if line.endswith("\n") else None
            except (ValueError, TypeError, KeyError):
                row = None
            if row is None:
                break
            self.rows[row.draw, row.controller] = row
            whole = self._file.tell()
        self._file.seek(whole)
        self._file.truncate()

    def add(self, rows: Iterable[Row]) -> None:
        """Write rows; OSError."""
        for row in rows:
            self._file.write(json.dumps(dataclasses.asdict(row)) + "\n")
            self.rows[row.draw, row.controller] = row
        self._file.flush()

    def close(self, drop: bool = False) -> None:
        """Let it go, and the file with it if it is to be dropped."""
        if drop:
            self.path.unlink(missing_ok=True)
        self._file.close()


def check_packages() -> None:
    """Raise UserError if what a campaign needs is not installed, before a run is done in vain."""
    missing = [name for name in _PACKAGES if find_spec(name) is None]
    if missing:
        what = f"no {' and no '.join(missing)}; `pip install 'pcpc[sweep]'` brings what is needed"
        raise UserError(what, Exit.ENVIRONMENT)


class Store:
    """The folder of a campaign, and one shard in it; one process at a time has a shard."""

    def __init__(self, folder: Path, spec: Mapping[str, Any], shard: Shard) -> None:
        """Make or continue it. RigError: it is another campaign's, or somebody works on it."""
        self.folder, self.spec, self.shard = folder, dict(spec), shard
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._claim_spec()
            self._journal = Journal(folder / f"{shard}.jsonl")
            self._take_tasks()
        except BlockingIOError:
            what = f"{folder / str(shard)}.jsonl: another process works on this shard; wait for it"
            raise RigError(what) from None
        except OSError as error:
            what = f"{folder}: {error.strerror}; choose another folder with -o"
            raise UserError(what, code_of(error)) from None
        self.journal, self.rows, self.add = (
            self._journal.path,
            self._journal.rows,
            self._journal.add,
        )

    @property
    def table(self) -> Path:
        """The Parquet file."""
        return self.folder / f"{self.shard}.parquet"

    def of_task(self, draw: int, controller: str) -> Path:
        """Return the journal of a worker's task that begins with this run."""
        which = list(self.spec["controllers"]).index(controller)
        return self.folder / f"{self.shard}.{which}.{draw}.jsonl"

    def _claim_spec(self) -> None:
        path = self.folder / SPEC
        text = json.dumps(self.spec, indent=1)
        if not path.exists():
            with new_file(path, force=True) as unfinished:
                unfinished.write_text(text + "\n", encoding="utf-8")
        there, wanted = read(path), json.loads(text)
        if there != wanted:
            keys = (key for key in {**there, **wanted} if there.get(key) != wanted.get(key))
            what = f"{self.folder} holds another campaign, whose {', '.join(keys)} differ"
            raise RigError(f"{what}; choose another folder with -o")

    def _take_tasks(self) -> None:
        """Take the rows of tasks whose client was killed; one that goes on keeps its journal."""
        for path in self.folder.glob(f"{self.shard}.*.*.jsonl"):
            try:
                task = Journal(path)
            except BlockingIOError:
                continue
            self._journal.add(row for of, row in task.rows.items() if of not in self._journal.rows)
            task.close(drop=True)

    def has(self, draw: int, controllers: Sequence[str]) -> bool:
        """Return whether all rows of a draw are there."""
        return all((draw, name) in self.rows for name in controllers)

    def complete(self) -> Path:
        """Write the Parquet file, drop the journal, return the file; OSError, LogCommandError."""
        import pyarrow.parquet

        table = arrow(self.rows.values(), self.spec)
        with new_file(self.table, force=True) as unfinished:
            pyarrow.parquet.write_table(table, unfinished)
        for path in (self.journal, *self.folder.glob(f"{self.shard}.*.*.jsonl")):
            path.unlink(missing_ok=True)
        return self.table

    def close(self) -> None:
        """Let the shard go; a journal without a row goes, too."""
        self._journal.close(drop=not self.rows or self.table.exists())


def row_of(data: Mapping[str, Any]) -> Row:
    """Return a row as a journal has it; TypeError, KeyError."""
    row = Row(**data)
    hash((row.draw, row.controller))
    return row


def arrow(rows: Iterable[Row], spec: Mapping[str, Any]) -> "pyarrow.Table":
    """Return rows as a table; see `tools.sweep.report` for its columns."""
    import pyarrow as pa

    order = {name: i for i, name in enumerate(spec["controllers"])}
    done = sorted(rows, key=lambda row: (row.draw, order[row.controller]))
    columns: dict[str, Any] = {
        "draw": pa.array([row.draw for row in done], pa.int64()),
        "controller": pa.array([row.controller for row in done], pa.string()),
        "seed": pa.array([row.seed for row in done], pa.int64()),
    }
    for kind, of, type_ in (
        ("vary", "values", pa.float64()), ("metric", "metrics", pa.float64()),
        ("margin", "margins", pa.float64()), ("held", "held", pa.bool_()),
    ):  # fmt: skip
        names = dict.fromkeys(name for row in done for name in getattr(row, of))
        for name in names:
            values = [getattr(row, of).get(name) for row in done]
            if kind in ("metric", "margin"):
                values = [math.nan if value is None else value for value in values]
            columns[f"{kind}:{name}"] = pa.array(values, type_)
    columns["ok"] = pa.array([row.ok for row in done], pa.bool_())
    for name in ("why", "outcome", "alone"):
        columns[name] = pa.array([getattr(row, name) for row in done], pa.string())
    return pa.table(columns).replace_schema_metadata({"pcpc": json.dumps(dict(spec))})


def tables(folder: Path) -> Iterator[Path]:
    """Yield the Parquet files of a campaign's shards."""
    yield from sorted(folder.glob("shard-*-of-*.parquet"))


def merged(folders: Sequence[Path]) -> tuple["pyarrow.Table", dict[str, Any]]:
    """Return all shards of a campaign, from one folder or several; RigError for what is missing."""
    import pyarrow as pa
    import pyarrow.parquet

    specs = [(folder, read(folder / SPEC)) for folder in folders]
    first, spec = specs[0]
    for folder, other in specs[1:]:
        if other != spec:
            raise RigError(f"{folder}: another campaign than that of {first}; merge one at a time")
    files = [path for folder in folders for path in tables(folder)]
    if not files:
        raise RigError(f"{first}: no shard is complete; start its `pcpc sweep` again to go on")
    try:
        parts = [pyarrow.parquet.read_table(path) for path in files]
        table = pa.concat_tables(parts, promote_options="default")
    except (OSError, pa.ArrowException) as error:
        raise RigError(f"{files[0].parent}: {' '.join(str(error).split())}") from None
    order = {name: i for i, name in enumerate(spec["controllers"])}
    seen: dict[tuple[int, str], int] = {}
    pairs = zip(table["draw"].to_pylist(), table["controller"].to_pylist(), strict=True)
    for row, pair in enumerate(pairs):
        seen.setdefault(pair, row)
    rows = [seen[pair] for pair in sorted(seen, key=lambda pair: (pair[0], order[pair[1]]))]
    return table.take(rows).replace_schema_metadata({"pcpc": json.dumps(spec)}), spec
