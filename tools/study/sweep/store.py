"""The rows of a campaign on disk: a SQLite file a shard, and a Parquet table for other programs.

    sweep.json           what the campaign is; another one is refused in the same folder
    shard-1-of-4.sqlite  run: a row by draw and controller; about: spec, shard, outcome, digest
    sweep.parquet        all rows, written at the end and never read here

A process that is killed loses no row that was added, and the draws that are there are not done
again. The process that adds rows has the file to itself: its write-ahead log then needs no memory
that processes share, so that the file may be on a network disk. The digest is of all rows and of
what they were made from. Each transaction moves it on, and whoever reads checks it.
"""

import hashlib
import json
import math
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import msgspec

from pcpc.drivers.errors import Exit, UserError, printable
from pcpc.executive.errors import RigError, code_of
from pcpc.executive.own_laws.carried_files import is_ordinary
from pcpc.tools.study.engine import RunVerdict
from pcpc.tools.study.sweep.campaign import Shard, differences, read
from pcpc.tools.study.sweep.results import COLUMNS, HELD, LEFT, MARGIN, METRIC, VARY, kind_of
from pcpc.tools.terminal.outfile import new_file, write_text

if TYPE_CHECKING:
    import pyarrow

Run = tuple[int, str]  # draw and controller
SPEC, EXPORT = "sweep.json", "sweep.parquet"
CHUNK = 4096  # rows of a table that are in memory at once, about 5 kB each
_TABLES = (
    "CREATE TABLE about(key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID",
    "CREATE TABLE run(draw INTEGER, controller TEXT, row TEXT NOT NULL, "
    "PRIMARY KEY(draw, controller)) WITHOUT ROWID",
)
_DIGESTS = 1 << 256
_AGAIN = "remove it and do it again"
_ELSEWHERE = "choose another folder with -o"
_FULL = "free space there, or choose another place"
_REFUSED = {  # what is told of errors that are no damage, and the exit code
    sqlite3.SQLITE_FULL: (_FULL, Exit.LOSS),
    sqlite3.SQLITE_IOERR: (_FULL, Exit.LOSS),
    sqlite3.SQLITE_CANTOPEN: (_ELSEWHERE, Exit.ENVIRONMENT),
    sqlite3.SQLITE_READONLY: (_ELSEWHERE, Exit.ENVIRONMENT),
    sqlite3.SQLITE_PERM: (_ELSEWHERE, Exit.ENVIRONMENT),
}


class Store(Mapping[Run, RunVerdict]):
    """One shard in the folder of a campaign, its rows by draw and controller."""

    _is_new = False  # its spec was written here

    def __init__(self, folder: Path, spec: Mapping[str, Any], shard: Shard) -> None:
        """Make or continue it. RigError: it is another campaign's, or somebody works on it."""
        self.folder, self.spec, self.shard = folder, dict(spec), shard
        self.path = folder / f"{shard}.sqlite"
        try:
            with refusals(self.path):
                folder.mkdir(parents=True, exist_ok=True)
                self._is_new = claim_spec(folder, self.spec)
                if self.path.exists() and not is_ordinary(self.path):
                    raise OSError("it is not a readable file")
                self._db = sqlite3.connect(self.path, timeout=0.0, isolation_level=None)
        except UserError:
            self._drop_spec()
            raise
        try:
            with refusals(self.path):
                self._take()
        except UserError:
            self._let_go()
            raise

    def _take(self) -> None:
        """Lock the file, and take note of what is in it."""
        db = self._db
        for pragma in ("locking_mode = EXCLUSIVE", "journal_mode = WAL", "synchronous = NORMAL"):
            db.execute(f"PRAGMA {pragma}")
        if not db.execute("SELECT 1 FROM sqlite_master").fetchone():
            make_tables(db, self.spec, self.shard)
        about, self._sum = checked(db, "main", self.path, self.spec)
        self.outcome = about.get("outcome")  # None: it is not complete
        self._count: int = db.execute("SELECT count(*) FROM run").fetchone()[0]
        self._had = self._count

    def __getitem__(self, of: Run) -> RunVerdict:
        if (text := self._text(of)) is None:
            raise KeyError(of)
        return _row(*of, text)

    def _text(self, of: Run) -> str | None:
        where = "WHERE draw = ? AND controller = ?"
        found = self._db.execute(f"SELECT row FROM run {where}", of).fetchone()
        return found and str(found[0])

    def __iter__(self) -> Iterator[Run]:
        return self._db.execute("SELECT draw, controller FROM run")

    def __len__(self) -> int:
        return self._count

    def add(self, rows: Iterable[RunVerdict]) -> None:
        """Keep rows, all or none of them; UserError, also where one is there and differs."""
        lines = []
        for row in rows:
            of, text = (row.draw, row.controller), _text(row)
            if (there := self._text(of)) is None:
                lines.append((*of, text))
            elif there != text:
                what = f"{self.path}: draw {of[0]} of {of[1]} had another result the second time"
                raise RigError(f"{what}; begin again with another -o")
        total = self._sum + sum_of(lines)
        with refusals(self.path), self._db as db:
            db.execute("BEGIN")
            db.executemany("INSERT INTO run VALUES (?, ?, ?)", lines)
            write_digest(db, total)
        self._sum, self._count = total, self._count + len(lines)

    def complete(self, outcome: str = "") -> None:
        """Note that all rows are there, and what came out of them; UserError."""
        with refusals(self.path):
            complete(self._db, self._sum, outcome)
        self.outcome = outcome

    def table(self) -> "pyarrow.Table":
        """Return the rows as a table."""
        return table_of(self._db, self.spec)

    def take_back(self) -> None:
        """Let `close` remove the rows that were added, where there was none before."""
        if not self._had:
            self._count, self.outcome = 0, None
            (self.folder / EXPORT).unlink(missing_ok=True)

    def close(self) -> None:
        """Let the shard go; a file without a row goes, too, and a spec of which nothing came."""
        if not self and self.outcome is None:
            self.path.unlink(missing_ok=True)
        self._let_go()

    def _let_go(self) -> None:
        with suppress(sqlite3.Error):  # a full disk: the log stays beside the file
            self._db.execute("PRAGMA journal_mode = DELETE")
        self._db.close()
        self._drop_spec()

    def _drop_spec(self) -> None:
        """Remove a new campaign's spec where there is no row of any shard."""
        if self._is_new and not any(map(Path.is_file, self.folder.glob("shard-*"))):
            (self.folder / SPEC).unlink(missing_ok=True)


