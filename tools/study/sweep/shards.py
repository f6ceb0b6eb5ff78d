"""The tables of a campaign's shards as one: of one campaign, each run once, and none missing.

In a folder without a shard, `sweep.parquet` is the whole table, as a merge has made it.
"""

import bisect
import itertools
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pcpc.drivers.errors import printable
from pcpc.executive.errors import RigError
from pcpc.executive.rig.carried_files import is_ordinary
from pcpc.tools.study.engine import FAULT, RAN, REFUSED
from pcpc.tools.study.sweep.campaign import SEARCHES, differences, read
from pcpc.tools.study.sweep.results import COLUMNS, VARY, kind_of
from pcpc.tools.study.sweep.store import SEAL, SPEC, complete_table, digest_of

if TYPE_CHECKING:
    import pyarrow

Run = tuple[int, str]  # draw and controller
_KINDS = [name for name in COLUMNS if name.endswith(":")]
WHOLE = "sweep.parquet"
_NAME = re.compile(r"shard-(\d+)-of-(\d+)\.parquet")


def table_files(folder: Path) -> Iterator[Path]:
    """Yield the Parquet files of a campaign's shards."""
    yield from sorted(path for path in folder.glob("shard-*.parquet") if _NAME.match(path.name))


def _files(folder: Path) -> list[Path]:
    merged = (path for path in (folder / WHOLE,) if path.exists())
    return [*table_files(folder)] or [*merged]


def merge(folders: Sequence[Path], whole: bool = True) -> tuple["pyarrow.Table", dict[str, Any]]:
    """Return all shards of a campaign, from one folder or several, by draw and controller.

    RigError for shards that do not belong together, and if `whole` for a run that is missing.
    """
    import pyarrow as pa

    spec = _spec(folders)
    files = [path for folder in dict.fromkeys(folders) for path in _files(folder)]
    if not files:
        raise RigError(f"{folders[0]}: no shard is complete; start its `pcpc sweep` again to go on")
    parts = [_part(path, spec) for path in files]
    try:
        table = complete_table(pa.concat_tables(parts, promote_options="default"), spec)
    except pa.ArrowException as error:
        raise RigError(f"{files[0].parent}: {' '.join(str(error).split())}") from None
    first = _first_rows(table, files, [part.num_rows for part in parts])
    if whole:
        _check_whole(first, spec, files)
    order = {name: i for i, name in enumerate(spec["controllers"])}
    runs = sorted(first, key=lambda run: (run[0], order[run[1]]))
    return table.take(pa.array([first[run] for run in runs], pa.int64())), spec


def shard_table(path: Path) -> "pyarrow.Table":
    """Return the table of a shard in the folder of its campaign; RigError as `merge`."""
    return _part(path, read(path.with_name(SPEC)))


def _spec(folders: Sequence[Path]) -> dict[str, Any]:
    """Return the spec that all folders have; RigError."""
    first, *others = folders
    spec = read(first / SPEC)
    for folder in others:
        if differ := differences(read(folder / SPEC), spec):
            what = f"another campaign than that of {first}; it differs in {differ}"
            raise RigError(f"{folder}: {what}; merge one at a time")
    return spec


def _part(path: Path, spec: Mapping[str, Any]) -> "pyarrow.Table":
    """Return the table of a shard; RigError for one of another campaign, of other runs, changed."""
    import pyarrow as pa
    import pyarrow.parquet

    try:
        if not is_ordinary(path):
            raise ValueError("it is not a readable file")
        table = pyarrow.parquet.read_table(path, partitioning=None)
        about = dict(json.loads((table.schema.metadata or {}).get(b"pcpc", b"{}")))
        _check_columns(table.schema, spec)
    except (OSError, ValueError, TypeError, pa.ArrowException) as error:
        what = printable(" ".join(str(error).split()))
        raise RigError(f"{path}: no table of a shard: {what}") from None
    if differ := differences(about, spec):
        what = "belongs to another campaign than its folder; it differs in"
        raise RigError(f"{path}: {what} {differ}")
    named = _NAME.match(path.name)
    number, of = map(int, named.groups()) if named else (1, 1)
    last = spec["draws"] if spec["sampling"] not in SEARCHES else 2**63
    draws = table["draw"].to_pylist()
    known = {"controller": spec["controllers"], "outcome": (RAN, FAULT, REFUSED)}
    if (
        not 0 < number <= of
        or not all(draw is not None and 0 <= draw < last for draw in draws)
        or any(draw % of != number - 1 for draw in draws)
        or not all(set(table[name].to_pylist()) <= set(values) for name, values in known.items())
    ):
        raise RigError(f"{path}: holds rows that are not of shard {number} of {of}; do it again")
    digest = table.schema.metadata.get(SEAL.encode(), b"").decode("latin-1")
    if digest != digest_of(table):
        what = "its rows are not those that were written" if digest else "it has no digest"
        raise RigError(f"{path}: {what}; remove it and do it again")
    return table


def _check_columns(schema: "pyarrow.Schema", spec: Mapping[str, Any]) -> None:
    """Raise ValueError for columns that no shard of the campaign has, or that are missing."""
    varied = {text.partition("=")[0] for text in spec["vary"]}
    for i, (name, type_) in enumerate(zip(schema.names, schema.types, strict=True)):
        if type_ != COLUMNS.get(kind_of(name)) or name in (*_KINDS, *schema.names[:i]):
            raise ValueError(f"column {name} of {type_}")
        if name.startswith(VARY) and name.removeprefix(VARY) not in varied:
            raise ValueError(f"column {name}, which does not vary")
    if missing := [name for name in COLUMNS if name not in (*_KINDS, *schema.names)]:
        raise ValueError(f"no column {', '.join(missing)}")


def _first_rows(
    table: "pyarrow.Table", files: Sequence[Path], sizes: Sequence[int]
) -> dict[Run, int]:
    """Return where each run of several files in one table stands, the first time.

    RigError where one stands twice and differs.
    """
    found: dict[Run, int] = {}
    columns = (table[name].to_pylist() for name in ("draw", "controller"))
    runs: list[Run] = list(zip(*columns, strict=True))
    ends = list(itertools.accumulate(sizes))
    for row, run in enumerate(runs):
        first = found.setdefault(run, row)
        if first == row:
            continue
        one, other = map(repr, table.take([first, row]).to_pylist())
        if one != other:
            places = " and ".join(str(files[bisect.bisect_right(ends, i)]) for i in (first, row))
            what = f"draw {run[0]} of {run[1]} had another result the second time"
            raise RigError(f"{places}: {what}; one of the two is wrong")
    return found


def _check_whole(runs: Mapping[Run, int], spec: Mapping[str, Any], files: Sequence[Path]) -> None:
    """Raise RigError where a campaign lacks runs that it should have."""
    if spec["sampling"] in SEARCHES:  # what it asks for follows from its rows
        return
    names, last = spec["controllers"], max((draw for draw, _ in runs), default=-1)
    asked = last + 1 if "until" in spec else spec["draws"]
    lacking = [i for i in range(asked) if any((i, name) not in runs for name in names)]
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
