"""`pcpc log export`: frames for other CAN tools, variables for spreadsheets and data frames.

    format    content                                            stamps, wall time
    candump   .log, as candump -L writes it, channel vcan0       nearest us
    blf       .blf, Vector, channel 1                            ns (1)
    asc       .asc, Vector, channel 1                            nearest us, in the local zone
    csv       variables, a column each, unit in the header       ns; floats round trip
    parquet   the same, unit and meaning in the field metadata   ns
    mf4       ASAM MDF 4: variables, frames and events           ns

(1) python-can's own reader returns float seconds, which since 1970 resolve 0.24 us.

Frames are those that the executive sent and received, each once, by stamp, as a bus would have
shown them. Rows of a table are the executive's cycles; beside them the plant's record of the same
cycle or, where both have clocks of their own, its newest one. `--start`, `--end`: s from the first
record.
"""

import csv
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.can.wire_layout import Flag
from pcpc.drivers.errors import Exit
from pcpc.executive.errors import did_you_mean
from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import cat, mdf, series
from pcpc.tools.after.log.commands import ExportRequest
from pcpc.tools.after.log.mdf import Column
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.answer import Count, one_of
from pcpc.tools.terminal.extras import need
from pcpc.tools.terminal.outfile import LogCommandError, new_file
from pcpc.tools.terminal.progress import Progress

if TYPE_CHECKING:
    from can import Message

CHANNEL = "vcan0"
FORMATS = {".log": "candump", ".blf": "blf", ".asc": "asc", ".csv": "csv", ".parquet": "parquet",
           ".mf4": "mf4"}  # fmt: skip
_OF_FRAMES, _OF_ROWS, _MDF = ("candump", "blf", "asc"), ("csv", "parquet"), "mf4"
_NEEDS = {"parquet": ("Parquet needs", "pyarrow"), _MDF: ("MDF needs", "asammdf")}
_STEP = 20_000  # frames or rows from one look at the progress to the next


def command(request: ExportRequest) -> int:
    """Carry out `export`; return the exit code. LogCommandError: wrong input."""
    if str(request.output) == "-":
        request.refuse("of a file; -o - is text", "json", "force")
        if request.format not in (None, *cat.FORMATS):
            raise LogCommandError(f"--format {request.format}: written to a file; -o FILE")
        return cat.command(request)
    progress = Progress(request.quiet)
    form = request.format or FORMATS.get(request.output.suffix.lower())
    if form is None:
        known = ", ".join(FORMATS)
        raise LogCommandError(f"{request.output}: no known suffix; use {known} or --format")
    if form not in FORMATS.values():
        raise LogCommandError(f"--format {form}: text for pipes; -o -")
    if form in _NEEDS:
        need(*_NEEDS[form])
    window_s = series.window_s(request.window)
    log = series.read_log(request.log, progress)
    begin_ns = series.start_ns(log)
    window = tuple(t if math.isinf(t) else begin_ns + round(1e9 * t) for t in window_s)
    with new_file(request.output, request.force) as path:
        job = _Job(log, path, form, request.topics, window, progress)
        write = _write_frames if form in _OF_FRAMES else _write_table
        counts = (_write_mf4 if form == _MDF else write)(job)
    progress.close()
    if request.json:
        told = _TOLD[form](file=str(request.output), format=form, **counts)
        print(screen.json_text(told, None))
    else:
        print(f"{request.output}: {', '.join(f'{n} {what}' for what, n in counts.items())}")
    return Exit.LOSS if log.missing else Exit.OK


class ExportedFrames(Struct):
    """Frames."""

    file: str
    "that was written"
    format: Annotated[str, one_of(*_OF_FRAMES)]
    frames: Count


class ExportedRows(Struct):
    """Variables."""

    file: str
    "that was written"
    format: Annotated[str, one_of(*_OF_ROWS)]
    rows: Count


class ExportedLog(Struct):
    """All of it."""

    file: str
    "that was written"
    format: Annotated[str, one_of(_MDF)]
    rows: Count
    frames: Count
    events: Count


_TOLD: Mapping[str, Callable[..., Struct]] = {
    **dict.fromkeys(_OF_FRAMES, ExportedFrames),
    **dict.fromkeys(_OF_ROWS, ExportedRows),
    _MDF: ExportedLog,
}