def claim_spec(folder: Path, spec: Mapping[str, Any]) -> bool:
    """Write a campaign's spec if there is none; return whether; RigError for another campaign's."""
    path = folder / SPEC
    check_version(folder)
    text = json.dumps(spec, indent=1)
    is_new = not path.exists()
    if is_new:
        write_text(path, text + "\n")
    if differ := differences(read(path), json.loads(text)):
        what = f"{folder} holds another campaign; it differs in {differ}"
        raise RigError(f"{what}; choose another folder with -o")
    return is_new


def check_version(folder: Path) -> None:
    """Raise RigError for a campaign that an older pcpc has written."""
    older = (path for kind in ("parquet", "jsonl") for path in folder.glob(f"shard-*.{kind}"))
    if path := next(older, None):
        cure = "go on with the version that wrote it, or begin again with another -o"
        raise RigError(f"{path}: rows as an older pcpc kept them; {cure}")


@contextmanager
def refusals(path: Path) -> Iterator[None]:
    """Let what the machine refuses, or what is no row, be told in a line; RigError, UserError."""
    try:
        yield
    except OSError as error:
        what = f"{path}: {error.strerror or error}; {_ELSEWHERE}"
        raise UserError(what, code_of(error)) from None
    except (sqlite3.Error, ValueError, TypeError, RecursionError) as error:
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if code in _REFUSED:
            cure, exit_code = _REFUSED[code]
            raise UserError(f"{path}: {error}; {cure}", exit_code) from None
        what = f"no rows of a shard: {printable(' '.join(str(error).split()))}; {_AGAIN}"
        if code in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
            what = "another process works on this shard; wait for it"
        raise RigError(f"{path}: {what}") from None


def make_tables(db: sqlite3.Connection, spec: Mapping[str, Any], shard: Shard) -> None:
    """Write what stands in a file before its first row."""
    with db:
        db.execute("BEGIN")
        for text in _TABLES:
            db.execute(text)
        about = {"spec": json.dumps(dict(spec)), "shard": str(shard), "digest": ""}
        db.executemany("INSERT INTO about VALUES (?, ?)", about.items())
        write_digest(db, 0)


def complete(db: sqlite3.Connection, total: int, outcome: str = "") -> None:
    """Note that all rows are there, and what came out of them."""
    with db:
        db.execute("BEGIN")
        db.execute("INSERT INTO main.about VALUES ('outcome', ?)", (outcome,))
        write_digest(db, total)


