"""The rows of a campaign on disk: a journal while it runs, one Parquet file a shard at its end.

    sweep.json               what the campaign is; another one is refused in the same folder
    shard-1-of-4.jsonl       a row a line, written before anybody is told that it is done
    shard-1-of-4.0.64.jsonl  the same of a worker's task, until its rows are in the journal
    shard-1-of-4.parquet     the same rows in the order of draws and controllers; takes its place

A process that is killed loses no finished row: a line that is not whole is dropped, and the draws
that are there are not done again. A row stays on disk and is read when it is asked for: what a
process holds of it is its place in the file. Each line has a seal, and so has a table: a line that
was changed is dropped as one that is not whole, with all behind it, and a table is refused.
"""

import dataclasses
import fcntl
import hashlib
import itertools
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import RigError, code_of
from pcpc.tools.study.engine import Row
from pcpc.tools.study.sweep.campaign import Shard, differences, read
from pcpc.tools.study.sweep.results import COLUMNS, HELD, MARGIN, METRIC, VARY, kind_of
from pcpc.tools.terminal.outfile import new_file, write_text

if TYPE_CHECKING:
    import pyarrow

SPEC = "sweep.json"
SEAL = "seal"  # of a line of a journal, and of a table
OUTCOME = b"outcome"  # of a search, beside the spec in its table
CHUNK = 4096  # rows of a table that are in memory at once, about 5 kB each


class Rows(Mapping[tuple[int, str], Row]):
    """The rows in an open file, a line each, by draw and controller."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._places: dict[str, dict[int, int]] = {}  # of each controller's draws

    def note_place(self, row: Row, place: int) -> None:
        """Take note where a row's line begins."""
        self._places.setdefault(row.controller, {})[row.draw] = place

    def __getitem__(self, of: tuple[int, str]) -> Row:
        draw, controller = of
        self._file.seek(self._places[controller][draw])
        return row_of(self._file.readline())

    def __contains__(self, of: object) -> bool:
        draw, controller = cast(tuple[int, str], of)
        return draw in self._places.get(controller, ())

    def __iter__(self) -> Iterator[tuple[int, str]]:
        return ((draw, name) for name, places in self._places.items() for draw in places)

    def __len__(self) -> int:
        return sum(map(len, self._places.values()))


class Journal:
    """Rows in a file, a row a line; one process at a time has it. `rows`: until it is closed."""

    def __init__(self, path: Path, wait: bool = False) -> None:
        """Open it and take its rows; OSError. BlockingIOError, or `wait`: another one has it."""
        self.path = path
        self._file: IO[bytes] = path.open("a+b")
        self.rows = Rows(self._file)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            self._file.close()
            raise
        self._read()

    def _read(self) -> None:
        """Take the whole lines; cut off what a killed process, or somebody else, left of others."""
        self._file.seek(0)
        whole = 0
        for line in iter(self._file.readline, b""):
            try:
                row = row_of(line) if line.endswith(b"\n") else None
            except (ValueError, TypeError, KeyError):
                row = None
            if row is None:
                break
            self.rows.note_place(row, whole)
            whole += len(line)
        self._file.seek(whole)
        self._file.truncate()

    def add(self, rows: Iterable[Row]) -> None:
        """Write rows; OSError."""
        place = self._file.seek(0, os.SEEK_END)
        for row in rows:
            line = _line_of(row)
            self._file.write(line.encode())
            self.rows.note_place(row, place)
            place += len(line)
        self._file.flush()

    def close(self, drop: bool = False) -> None:
        """Let it go, and the file with it if it is to be dropped."""
        if drop:
            self.path.unlink(missing_ok=True)
        self._file.close()


class Store:
    """The folder of a campaign, and one shard in it; one process at a time has a shard."""

    _is_new = False  # its spec was written here

    def __init__(self, folder: Path, spec: Mapping[str, Any], shard: Shard) -> None:
        """Make or continue it. RigError: it is another campaign's, or somebody works on it."""
        self.folder, self.spec, self.shard = folder, dict(spec), shard
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._is_new = claim_spec(folder, self.spec)
            self._journal = Journal(folder / f"{shard}.jsonl")
            self.journal, self.rows = self._journal.path, self._journal.rows
            self.add = self._journal.add
            self._take_tasks()
        except BlockingIOError:
            what = f"{folder / str(shard)}.jsonl: another process works on this shard; wait for it"
            raise RigError(what) from None
        except OSError as error:
            self._drop_spec()
            what = f"{folder}: {error.strerror or error}; choose another folder with -o"
            raise UserError(what, code_of(error)) from None

    @property
    def table(self) -> Path:
        """The Parquet file."""
        return self.folder / f"{self.shard}.parquet"

    def task_journal(self, draw: int, controller: str) -> Path:
        """Return the journal of a worker's task that begins with this run."""
        which = list(self.spec["controllers"]).index(controller)
        return self.folder / f"{self.shard}.{which}.{draw}.jsonl"

    def _take_tasks(self) -> None:
        """Take the rows of tasks whose client was killed; one that goes on keeps its journal."""
        for path in self.folder.glob(f"{self.shard}.*.*.jsonl"):
            try:
                task = Journal(path)
            except BlockingIOError:
                continue
            self._journal.add(task.rows[of] for of in task.rows if of not in self.rows)
            task.close(drop=True)

    def complete(self, outcome: str = "") -> Path:
        """Write the Parquet file, drop the journal, return the file; OSError, LogCommandError."""
        import pyarrow.parquet

        table = table_of(self.rows, self.spec)
        with new_file(self.table, force=True) as unfinished:
            pyarrow.parquet.write_table(with_seal(table, outcome), unfinished)
        for path in (self.journal, *self.folder.glob(f"{self.shard}.*.*.jsonl")):
            path.unlink(missing_ok=True)
        return self.table

    def close(self) -> None:
        """Let the shard go; a journal without a row goes, too, and a spec of which nothing came."""
        self._journal.close(drop=not self.rows or self.table.exists())
        self._drop_spec()

    def _drop_spec(self) -> None:
        """Remove a new campaign's spec where there is no row of any shard."""
        rows = (path for path in self.folder.glob("shard-*") if path.is_file())
        if self._is_new and not any(rows):
            (self.folder / SPEC).unlink(missing_ok=True)


