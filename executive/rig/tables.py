"""The file behind `law: table`: numbers over time, read once, each mistake with file and line.

    # any text                                    comments, also behind a row
    t_s, q_d_rad, load [N m]                      names end in their unit, or say it
    0.0, 0.0,     1.5                             separated by ; tab , or blanks; times rise

A log carries the numbers as such a text, so that a run is recomputed when the file is gone. Other
kinds of files are read by whom `reads` has named for their ending: logs by `executive.log.signals`.
"""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.errors import RigError
from pcpc.executive.rig.node_keys import BlockEntry
from pcpc.executive.rig.yamlfile import Document, Keys, display_path

if TYPE_CHECKING:
    from pcpc.executive.laws.block import Block

LAW = "table"
MOST_VALUES = 100_000  # of a table, times not counted; numba keeps up to 1 MB with the code
_TIME = "t_s"
_COLUMN = re.compile(r"([A-Za-z]\w{0,63})(?:\s*\[([^\[\];,#]*)\])?", re.ASCII)
_LONGEST_LINE = 100_000


@dataclass(frozen=True)
class Numbers:
    """What a file holds: `columns` as a header says them, times (rows,), values (rows, columns)."""

    columns: Sequence[str]
    times_s: NDArray[np.float64]
    values: NDArray[np.float64]

    def text(self) -> str:
        """Return it as a CSV that is read back to the same bits."""
        rows = np.column_stack((self.times_s, self.values)).tolist()
        lines = [", ".join((_TIME, *self.columns)), *(", ".join(map(repr, row)) for row in rows)]
        return "\n".join(lines) + "\n"


Reader = Callable[[Path, Sequence[str]], Numbers]  # of a file and the names of its signals
_readers: dict[str, Reader] = {}


def table_reader(ending: str) -> Callable[[Reader], Reader]:
    """Return what makes a function the reader of files with this ending; RigError from it."""

    def registered_reader(reader: Reader) -> Reader:
        _readers[ending] = reader
        return reader

    return registered_reader


def read_table(
    document: Document, keys: Keys, entry: BlockEntry
) -> "tuple[Block, str, BlockEntry]":
    """Return the block of a table, its numbers as text, and `entry`; RigError for what is wrong."""
    from pcpc.executive.laws import table  # here, because it imports numba

    if entry.file is None:
        raise document.error(keys, "law table needs `file`, a CSV or a log")
    file = document.file((*keys, "file"), entry.file)
    wanted = [entry.signal] if isinstance(entry.signal, str) else entry.signal or []
    reader = _readers.get(file.suffix)
    if (reader is None) != (not wanted):
        problem = "give `signal: NAME` of the log" if reader else "only a log (.mcap) has signals"
        raise document.error(keys, problem)
    if reader is None and entry.interpolation is None:
        raise document.error(keys, "give `interpolation: linear` or `interpolation: hold`")
    numbers = reader(file, wanted) if reader else _read_csv(file)
    columns: dict[str, str] = {}
    for text in numbers.columns:
        column = _COLUMN.fullmatch(text)
        if column is None or column[1] in columns:
            problem = "named twice" if column else "expected a name such as q_d_rad or load [N m]"
            raise RigError(f"{display_path(file)}: column '{text[:60]}': {problem}")
        columns[column[1]] = table.unit_of(column[1]) if column[2] is None else column[2].strip()
    linear = entry.interpolation == "linear"
    block = table.block(numbers.times_s, numbers.values, columns, linear, entry.repeat)
    return block, numbers.text(), entry


def resolve(entry: dict[str, Any]) -> None:
    """Let the entry of a rig be that of the CSV in its log."""
    entry["signal"] = None
    entry["interpolation"] = entry["interpolation"] or "hold"


def _read_csv(file: Path) -> Numbers:
    """Return what a CSV holds; RigError."""
    where, header, rows = display_path(file), list[str](), list[list[float]]()
    for number, text in _lines(file):
        line, cells = f"{where}:{number}", _cells(text)
        if not header:
            header = cells
            if header[0] != _TIME or len(header) < 2:
                problem = f"the first line names the columns, {_TIME} first, as `{_TIME}, q_d_rad`"
                raise RigError(f"{line}: {problem}; got '{text[:60]}'")
            continue
        if len(cells) != len(header):
            raise RigError(
                f"{line}: {len(cells)} values where the header has {len(header)} columns"
            )
        rows.append([_number(line, name, cell) for name, cell in zip(header, cells, strict=True)])
        if len(rows) > 1 and not rows[-2][0] < rows[-1][0]:
            problem = f"{_TIME} {rows[-1][0]:g} is not later than that of the row before"
            raise RigError(f"{line}: {problem}, {rows[-2][0]:g}")
        if len(rows) * (len(header) - 1) > MOST_VALUES:
            raise RigError(f"{line}: more than {MOST_VALUES} values; leave out rows or columns")
    if len(rows) < 2:
        raise RigError(f"{where}: a header and at least two rows are needed, got {len(rows)}")
    both = np.array(rows)
    return Numbers(header[1:], both[:, 0].copy(), both[:, 1:].copy())


def _lines(file: Path) -> Iterator[tuple[int, str]]:
    """Yield number and text of each line that says something."""
    try:
        with file.open(encoding="utf-8-sig") as stream:
            for number, line in enumerate(iter(lambda: stream.readline(_LONGEST_LINE), ""), 1):
                if text := line.partition("#")[0].strip():
                    yield number, text
    except UnicodeDecodeError:
        raise RigError(f"{display_path(file)}: not text; give a CSV file") from None
    except OSError as error:
        raise RigError(f"{display_path(file)}: {error.strerror}") from None


def _cells(text: str) -> list[str]:
    separator = next((one for one in ";\t," if one in text), None)
    return [cell.strip() for cell in text.split(separator)]


def _number(where: str, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RigError(f"{where}: {name}: expected a finite number, got '{text[:40]}'")
    return value
