"""Logs of any length in bounded memory: what is asked of them lies in tables on the disk.

    row of a table     [cycle, stamp ns, column...]     cells of 8 bytes, a file a node

A log of at most `SHORT_CYCLES` is read whole. Of a longer one the columns that are wanted go to
files without a name beside the log, and are mapped; `LongLog.part` gives a stretch of all nodes.
A column that was not foreseen costs one more pass over the file. `Columns.asked` holds what a
function has asked of a log.

Where a log keeps only a part of the run (`executive.log.snapshot`), the recorder writes tables of
the whole run beside it, `sidecar`, for who judges the run and removes them.
"""

import mmap
import sys
import tempfile
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log import reader as logs
from pcpc.executive.log.reader import Log, NodeLog

SHORT_CYCLES = 120_000  # of a node: with all columns 150 MB
PART_CYCLES = 100_000  # of a long log looked at at once
MOST_ENTRIES = 10_000  # events, and tunings, of a long log
_EDGE_PERIODS = 3  # what belongs to a cycle is stamped at most 2 periods earlier
WITHOUT_CLOCK = ("lockstep", "virtual")

Wanted = Mapping[str, Sequence[str]]  # node -> columns
Vector = NDArray[np.float64]


class Columns(Mapping[str, Vector]):
    """The columns of a node by name, fetched when asked for."""

    def __init__(self, names: Sequence[str], fetch: Callable[[str], Vector]) -> None:
        self._names, self._fetch = dict.fromkeys(names), fetch
        self.asked: dict[str, None] = {}

    def __getitem__(self, name: str) -> Vector:
        if name not in self._names:
            raise KeyError(name)
        self.asked[name] = None
        return self._fetch(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names


def _column_slice(columns: Mapping[str, Vector], begin: int, end: int) -> Columns:
    return Columns(list(columns), lambda name: columns[name][begin:end])


class ColumnFile:
    """Rows of a node in a file: written once, then mapped."""

    def __init__(self, file: BinaryIO, names: Sequence[str]) -> None:
        self.names = {name: 2 + i for i, name in enumerate(dict.fromkeys(names))}
        self._file = file
        self._memory: mmap.mmap | None = None

    def append(self, rows: NDArray[np.int64]) -> None:
        """Append rows that are laid out like the table's. Shape (n, 2 + names)."""
        self._file.write(rows.tobytes())

    def close(self) -> None:
        """End writing."""
        self._file.close()

    def write(self, node: NodeLog) -> None:
        """Append the rows of a piece of the node's run."""
        rows = np.empty((len(node.cycle), 2 + len(self.names)), np.int64)
        rows[:, 0], rows[:, 1] = node.cycle, node.stamp_ns
        for name, place in self.names.items():
            values = node.columns.get(name, node.timing.get(name))
            rows[:, place] = (
                np.float64(np.nan).view(np.int64)
                if values is None
                else (np.ascontiguousarray(values, np.float64).view(np.int64))
            )
        self.append(rows)

    def rows(self) -> NDArray[np.int64]:
        """Return all rows, mapped. Shape (n, 2 + names)."""
        self._file.flush()
        if self._memory is None:
            width = 8 * (2 + len(self.names))
            size = self._file.seek(0, 2) // width * width  # who wrote it may have been killed
            if not size:
                return np.empty((0, 2 + len(self.names)), np.int64)
            self._memory = mmap.mmap(self._file.fileno(), size, access=mmap.ACCESS_READ)
        return np.frombuffer(self._memory, np.int64).reshape(-1, 2 + len(self.names))

    def column(self, name: str) -> Vector:
        """Return a column, mapped. Shape (n,)."""
        values: Vector = self.rows().view(np.float64)[:, self.names[name]]
        return values

    def forget(self) -> None:
        """Give the memory back in which pages of the file lie, unless it is locked."""
        if self._memory is not None:
            with suppress(OSError):
                self._memory.madvise(mmap.MADV_DONTNEED)


@dataclass(frozen=True)
class LongLog(Log):
    """A log whose columns lie in tables; `part_cycles` of it are looked at at once."""

    tables: dict[str, list[ColumnFile]] = field(default_factory=dict)
    part_cycles: int = PART_CYCLES

    def parts(self, leader: str) -> Iterator[tuple[Log, int, int]]:
        """Yield stretches of all nodes, with a cycle of `leader` more at both ends.

        And its own part, as first and past row of `leader` in the stretch.
        """
        count = len(self.node[leader].cycle)
        for begin in range(0, count, self.part_cycles):
            end = min(begin + self.part_cycles, count)
            first, past = max(begin - 1, 0), min(end + 1, count)
            yield self._stretch(leader, first, past), begin - first, end - first
            self.forget()

    def forget(self) -> None:
        """Give the memory back in which pages of the tables lie."""
        for table in chain.from_iterable(self.tables.values()):
            table.forget()

    def _stretch(self, leader: str, first: int, past: int) -> Log:
        lead = self.node[leader]
        ends = (
            (lead.cycle[first], lead.cycle[past - 1]),
            (lead.stamp_ns[first], lead.stamp_ns[past - 1]),
        )
        nodes = {}
        for name, node in self.node.items():
            a, b = (first, past) if name == leader else self._neighbour_rows(name, *ends)
            nodes[name] = replace(
                node,
                cycle=np.array(node.cycle[a:b]),
                stamp_ns=np.array(node.stamp_ns[a:b]),
                columns=_column_slice(node.columns, a, b),
                timing=_column_slice(node.timing, a, b),
            )
        return Log(self.path, nodes, self.attachments, self.metadata, self.missing)

    def _neighbour_rows(
        self, name: str, cycles: tuple[int, int], stamps: tuple[int, int]
    ) -> tuple[int, int]:
        """Return the rows of another node that may belong to cycles of the leader."""
        node, facts = self.node[name], self.metadata.get("executive", {})
        times, ends, edge = node.stamp_ns, stamps, int(float(facts.get("period_ns", 0)))
        if facts.get("pacing") in WITHOUT_CLOCK:
            times, ends, edge = node.cycle, cycles, 1
        before, after = ends[0] - _EDGE_PERIODS * edge, ends[1] + _EDGE_PERIODS * edge
        return bisect_left(times, before), bisect_right(times, after)


def read(
    path: Path,
    wanted: Callable[[Log], Wanted] = lambda log: {},
    *,
    short: int = SHORT_CYCLES,
    part: int = PART_CYCLES,
) -> Log:
    """Return a log of any length, without its frames; LogError.

    `wanted`: the columns that will be asked of a log like this one, which is its beginning.
    """
    pieces = logs.pieces(path, short=short)
    first, is_all = next(pieces)
    if is_all and _longest(first) <= short:
        return first
    needed, known = wanted(first), {name for name, node in first.node.items() if node.columns}
    tables: dict[str, list[ColumnFile]] = {}
    entries: dict[str, tuple[list[Any], list[Any]]] = {}
    notes: list[str] = []
    piece, most = first, sys.maxsize
    del first  # has all columns
    while True:
        notes += piece.missing
        for name, node in piece.node.items():
            kept_entries = entries.setdefault(name, ([], []))
            for kept, more in zip(kept_entries, (node.events, node.tunings), strict=True):
                kept += more[: max(most - len(kept), 0)]
            if name not in tables and len(node.cycle):  # of one that comes later nothing was asked
                every = (*node.columns, *node.timing)
                tables[name] = [_table(path, needed.get(name, ()) if name in known else every)]
            if name in tables:
                tables[name][0].write(node)
        if is_all:
            break
        (piece, is_all), most = next(pieces), MOST_ENTRIES
    return _mapped_log(piece, tables, entries, notes, short, part)


def _longest(log: Log) -> int:
    """Return the cycles of the node that has most of them."""
    return max(len(node.cycle) for node in log.node.values())


def sidecar(log: Path, node: str) -> Path:
    """Return the file beside a log in which the recorder leaves a node's table."""
    return log.with_name(f".{log.name}.{node}.judged")


def whole_run(log: Log, wanted: Wanted, short: int = SHORT_CYCLES, part: int = PART_CYCLES) -> Log:
    """Return the whole run of a log that keeps a part, from the tables of `wanted` beside it."""
    nodes, tables = {}, {}
    for name, node in log.node.items():
        try:
            table = ColumnFile(sidecar(log.path, name).open("rb"), wanted.get(name, ()))
        except OSError:
            return log  # the node came never, or the recorder could not write
        rows = table.rows()
        columns = {
            key: (lambda column: np.array(column) if len(rows) <= short else column)(
                table.column(key)
            )
            for key in table.names
        }
        nodes[name] = replace(
            node,
            cycle=np.array(rows[:, 0]),
            stamp_ns=np.array(rows[:, 1]),
            columns=columns,
            timing=columns,
        )
        tables[name] = [table]
    rest = log.attachments, log.metadata, log.missing
    whole_log = Log(log.path, nodes, *rest)
    if _longest(whole_log) <= short:
        return whole_log
    return LongLog(log.path, nodes, *rest, log.files, tables=tables, part_cycles=part)


def _mapped_log(
    last: Log,
    tables: dict[str, list[ColumnFile]],
    entries: Mapping[str, tuple[list[Any], list[Any]]],
    notes: list[str],
    short: int,
    part: int,
) -> LongLog:
    """Return a log whose columns lie in `tables`; `last` is its last piece."""
    nodes = {}
    for name, node in last.node.items():
        files = tables.setdefault(name, [_table(last.path, ())])
        rows = files[0].rows()

        def fetch(key: str, name: str = name, files: list[ColumnFile] = files) -> Vector:
            for table in files:
                if key in table.names:
                    return table.column(key)
            files.append(_more(last.path, name, key, short))
            return files[-1].column(key)

        events, tunings = entries[name]
        nodes[name] = replace(
            node,
            cycle=rows[:, 0],
            stamp_ns=rows[:, 1],
            columns=Columns(list(node.columns), fetch),
            timing=Columns(list(node.timing), fetch),
            events=events,
            tunings=tunings,
        )
    about = last.attachments, last.metadata, notes, last.files
    return LongLog(last.path, nodes, *about, tables=tables, part_cycles=part)


def _more(path: Path, name: str, column: str, short: int) -> ColumnFile:
    """Return a table of one column more, by one more pass over the file, in the same pieces."""
    table = _table(path, (column,))
    for piece, _ in logs.pieces(path, short=short):
        if name in piece.node:
            table.write(piece.node[name])
    return table


def _table(path: Path, names: Sequence[str]) -> ColumnFile:
    """Return an empty table in a file without a name, beside the log where that can be."""
    try:
        file: Any = tempfile.TemporaryFile(dir=path.absolute().parent)  # noqa: SIM115  while it is mapped
    except OSError:
        file = tempfile.TemporaryFile()  # noqa: SIM115
    return ColumnFile(file, names)