def claim_spec(folder: Path, spec: Mapping[str, Any]) -> bool:
    """Write a campaign's spec if there is none; return whether; RigError for another campaign's."""
    path = folder / SPEC
    text = json.dumps(spec, indent=1)
    is_new = not path.exists()
    if is_new:
        write_text(path, text + "\n")
    if differ := differences(read(path), json.loads(text)):
        what = f"{folder} holds another campaign; it differs in {differ}"
        raise RigError(f"{what}; choose another folder with -o")
    return is_new


def row_of(line: bytes) -> Row:
    """Return a row of a journal; ValueError, TypeError, KeyError where it is none, or changed."""
    data = json.loads(line)
    if data.pop(SEAL) != _seal_of(data):
        raise ValueError("it is not as it was written")
    row = Row(**data)
    hash((row.draw, row.controller))
    return row


def _line_of(row: Row) -> str:
    data = dataclasses.asdict(row)
    return json.dumps(data | {SEAL: _seal_of(data)}) + "\n"


def _seal_of(data: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(data).encode()).hexdigest()[:16]


def with_seal(table: "pyarrow.Table", outcome: str = "") -> "pyarrow.Table":
    """Return a table with the digest of its rows, and of what came out, beside its spec."""
    about = {**(table.schema.metadata or {}), OUTCOME: outcome.encode()}
    table = table.replace_schema_metadata(about)
    return table.replace_schema_metadata({**about, SEAL.encode(): digest_of(table)})


def outcome_of(table: "pyarrow.Table") -> str:
    """Return what came out of a search, "" of none."""
    return str((table.schema.metadata or {}).get(OUTCOME, b"").decode("utf-8", "replace"))


def digest_of(table: "pyarrow.Table") -> str:
    """Return a digest of all values of a table, by column, in their order, and of its outcome."""
    import pyarrow as pa

    digest = hashlib.sha256(outcome_of(table).encode())
    for name, begin in itertools.product(table.column_names, range(0, table.num_rows, CHUNK)):
        column = table[name].slice(begin, CHUNK)
        digest.update(f"{name} {len(column)}\n".encode())
        if pa.types.is_string(column.type):
            digest.update(json.dumps(column.to_pylist()).encode())
            continue
        digest.update(column.is_null().to_numpy().tobytes())
        digest.update(column.fill_null(False if pa.types.is_boolean(column.type) else 0).to_numpy())
    return digest.hexdigest()


def table_of(rows: Mapping[tuple[int, str], Row], spec: Mapping[str, Any]) -> "pyarrow.Table":
    """Return rows as a table, by draw and controller; `sweep.results` has its columns."""
    import pyarrow as pa

    order = {name: i for i, name in enumerate(spec["controllers"])}
    left = iter(sorted(rows, key=lambda of: (of[0], order[of[1]])))
    parts = [_part([])]
    while some := [rows[of] for of in itertools.islice(left, CHUNK)]:
        parts.append(_part(some))
    table = pa.concat_tables(parts, promote_options="default")
    return complete_table(table, spec)


def complete_table(table: "pyarrow.Table", spec: Mapping[str, Any]) -> "pyarrow.Table":
    """Return a table with its columns in order, NaN where a run told no number, and its spec."""
    import pyarrow.compute

    for i, name in enumerate(table.column_names):
        if kind_of(name) in (METRIC, MARGIN):
            table = table.set_column(i, name, pyarrow.compute.fill_null(table[name], math.nan))
    order = list(COLUMNS)
    names = sorted(table.column_names, key=lambda name: order.index(kind_of(name)))
    return table.select(names).replace_schema_metadata({"pcpc": json.dumps(dict(spec))})


def _part(rows: Sequence[Row]) -> "pyarrow.Table":
    """Return rows as a table with the columns that they have."""
    import pyarrow as pa

    kinds = {VARY: "values", METRIC: "metrics", MARGIN: "margins", HELD: "held"}
    columns = dict[str, Any]()
    for kind, type_ in COLUMNS.items():
        found = [getattr(row, kinds.get(kind, kind)) for row in rows]
        if kind not in kinds:
            columns[kind] = pa.array(found, type_)
            continue
        for name in dict.fromkeys(itertools.chain(*found)):
            columns[kind + name] = pa.array([one.get(name) for one in found], type_)
    return pa.table(columns)