@dataclass(frozen=True)
class _Job:
    log: logs.Log
    path: Path  # to write
    format: str
    topics: Sequence[str] | None  # as asked for
    window: tuple[float, ...]  # wall time, ns
    progress: Progress

    def inside(self, time_ns: NDArray[np.int64]) -> Any:
        """Return which of these times are in the window."""
        return (time_ns >= self.window[0]) & (time_ns < self.window[1])

    def check(self, count: int) -> None:
        """Raise LogCommandError if there is nothing to write."""
        if not count:
            where = "" if self.window == (-math.inf, math.inf) else " there"
            what = f"nothing was recorded{where}; see --topics, --start, --end"
            raise LogCommandError(f"{self.log.path}: {what}")

    def chosen(self, known: Collection[str], otherwise: Sequence[str]) -> Sequence[str]:
        """Return the topics that were asked for, without repetition; LogCommandError if unknown."""
        for topic in self.topics or ():
            if topic not in known:
                hint = did_you_mean(topic, known)
                raise LogCommandError(
                    f"{self.log.path}: --topics {topic}: no such topic for {self.format}{hint}"
                )
        return list(dict.fromkeys(self.topics or otherwise))


# Frames


def _write_frames(job: _Job) -> dict[str, int]:
    topics = {logs.topic(name, "can/frames"): name for name in job.log.node}
    chosen = job.chosen(topics, list(topics)[:1])
    frames, wall_ns = _frames(job, [topics[topic] for topic in chosen])
    job.check(len(frames))
    write = {"candump": _candump, "asc": _asc, "blf": _blf}[job.format]
    write(job, list(zip(frames, wall_ns.tolist(), strict=True)))
    return {"frames": len(frames)}