def checked(
    db: sqlite3.Connection, name: str, path: Path, spec: Mapping[str, Any]
) -> tuple[dict[str, str], int]:
    """Return what a database says about its rows, and their sum.

    RigError, sqlite3.Error, ValueError for one that is damaged, changed or of another campaign.
    """
    if tuple(text for (text,) in db.execute(f"SELECT sql FROM {name}.sqlite_master")) != _TABLES:
        raise ValueError("it has other tables")
    for (text,) in db.execute(f"PRAGMA {name}.integrity_check(1)"):
        if text != "ok":
            raise ValueError(text)
    about = dict[str, str](db.execute(f"SELECT * FROM {name}.about"))
    total = sum_of(db.execute(f"SELECT * FROM {name}.run"))
    if about.get("digest") != _digest(about, total):
        raise RigError(f"{path}: its rows are not those that were written; {_AGAIN}")
    if about["shard"] != path.stem:
        raise RigError(f"{path}: holds rows that are not of {path.stem} but of {about['shard']}")
    if differ := differences(json.loads(about["spec"]), json.loads(json.dumps(dict(spec)))):
        what = "belongs to another campaign than its folder; it differs in"
        raise RigError(f"{path}: {what} {differ}")
    return about, total


def sum_of(lines: Iterable[tuple[int, str, str]]) -> int:
    """Return the sum of the digests of rows: the same in any order, another of one row twice."""
    return sum(int.from_bytes(_hash(*line)) for line in lines)


def write_digest(db: sqlite3.Connection, total: int) -> None:
    """Write the digest for what the database is about and its rows' sum."""
    digest = _digest(dict(db.execute("SELECT * FROM main.about")), total)
    db.execute("UPDATE main.about SET value = ? WHERE key = 'digest'", (digest,))


def _digest(about: Mapping[str, str], total: int) -> str:
    parts = chain(*sorted((key, value) for key, value in about.items() if key != "digest"))
    return f"{(int.from_bytes(_hash(*parts)) + total) % _DIGESTS:064x}"


def _hash(*parts: object) -> bytes:
    return hashlib.sha256(repr(parts).encode("utf-8", "backslashreplace")).digest()


def _text(row: RunVerdict) -> str:
    left = ("draw", "controller", *["unjudged"] * (not row.unjudged))
    return json.dumps({k: v for k, v in vars(row).items() if k not in left})


def _row(draw: int, controller: str, text: str) -> RunVerdict:
    return msgspec.convert({**json.loads(text), "draw": draw, "controller": controller}, RunVerdict)


def table_of(db: sqlite3.Connection, spec: Mapping[str, Any]) -> "pyarrow.Table":
    """Return rows as a table, by draw and controller; `sweep.results` has its columns.

    NaN stands where a run told no number.
    """
    import pyarrow as pa
    import pyarrow.compute

    db.create_function("place", 1, list(spec["controllers"]).index)
    found = db.execute("SELECT * FROM main.run ORDER BY draw, place(controller)")
    parts = [_part([])]
    while some := found.fetchmany(CHUNK):
        parts.append(_part([_row(*one) for one in some]))
    table = pa.concat_tables(parts, promote_options="default")
    for i, name in enumerate(table.column_names):
        if kind_of(name) in (METRIC, MARGIN):
            table = table.set_column(i, name, pyarrow.compute.fill_null(table[name], math.nan))
    order = list(COLUMNS)
    names = sorted(table.column_names, key=lambda name: order.index(kind_of(name)))
    return table.select(names).replace_schema_metadata({"pcpc": json.dumps(dict(spec))})


def _part(rows: Sequence[RunVerdict]) -> "pyarrow.Table":
    """Return rows as a table with the columns that they have."""
    import pyarrow as pa

    kinds = {VARY: "values", METRIC: "metrics", MARGIN: "margins", HELD: "held", LEFT: "unjudged"}
    columns = dict[str, Any]()
    for kind, type_ in COLUMNS.items():
        found = [getattr(row, kinds.get(kind, kind)) for row in rows]
        if kind not in kinds:
            columns[kind] = pa.array(found, type_)
            continue
        for name in dict.fromkeys(chain(*found)):
            columns[kind + name] = pa.array([one.get(name) for one in found], type_)
    return pa.table(columns)


def export(table: "pyarrow.Table", folder: Path) -> None:
    """Write a table as Parquet into a folder; LogCommandError."""
    import pyarrow.parquet

    with new_file(folder / EXPORT, force=True) as unfinished:
        pyarrow.parquet.write_table(cast(Any, table), unfinished)
