"""`pcpc log diff`: where two runs part, variable by variable, sorted by the first difference.

At one instant the order is that of the loop: what the plant computes comes before what the
executive receives of it, a law's output before the frame that carries it.

    differs    |a - b| > absolute + relative |a|; by default both are 0, and every bit counts;
               NaN equals NaN
    ULP        how many float64 lie between the two values at the first difference

Runs are compared cycle by cycle; a cycle, variable or frame that only one log has is a difference.
Frames are compared by id and direction, without their stamps; their data only when every bit
counts. The timing of a run is measured, and compared only where a pattern names it, as 'timing.*'.
Events and tunings are not compared.
"""

import argparse
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.errors import Exit
from pcpc.executive.log import reader as logs
from pcpc.executive.log.inventory import TOPICS
from pcpc.tools.after.log import series, source
from pcpc.tools.after.log.cat import payload, unequal_frames, unequal_texts
from pcpc.tools.after.log.tally import DIRECTIONS
from pcpc.tools.after.log.ulp import ulp_distance
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.document import Table, terminal
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress

_STAGES = {"rx": 0, "tx": 2}  # of a cycle; blocks between them, frames at the end
_SHOWN = 40  # rows of the table; all of them with --json


@dataclass
class Difference:
    """How a variable or frame of two logs differs; `time_s` from the first cycle of A.

    `largest` is None for what has no size: a frame, a NaN or an infinity in one log only.
    """

    name: str
    time_s: float
    cycle: int
    a: str
    b: str
    count: int
    ulp: int | None = None
    largest: float | None = None
    largest_time_s: float | None = None


@dataclass
class Report:
    """What `--json` prints. `only`: what one of the logs has and the other has not, in words."""

    a: str
    b: str
    cycles: dict[str, int] = field(default_factory=dict)  # compared, by node
    recorded: dict[str, int] = field(default_factory=dict)  # in one log or both, by node
    variables: int = 0
    frames: int = 0
    differences: list[Difference] = field(default_factory=list)
    only: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    patterns: list[str] = field(default_factory=list)  # compared; empty: all but timing

    @property
    def equal(self) -> bool:
        """Nothing differs."""
        return not (self.differences or self.only)


def command(options: argparse.Namespace) -> int:
    """Carry out `diff`; return the exit code. LogCommandError: wrong input."""
    for name in ("tolerance", "absolute"):
        value = getattr(options, name)
        if not (math.isfinite(value) and value >= 0.0):
            raise LogCommandError(f"--{name} {value:g}: not a tolerance; expected 0 or more")
    progress = Progress(options.quiet)
    watch, read = source.Watch(options.a, progress), []
    for path in (options.a, options.b):
        watch.say(f"reading {path}")
        read.append(series.read_log(path, progress))
    watch.say(f"comparing with {options.b}")
    report = compare(read[0], read[1], options.variables, options.tolerance, options.absolute)
    progress.close()
    if options.json:
        print(json.dumps({"equal": report.equal, **asdict(report)}, indent=2))
    else:
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
    zero_ns = series.start_ns(a)
    for name, rows in _shared_cycles(report, a, b).items():
        both = [n for n in chosen if n in ours and n in theirs]
        for variable in (n for n in both if TOPICS[ours[n].topic][0] == name):
            one, other = ours[variable], theirs[variable]
            found = _values(one, other, rows, relative, absolute, zero_ns)
            report.variables += 1
            if found is not None:
                report.differences.append(found)
    if not patterns:
        _frames(report, a, b, exact=relative == absolute == 0.0)
    if not any(report.cycles.values()) and not report.frames:
        report.missing.append("nothing was compared: the logs share no cycle and no frame")
    report.differences.sort(key=_in_the_loop)
    return report


def _in_the_loop(one: Difference) -> tuple[float, int, int, int]:
    """Return what sorts differences by time and, at one instant, by cause before effect."""
    name, node = one.name.removeprefix("frame "), node_of(one)
    kind = name.removeprefix(f"{node}.").partition(".")[0]
    stage = 3 if name != one.name else _STAGES.get(kind, 1)
    return one.time_s, one.cycle, -logs.NODES.index(node), stage


def node_of(one: Difference) -> str:
    """Return the node whose variable or frame it is."""
    name = one.name.removeprefix("frame ")
    return next((node for node in logs.NODES if name.startswith(f"{node}.")), "executive")


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


