"""`pcpc compare --bits`: where two runs part, variable by variable, sorted by the first difference.

Bits, tolerances and order are those of `tools.after.differences`.

Runs are compared cycle by cycle; a cycle, variable or frame that only one log has is a difference.
Frames are compared by id and direction, without their stamps; their data only when every bit
counts. The timing of a run is measured, and compared only where a pattern names it, as 'timing.*'.
Events and tunings are not compared.
"""

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.errors import Exit
from pcpc.executive.log import reader as logs
from pcpc.executive.log.inventory import TOPICS
from pcpc.tools.after.differences import (
    EXACT,
    FRAME,
    Difference,
    Differences,
    Rows,
    Times,
    Tolerance,
    loop_order,
)
from pcpc.tools.after.log import series, source
from pcpc.tools.after.log.commands import Bits
from pcpc.tools.after.log.contents import DIRECTIONS
from pcpc.tools.after.log.frames import payload
from pcpc.tools.after.log.recorded import log_of
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.answer import Count, NodeName, Positive
from pcpc.tools.terminal.document import Table, terminal
from pcpc.tools.terminal.outfile import LogCommandError, write_text
from pcpc.tools.terminal.progress import Progress
from pcpc.tools.terminal.request import Offers

_SHOWN = 40  # rows of the table; all of them with --json


class DifferentBits(Struct):
    """Of a variable, or of frames."""

    name: str
    "a variable, or frame and direction behind the word frame"
    time_s: float
    "of the first one, s from the start of the first log"
    cycle: int
    "of the first one"
    a: str
    "there, as Python writes it; of a frame its bytes"
    b: str
    "there, in the second log"
    count: Positive
    "cycles, or frames, that differ"
    ulp: int | None
    "of the first one, in units of the last place; null: of a frame, or NaN"
    largest: Annotated[float, Meta(ge=0)] | None
    "absolute, in the unit of the variable; null: of a frame, or not finite"
    largest_time_s: float | None
    "its time, s"


class BitReport(Struct):
    """What two logs differ in."""

    equal: bool
    "nothing differs"
    a: str
    "the first log"
    b: str
    "the second log"
    cycles: dict[NodeName, Count]
    "that were compared, by node"
    recorded: dict[NodeName, Count]
    "cycles that one of the logs has, or both, by node"
    variables: Count
    "that were compared"
    frames: Count
    "that were compared"
    differences: list[DifferentBits]
    "by time, cause before effect; within the tolerances none"
    only: list[str]
    "what one log has and the other has not, in words"
    missing: list[str]
    "what a log lacks, in words"
    patterns: list[str]
    "variables that were asked for; empty: all but timing, and the frames"


@dataclass
class Report:
    """What was found; fields as of `BitReport`."""

    a: str
    b: str
    cycles: dict[str, int] = field(default_factory=dict)
    recorded: dict[str, int] = field(default_factory=dict)
    variables: int = 0
    frames: int = 0
    differences: list[Difference] = field(default_factory=list)
    only: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    patterns: list[str] = field(default_factory=list)

    @property
    def equal(self) -> bool:
        """Nothing differs."""
        return not (self.differences or self.only)


def compare_bits(
    words: Sequence[str], beside: Offers, relative: float, file: str | None, quiet: bool
) -> int:
    """Compare two logs, print, write `file`; return the exit code. LogCommandError: wrong input."""
    if len(words) < 2:
        raise LogCommandError(f"expected two logs to compare, got {len(words)}")
    paths, variables = [log_of(word) for word in words[:2]], words[2:]
    absolute = beside.of(Bits).absolute
    for name, value in (("tolerance", relative), ("absolute", absolute)):
        if not (math.isfinite(value) and value >= 0.0):
            raise LogCommandError(f"--{name} {value:g}: not a tolerance; expected 0 or more")
    progress = Progress(quiet)
    watch, read = source.Watch(paths[0], progress), []
    for path in paths:
        watch.say(f"reading {path}")
        read.append(series.read_log(path, progress))
    watch.say(f"comparing with {paths[1]}")
    report = compare(read[0], read[1], variables, relative, absolute)
    progress.close()
    if file is not None:
        told = vars(report) | {"differences": [plain(one) for one in report.differences]}
        text = screen.json_text(BitReport(report.equal, **told)) + "\n"
        if file == "-":
            sys.stdout.write(text)
        else:
            write_text(Path(file), text)
    if file != "-":
        show(report)
    if not report.equal:
        return Exit.NOT_MET
    return Exit.LOSS if report.missing else Exit.OK


def compare(
    a: logs.Log,
    b: logs.Log,
    patterns: Sequence[str] = (),
    relative: float = 0.0,
    absolute: float = 0.0,
) -> Report:
    """Compare two logs; LogCommandError for a pattern that matches no variable of either."""
    report = Report(str(a.path), str(b.path), patterns=list(patterns))
    report.missing = [f"{log.path}: {line}" for log in (a, b) for line in log.missing]
    ours, theirs = series.all_series(a), series.all_series(b)
    known = [*ours, *(name for name in theirs if name not in ours)]
    where = f"{a.path}, {b.path}"
    chosen = (
        series.choose(known, patterns, where, (a, b))
        if patterns
        else [name for name in known if (ours.get(name) or theirs[name]).topic.endswith("/state")]
    )
    _only(report, "variable", *({n for n in chosen if n in s} for s in (ours, theirs)))
    zero_ns, both = series.start_ns(a), [n for n in chosen if n in ours and n in theirs]
    for node, (here, there) in _shared_cycles(report, a, b).items():
        about = [log.node[node].description.get("variables", ()) for log in (b, a)]
        found = Differences(node, chain(*about), Tolerance(relative, absolute))
        for name in (n for n in both if TOPICS[ours[n].topic][0] == node):
            one, other = ours[name], theirs[name].values[there]
            local, time_s = name.removeprefix(f"{node}."), (one.time_ns[here] - zero_ns) / 1e9
            found.add(local, one.cycle[here], time_s, one.values[here], other)
            report.variables += 1
        if not patterns:
            _frames(report, found, node, a, b)
        report.differences += found.values()
    if not any(report.cycles.values()) and not report.frames:
        report.missing.append("nothing was compared: the logs share no cycle and no frame")
    report.differences.sort(key=loop_order)
    return report


