"""The shards of a campaign as one: of one campaign, each run once, and none missing."""

import re
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pcpc.executive.errors import RigError
from pcpc.executive.own_laws.carried_files import is_ordinary
from pcpc.tools.study.sweep import store
from pcpc.tools.study.sweep.campaign import SEARCHES, Shard, differences, read
from pcpc.tools.terminal.outfile import new_file

if TYPE_CHECKING:
    import pyarrow

_NAME = re.compile(r"shard-(\d+)-of-(\d+)\.sqlite")


@contextmanager
def merged(
    folders: Sequence[Path], whole: bool = True
) -> Iterator[tuple[sqlite3.Connection, dict[str, Any]]]:
    """Give all shards of a campaign, from one folder or several, in one database, and its spec.

    RigError for shards that do not belong together, and if `whole` for a run that is missing.
    """
    spec = _spec(folders)
    found = (path for one in folders for path in sorted(one.glob("shard-*.sqlite")))
    files = [path for path in dict.fromkeys(found) if _NAME.fullmatch(path.name)]
    with closing(sqlite3.connect("", isolation_level=None, uri=True)) as db:
        store.make_tables(db, spec, Shard())
        taken = list[Path]()
        for path in files:
            with store.refusals(path):
                taken += [path] * _take(db, path, spec, taken)
        if not taken:
            cure = "start its `pcpc sweep` again to go on"
            raise RigError(f"{folders[0]}: no shard is complete; {cure}")
        if whole:
            _check_whole(db, spec, taken)
        yield db, spec


def merge(folders: Sequence[Path], whole: bool = True) -> tuple["pyarrow.Table", dict[str, Any]]:
    """Return what `merged` gives as a table, by draw and controller, and the spec; RigError."""
    with merged(folders, whole) as (db, spec):
        return table(db, spec), spec


def table(db: sqlite3.Connection, spec: Mapping[str, Any]) -> "pyarrow.Table":
    """Return what `merged` gives as a table; RigError for what is no row of the campaign."""
    with store.refusals(Path(store.SPEC)):
        return store.table_of(db, spec)


def write(db: sqlite3.Connection, spec: Mapping[str, Any], folder: Path) -> None:
    """Write what `merged` gives into a folder as its one shard; RigError, LogCommandError."""
    store.claim_spec(folder, spec)
    store.complete(db, store.sum_of(db.execute("SELECT * FROM main.run")))
    path = folder / f"{Shard()}.sqlite"
    with new_file(path, force=True) as unfinished, store.refusals(path):
        db.execute("VACUUM main INTO ?", (unfinished.resolve().as_uri(),))


def _spec(folders: Sequence[Path]) -> dict[str, Any]:
    """Return the spec that all folders have; RigError."""
    first, *others = folders
    spec = read(first / store.SPEC)
    for folder in others:
        if differ := differences(read(folder / store.SPEC), spec):
            what = f"another campaign than that of {first}; it differs in {differ}"
            raise RigError(f"{folder}: {what}; merge one at a time")
    for folder in folders:
        store.check_version(folder)
    return spec


def _take(
    db: sqlite3.Connection, path: Path, spec: Mapping[str, Any], taken: Sequence[Path]
) -> bool:
    """Take the rows of a shard that is complete; return whether it is."""
    if not is_ordinary(path):
        raise ValueError("it is not a readable file")
    if path.with_name(f"{path.name}-wal").exists():  # somebody writes it, or was killed
        return False
    db.execute("ATTACH ? AS other", (f"{path.resolve().as_uri()}?mode=ro",))
    about, _ = store.checked(db, "other", path, spec)
    if is_complete := "outcome" in about:
        both = "main.run AS a JOIN other.run AS b USING (draw, controller)"
        unequal = f"SELECT draw, controller FROM {both} WHERE a.row != b.row"
        for run in db.execute(unequal):
            places = f"{_holder(taken, run)} and {path}"
            what = f"draw {run[0]} of {run[1]} had another result the second time"
            raise RigError(f"{places}: {what}; one of the two is wrong")
        db.execute("INSERT OR IGNORE INTO main.run SELECT * FROM other.run")
    db.execute("DETACH other")
    return is_complete


def _holder(files: Sequence[Path], run: store.Run) -> Path:
    """Return the first file that has a run."""
    for path in files:
        with closing(sqlite3.connect(path)) as db:
            where = "WHERE draw = ? AND controller = ?"
            if db.execute(f"SELECT 1 FROM run {where}", run).fetchone():
                return path
    raise AssertionError("it was taken from one of them")


def _check_whole(db: sqlite3.Connection, spec: Mapping[str, Any], files: Sequence[Path]) -> None:
    """Raise RigError where a campaign lacks runs that it should have."""
    if spec["sampling"] in SEARCHES:  # what it asks for follows from its rows
        return
    counts = dict[int, int](db.execute("SELECT draw, count(*) FROM main.run GROUP BY draw"))
    asked = max(counts, default=-1) + 1 if "until" in spec else spec["draws"]
    lacking = [i for i in range(asked) if counts.get(i) != len(spec["controllers"])]
    if not lacking:
        return
    parts = {int(found[2]) for path in files if (found := _NAME.match(path.name))}
    which = ""
    if len(parts) == 1 and (of := parts.pop()) > 1:
        numbers = sorted({i % of + 1 for i in lacking})
        some = ", ".join(map(str, numbers[:8])) + (", ..." if numbers[8:] else "")
        which = f", those of shard{'s' * (len(numbers) > 1)} {some} of {of}"
    missing = f"{len(lacking):,} of {asked:,} draws are missing{which}"
    cure = "do them by the command of the campaign with --shard, then merge all"
    raise RigError(f"{files[0].parent}: {missing}; {cure}")