def _values(
    one: series.Series,
    other: series.Series,
    rows: tuple[NDArray[np.int64], NDArray[np.int64]],
    relative: float,
    absolute: float,
    zero_ns: int,
) -> Difference | None:
    """Return how two series differ in the given rows of each; None if they do not."""
    a, b = one.values[rows[0]], other.values[rows[1]]
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.abs(a - b)
        within = (a.view(np.int64) == b.view(np.int64)) | (np.isnan(a) & np.isnan(b))
        if relative or absolute:
            within |= (a == b) | (distance <= absolute + relative * np.abs(a))
    at = np.flatnonzero(~within)
    if not len(at):
        return None
    first, row = int(at[0]), rows[0]
    time_s = (one.time_ns - zero_ns) / 1e9
    found = Difference(
        one.name,
        float(time_s[row[first]]),
        int(one.cycle[row[first]]),
        repr(float(a[first])),
        repr(float(b[first])),
        len(at),
        ulp_distance(float(a[first]), float(b[first])),
    )
    sized = at[np.isfinite(distance[at])]
    if len(sized):
        largest = int(sized[np.argmax(distance[sized])])
        found.largest = float(distance[largest])
        found.largest_time_s = float(time_s[row[largest]])
    return found


def _frames(report: Report, a: logs.Log, b: logs.Log, exact: bool) -> None:
    """Compare the frames of each node, id and direction; `exact`: also their data."""
    names = logs.frame_names(a) | logs.frame_names(b)
    parts = ("cycle", "dlc", "e2e", "data") if exact else ("cycle", "dlc")
    for node in (name for name in a.node if name in b.node):
        ours, theirs = (_by_id(log.node[node].frames) for log in (a, b))
        begins = [log.node[node].stamp_ns[:1] for log in (a, b)]
        for key in sorted(ours.keys() | theirs.keys()):
            name = f"{names.get(key[1], can_id.text_of(key[1]))} {DIRECTIONS[key[0]]}"
            name = name if node == "executive" else f"{node}.{name}"
            none = np.empty(0, logs.FRAME)
            one, other = ours.get(key, none), theirs.get(key, none)
            report.frames += max(len(one), len(other))
            found = _frame_difference(f"frame {name}", one, other, parts, begins)
            if found is not None:
                report.differences.append(found)


def _by_id(frames: NDArray[Any]) -> Mapping[tuple[int, int], NDArray[Any]]:
    """Return the frames of each (direction, id), in order."""
    keys = frames["direction"].astype(np.int64) << 32 | frames["id"]
    return {(int(k) >> 32, int(k) & 0xFFFFFFFF): frames[keys == k] for k in np.unique(keys)}


def _frame_difference(
    name: str,
    a: NDArray[Any],
    b: NDArray[Any],
    parts: Sequence[str],
    begins: Sequence[NDArray[np.int64]],
) -> Difference | None:
    count, at = unequal_frames(a, b, parts)
    if not count:
        return None
    longer, begin = (a, begins[0]) if len(a) > at else (b, begins[1])
    zero_ns = int(begin[0]) if len(begin) else int(longer["stamp_ns"][0])
    time_s = (int(longer["stamp_ns"][at]) - zero_ns) / 1e9
    texts = unequal_texts(a, b, at, payload)
    return Difference(name, time_s, int(longer["cycle"][at]), *texts, count)


def show(report: Report) -> None:
    """Print a report."""
    size = f"{report.variables} variables, {report.frames} frames"
    size += "" if report.patterns else ", timing not compared"
    cycles = [f"{name} {n} of {report.recorded[name]}" for name, n in report.cycles.items()]
    verdict = "equal" if report.equal else f"{len(report.differences)} differ"
    verdict = verdict if any(report.cycles.values()) or report.frames else "nothing compared"
    compared = f"recorded cycles of {', '.join(cycles) or 'no node'}"
    for line in (f"{compared}, {size}: {verdict}", *report.only):
        print("\n".join(screen.wrapped_lines(line, rest="  ")))
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
            d.name, f"{d.time_s:.3f} s", str(d.cycle), d.a, d.b,
            "" if d.ulp is None else f"{d.ulp:.3g}" if d.ulp > 10**6 else str(d.ulp),
            "" if d.largest is None else f"{d.largest:.3g}",
            "" if d.largest_time_s is None else f"{d.largest_time_s:.3f} s", str(d.count),
        )  # fmt: skip