def _only(report: Report, what: str, a: set[str], b: set[str]) -> None:
    for path, names in ((report.a, a - b), (report.b, b - a)):
        if names:
            listed = ", ".join(screen.some(sorted(names), 8, "..."))
            count = f"{len(names)} {what}{'s' * (len(names) > 1)}"
            report.only.append(f"only {path} has {count}: {listed}")


def _shared_cycles(
    report: Report, a: logs.Log, b: logs.Log
) -> dict[str, tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Return the rows of the cycles that both logs have, by node; note the others."""
    shared = {}
    _only(report, "node", set(a.node), set(b.node))
    for name in (name for name in a.node if name in b.node):
        ours, theirs = a.node[name].cycle, b.node[name].cycle
        common, i, j = np.intersect1d(ours, theirs, return_indices=True)
        shared[name], report.cycles[name] = (i, j), len(common)
        report.recorded[name] = len(ours) + len(theirs) - len(common)
        for path, own in ((report.a, ours), (report.b, theirs)):
            rest = np.setdiff1d(own, common)
            if len(rest):
                count = f"{len(rest)} cycle{'s' * (len(rest) > 1)}"
                report.only.append(f"only {path} has {count} of {name}: {rest[0]} to {rest[-1]}")
    return shared


def _frames(report: Report, found: Differences, node: str, a: logs.Log, b: logs.Log) -> None:
    """Compare the frames of a node, by id and direction; their data only where bits count."""
    names = logs.frame_names(a) | logs.frame_names(b)
    exact = ("e2e", "data") if found.tolerance == EXACT else ()
    ours, theirs = (_by_id(log.node[node].frames) for log in (a, b))
    begins = [log.node[node].stamp_ns[:1] for log in (a, b)]
    for key in sorted(ours.keys() | theirs.keys()):
        name = f"{FRAME}{names.get(key[1], can_id.text_of(key[1]))} {DIRECTIONS[key[0]]}"
        none = np.empty(0, logs.FRAME)
        both = ours.get(key, none), theirs.get(key, none)
        report.frames += max(map(len, both))
        times_s = [_times_s(*one) for one in zip(both, begins, strict=True)]
        found.add_frames(name, *both, ("cycle", "dlc", *exact), times_s, payload)


def _times_s(frames: Rows, begin_ns: NDArray[np.int64]) -> Times:
    """Return the time of frames from the first cycle on, or the first frame where there is none."""
    zero_ns = [*begin_ns, *frames["stamp_ns"][:1]]
    return np.asarray((frames["stamp_ns"] - zero_ns[0]) / 1e9 if len(frames) else np.empty(0))


def _by_id(frames: Rows) -> Mapping[tuple[int, int], Rows]:
    """Return the frames of each (direction, id), in order."""
    keys = frames["direction"].astype(np.int64) << 32 | frames["id"]
    return {(int(k) >> 32, int(k) & 0xFFFFFFFF): frames[keys == k] for k in np.unique(keys)}


def plain(one: Difference) -> DifferentBits:
    """Return a difference for JSON."""
    a, b = one.texts
    sizes = one.count, one.ulp, one.largest, one.largest_time_s
    return DifferentBits(one.label, one.time_s, one.cycle, a, b, *sizes)


def show(report: Report) -> None:
    """Print a report."""
    size = f"{report.variables} variables, {report.frames} frames"
    size += "" if report.patterns else ", timing not compared"
    cycles = [f"{name} {n} of {report.recorded[name]}" for name, n in report.cycles.items()]
    verdict = "equal" if report.equal else f"{len(report.differences)} differ"
    verdict = verdict if any(report.cycles.values()) or report.frames else "nothing compared"
    compared = f"recorded cycles of {', '.join(cycles) or 'no node'}"
    print(*screen.fitted((f"{compared}, {size}: {verdict}", *report.only)), sep="\n")
    if not report.differences:
        return
    head = ("variable", "first at", "cycle", "A", "B", "ULP", "largest", "at", "cycles")
    rows = list(_rows(report.differences[:_SHOWN]))
    print("\n".join(terminal(Table(head, rows, range(1, len(head))))))
    if len(report.differences) > _SHOWN:
        print(f"and {len(report.differences) - _SHOWN} more, see --json", file=sys.stderr)


def _rows(differences: Sequence[Difference]) -> Iterator[tuple[str, ...]]:
    for d in differences:
        yield (
            d.label, f"{d.time_s:.3f} s", str(d.cycle), *d.texts,
            "" if d.ulp is None else f"{d.ulp:.3g}" if d.ulp > 10**6 else str(d.ulp),
            "" if d.largest is None else f"{d.largest:.3g}",
            "" if d.largest_time_s is None else f"{d.largest_time_s:.3f} s", str(d.count),
        )  # fmt: skip