def _frames(job: _Job, nodes: Sequence[str]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Return the frames of a node by stamp, and their wall times in ns, both (n,); none of none."""
    if not nodes:
        return np.empty(0, logs.FRAME), np.empty(0, np.int64)
    if len(nodes) > 1:
        raise LogCommandError("--topics: two topics hold the same frames; give only one of them")
    frames, offset_ns = job.log.node[nodes[0]].frames, series.wall_offset_ns(job.log, nodes[0])
    frames = frames[job.inside(frames["stamp_ns"] + offset_ns)]
    frames = frames[np.argsort(frames["stamp_ns"], kind="stable")]
    if len(bad := frames[frames["dlc"] > frames["data"].shape[1]]):
        what = f"{logs.topic(nodes[0], 'can/frames')}: a frame of {bad[0]['dlc']} bytes"
        raise LogCommandError(f"{job.log.path}: {what}; the log is damaged, record it again")
    return frames, frames["stamp_ns"] + offset_ns


def message(row: Any, timestamp_s: float) -> "Message":
    """Return a frame of a log as python-can's message."""
    from can import Message

    word, dlc, flags = int(row["id"]), int(row["dlc"]), int(row["flags"])
    return Message(
        timestamp=timestamp_s, arbitration_id=word & can_id.ID,
        is_extended_id=bool(word & can_id.EXTENDED), is_remote_frame=bool(word & can_id.REMOTE),
        is_rx=bool(row["direction"]), dlc=dlc, data=row["data"][:dlc].tobytes(), channel=CHANNEL,
        is_fd=bool(flags & Flag.FD), bitrate_switch=bool(flags & Flag.BRS),
        error_state_indicator=bool(flags & Flag.ESI),
    )  # fmt: skip


def _to_us(time_ns: int) -> float:
    """Return the seconds of the nearest us; a float64 would do it only within 0.24 us."""
    return (time_ns + 500) // 1000 / 1e6


Stamped = Sequence[tuple[Any, int]]  # frame, wall time in ns


def _candump(job: _Job, frames: Stamped) -> None:
    from can import CanutilsLogWriter

    with CanutilsLogWriter(job.path) as writer:
        for row, time_ns in _reported_frames(job, frames):
            writer.on_message_received(message(row, _to_us(time_ns)))


def _asc(job: _Job, frames: Stamped) -> None:
    """Write ASC; its block begins at a whole second, because the writer prints 7 ms as .7."""
    from can import ASCWriter

    with ASCWriter(job.path) as writer:
        writer.log_event("// written by pcpc log export", float(frames[0][1] // 10**9))
        for row, time_ns in _reported_frames(job, frames):
            writer.on_message_received(message(row, _to_us(time_ns)))


def _blf(job: _Job, frames: Stamped) -> None:
    """Write BLF with times since a whole second, which float64 resolves to the ns.

    The writer cuts off what is below, hence the half. The second itself goes into the header.
    """
    from can import BLFWriter

    whole_s = frames[0][1] // 10**9
    with BLFWriter(job.path) as writer:
        writer.start_timestamp = 0.0
        for row, time_ns in _reported_frames(job, frames):
            writer.on_message_received(message(row, (time_ns - whole_s * 10**9 + 0.5) * 1e-9))
        writer.start_timestamp, writer.stop_timestamp = float(whole_s), 1e-9 * frames[-1][1]


def _reported_frames(job: _Job, frames: Stamped) -> Iterator[tuple[Any, int]]:
    """Yield the frames and show how many are done."""
    for number, pair in enumerate(frames):
        if number and number % _STEP == 0:
            job.progress.show(f"{number}/{len(frames)} frames")
        yield pair


# Tables


def _write_table(job: _Job) -> dict[str, int]:
    known = series.all_series(job.log)
    topics = list(dict.fromkeys(one.topic for one in known.values()))
    chosen = job.chosen(topics, [topic for topic in topics if topic.endswith("/state")])
    columns = [one for topic in chosen for one in known.values() if one.topic == topic]
    if not columns:
        raise LogCommandError(f"{job.log.path}: no variables recorded; frames are: use .log, .blf")
    table = _table(job, columns)
    job.check(len(table[0][3]))
    (_csv if job.format == "csv" else _parquet)(job, table)
    return {"rows": len(table[0][3])}


def _table(job: _Job, columns: Sequence[series.Series]) -> list[Column]:
    """Return wall time, cycle and all columns, (rows,) each, at the rows of the first."""
    base, by_cycle = columns[0], series.without_clock(job.log)
    rows = np.flatnonzero(job.inside(base.time_ns))
    table: list[Column] = [
        ("time_ns", "ns", "wall time", base.time_ns[rows]),
        ("cycle", "", "", base.cycle[rows]),
    ]
    paired = {
        topic: series.rows_of(base, next(one for one in columns if one.topic == topic), by_cycle)
        for topic in dict.fromkeys(one.topic for one in columns)
    }
    for one in columns:
        at = paired[one.topic][rows]
        values = np.append(one.values, math.nan)[at]  # row -1, of none, is the last
        table.append((one.name, one.unit, one.help, values))
    return table


def _write_mf4(job: _Job) -> dict[str, int]:
    known = series.all_series(job.log)
    kinds = ("state", "timing", "can/frames", "events", "tunings")
    topics = {logs.topic(name, kind): (name, kind) for name in job.log.node for kind in kinds}
    leader = (next(iter(job.log.node)), "can/frames")
    usual = [t for t, of in topics.items() if of == leader or of[1] not in kinds[1:3]]
    chosen = job.chosen(topics, usual)
    columns = [one for topic in chosen for one in known.values() if one.topic == topic]
    table = _table(job, columns) if columns else []
    nodes = [topics[topic][0] for topic in chosen if topics[topic][1] == "can/frames"]
    entries = sorted(_entries(job, chosen), key=lambda entry: entry[0])
    zero_ns = max(0, series.start_ns(job.log))
    content = mdf.Content(zero_ns, table, *_frames(job, nodes), entries)
    counts = {
        "rows": len(table[0][3]) if table else 0,
        "frames": len(content.frames),
        "events": len(entries),
    }
    job.check(sum(counts.values()))
    with job.progress.going_on(f"writing {counts['rows']} rows, {counts['frames']} frames"):
        content.write(job.path)
    return counts


def _entries(job: _Job, topics: Collection[str]) -> Iterator[mdf.Entry]:
    """Yield the events and tunings of these topics."""
    for name, node in job.log.node.items():
        offset_ns = series.wall_offset_ns(job.log, name)
        for kind, entries in (("events", node.events), ("tunings", node.tunings)):
            if (topic := logs.topic(name, kind)) in topics:
                for entry in entries:
                    wall_ns = int(entry["stamp_ns"]) + offset_ns
                    if job.window[0] <= wall_ns < job.window[1]:
                        yield wall_ns, topic, entry


def _csv(job: _Job, table: Sequence[Column]) -> None:
    count = len(table[0][3])
    with job.path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(f"{name} {series.label(unit)}" for name, unit, _, _ in table)
        for first in range(0, count, _STEP):
            if first:
                job.progress.show(f"{first}/{count} rows")
            parts = [values[first : first + _STEP].tolist() for *_, values in table]
            writer.writerows(zip(*parts, strict=True))


def _parquet(job: _Job, table: Sequence[Column]) -> None:
    import pyarrow
    from pyarrow import parquet

    fields, arrays = [], []
    for name, unit, text, values in table:
        arrays.append(pyarrow.array(values))
        about = {"unit": unit or "1", "help": text}
        fields.append(pyarrow.field(name, arrays[-1].type, metadata=about))
    facts = job.log.metadata
    about = {f"{node}.{key}": value for node in job.log.node for key, value in facts[node].items()}
    schema = pyarrow.schema(fields, metadata=about)
    whole = pyarrow.Table.from_arrays(arrays, schema=schema)
    parquet.write_table(whole, job.path, compression="zstd")
