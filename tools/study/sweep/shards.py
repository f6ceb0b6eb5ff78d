"""The tables of a campaign's shards as one: of one campaign, each run once, and none missing."""

import bisect
import itertools
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pcpc.drivers.errors import printable
from pcpc.executive.errors import RigError
from pcpc.executive.rig.carried import is_ordinary
from pcpc.tools.study.sweep.campaign import SEARCHES, differences, read
from pcpc.tools.study.sweep.results import FAULT, HELD, MARGIN, METRIC, RAN, REFUSED, VARY
from pcpc.tools.study.sweep.store import FIRST, LAST, SPEC, completed

if TYPE_CHECKING:
    import pyarrow

Run = tuple[int, str]  # draw and controller
_NAME = re.compile(r"shard-(\d+)-of-(\d+)\.parquet")


def tables(folder: Path) -> Iterator[Path]:
    """Yield the Parquet files of a campaign's shards."""
    yield from sorted(path for path in folder.glob("shard-*.parquet") if _NAME.match(path.name))


def merged(
    folders: Sequence[Path], whole: bool = True
) -> tuple["pyarrow.Table", dict[str, Any]]:  # fmt: skip
    """Return all shards of a campaign, from one folder or several, by draw and controller.

    RigError for shards that do not belong together, and if `whole` for a run that is missing.
    """
    import pyarrow as pa

    spec = _spec(folders)
    files = [path for folder in dict.fromkeys(folders) for path in tables(folder)]
    if not files:
        raise RigError(f"{folders[0]}: no shard is complete; start its `pcpc sweep` again to go on")
    parts = [_part(path, spec) for path in files]
    try:
        table = completed(pa.concat_tables(parts, promote_options="default"), spec)
    except pa.ArrowException as error:
        raise RigError(f"{files[0].parent}: {' '.join(str(error).split())}") from None
    rows = _Rows(table, files, [part.num_rows for part in parts])
    first = rows.first()
    if whole:
        _check_whole(first, spec, files)
    order = {name: i for i, name in enumerate(spec["controllers"])}
    runs = sorted(first, key=lambda run: (run[0], order[run[1]]))
    return table.take(pa.array([first[run] for run in runs], pa.int64())), spec


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
    """Return the table of a shard; RigError for one of another campaign or of other runs."""
    import pyarrow as pa
    import pyarrow.parquet

    try:
        if not is_ordinary(path):
            raise ValueError("it is no file that can be read")
        table = pyarrow.parquet.read_table(path, partitioning=None)
        about = dict(json.loads((table.schema.metadata or {}).get(b"pcpc", b"{}")))
        _check_columns(table.schema, spec)
    except (OSError, ValueError, TypeError, pa.ArrowException) as error:
        what = printable(" ".join(str(error).split()))
        raise RigError(f"{path}: no table of a shard: {what}") from None
    if differ := differences(about, spec):
        raise RigError(f"{path}: of another campaign than its folder; it differs in {differ}")
    number, of = map(int, _NAME.match(path.name).groups())  # type: ignore[union-attr]
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
    return table


def _check_columns(schema: "pyarrow.Schema", spec: Mapping[str, Any]) -> None:
    """Raise ValueError for columns that no shard of the campaign has, or that are missing."""
    import pyarrow as pa

    text, number, truth = pa.string(), pa.float64(), pa.bool_()
    types = dict(zip((*FIRST, *LAST), (pa.int64(), text, pa.int64(), truth, text, text, text),
                     strict=True))  # fmt: skip
    kinds = {VARY: number, METRIC: number, MARGIN: number, HELD: truth}
    for field in schema:
        kind, colon, name = field.name.partition(":")
        if field.type != (types.pop(field.name, None) or kinds.get(kind + colon)):
            raise ValueError(f"column {field.name} of {field.type}")
        if kind + colon == VARY and name not in (one.partition("=")[0] for one in spec["vary"]):
            raise ValueError(f"column {field.name}, which does not vary")
    if types:
        raise ValueError(f"no column {', '.join(types)}")


@dataclass(frozen=True)
class _Rows:
    """The rows of several files in one table."""

    table: "pyarrow.Table"
    files: Sequence[Path]
    sizes: Sequence[int]

    def first(self) -> dict[Run, int]:
        """Return where each run stands; RigError where one stands twice and differs."""
        found: dict[Run, int] = {}
        again: list[tuple[int, int]] = []
        columns = (self.table[name].to_pylist() for name in FIRST[:2])
        for row, run in enumerate(zip(*columns, strict=True)):
            if found.setdefault(run, row) != row:
                again.append((found[run], row))
        for pair in again:
            one, other = map(repr, self.table.take(list(pair)).to_pylist())
            if one != other:
                draw, name = self.table["draw"][pair[0]], self.table["controller"][pair[0]]
                files = " and ".join(str(self._file(row)) for row in pair)
                what = f"draw {draw} of {name} came to something else the second time"
                raise RigError(f"{files}: {what}; one of the two is wrong")
        return found

    def _file(self, row: int) -> Path:
        return self.files[bisect.bisect_right(list(itertools.accumulate(self.sizes)), row)]


def _check_whole(runs: Mapping[Run, int], spec: Mapping[str, Any], files: Sequence[Path]) -> None:
    """Raise RigError where a campaign lacks runs that it should have."""
    if spec["sampling"] in SEARCHES:  # what it asks for follows from its rows
        return
    names, last = spec["controllers"], max((draw for draw, _ in runs), default=-1)
    asked = last + 1 if "until" in spec else spec["draws"]
    lacking = [i for i in range(asked) if any((i, name) not in runs for name in names)]
    if not lacking:
        return
    parts = {int(_NAME.match(path.name)[2]) for path in files}  # type: ignore[index]
    which = ""
    if len(parts) == 1 and (of := parts.pop()) > 1:
        numbers = sorted({i % of + 1 for i in lacking})
        some = ", ".join(map(str, numbers[:8])) + (", ..." if numbers[8:] else "")
        which = f", those of shard{'s' * (len(numbers) > 1)} {some} of {of}"
    missing = f"{len(lacking):,} of {asked:,} draws are missing{which}"
    cure = "do them by the command of the campaign with --shard, then merge all"
    raise RigError(f"{files[0].parent}: {missing}; {cure}")
