"""The summary as text for a terminal: at most its width, what matters most at the end.

On a terminal with few lines what matters least is left out, in the order of `_LEAST`; summary.json
holds everything.
"""

import shlex
import shutil
import sys
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from pcpc.drivers.errors import printable
from pcpc.executive.log.long_logs import WITHOUT_CLOCK
from pcpc.tools.after.verdict.summary import problems

LATEST_SHOWN = 3  # of those in summary.json
METRICS_SHOWN = 24
LINES_SHOWN = 6  # of problems
NARROWEST = 40
_LABEL = 9  # letters
_LEAST = (
    "report",
    "stages",
    "latest",
    "records",
    "frames",
    "timing",
    "require",
    "run",
)  # goes first, ..., last
_QUIET = {"problem", "verdict", "folder"}
_PROMPT = 2  # lines of the terminal that are not ours: the command, the next prompt

Row = tuple[str, str, list[str]]  # kind, label, lines


def show(summary: Mapping[str, Any], folder: Path, *, quiet: bool = False) -> None:
    """Print the summary on stdout; `quiet`: what it comes to, and what speaks against it."""
    size = shutil.get_terminal_size()
    shown = rows(summary, folder, max(size.columns, NARROWEST))
    if quiet:
        shown = [row for row in shown if row[0] in _QUIET]
    if sys.stdout.isatty():
        shown = fitted(shown, size.lines - _PROMPT)
    console = Console(highlight=False, soft_wrap=True)
    for _, label, lines in shown:
        for i, line in enumerate(lines):
            console.print(Text.assemble((f"{label if i == 0 else '':{_LABEL}}", "bold"), line))


def fitted(shown: list[Row], lines: int) -> list[Row]:
    """Return the rows that fit: without those that matter least, then with fewer metrics."""
    for kind in _LEAST:
        if sum(len(row[2]) for row in shown) <= lines:
            break
        shown = [row for row in shown if row[0] != kind]
    over = sum(len(row[2]) for row in shown) - lines
    for i, (kind, label, own) in enumerate(shown):
        if kind == "metrics" and over > 0:
            kept = own[: max(len(own) - over - 1, 1)]
            shown[i] = kind, label, [*kept, "the others are in summary.json"]
    return shown


def rows(summary: Mapping[str, Any], folder: Path, width: int) -> list[Row]:
    """Return what to print, wrapped to `width` letters."""
    wide = width - _LABEL
    found: list[Row] = []

    def add(kind: str, text: str, label: str | None = None) -> None:
        found.append((kind, kind if label is None else label, _wrapped(text, wide)))

    real = {None: "", True: ", SCHED_FIFO", False: ", no SCHED_FIFO"}[summary["realtime"]]
    add("rig", printable(f"{summary['rig']}: {summary['title']}".removesuffix(": ")))
    run = (summary["controller"], summary["pacing"], summary["bus"], f"seed {summary['seed']}")
    add("run", ", ".join(run) + real)
    found += _timing(summary, wide)
    for i, worst in enumerate(summary["latest_cycles"][:LATEST_SHOWN]):
        text = f"cycle {worst['cycle']}, {worst['wake_late_us']:g} us: {worst['cause']}"
        add("latest", text, "latest" if i == 0 else "")
    found += _frames(summary, wide)
    records = "  ".join(f"{name} {value}" for name, value in summary["records"].items())
    add("records", records)
    cycles = ("late", "skipped", "held")
    counts = ", ".join(f"{name} {summary[f'{name}_cycles']}" for name in cycles)
    add("cycles", f"{summary['cycles']:,} at {summary['rate_hz']:g} Hz; {counts}")
    if "device" in summary:
        add("device", _device(summary["device"]))
    if summary["injected"]:
        add("injected", ", ".join(summary["injected"]))
    if summary["metrics"]:
        first = [*summary["judged"], *summary["not_judged"]]
        known = sorted(summary["metrics"].items(), key=lambda pair: pair[0] not in first)
        found.append(("metrics", "metrics", _columns(dict(known), wide)))
    held = [one["text"] for one in summary["requirements"] if one["held"]]
    for i, line in enumerate(held):
        add("require", line, "require" if i == 0 else "")
    against = problems(summary)
    for i, line in enumerate(against[:LINES_SHOWN]):
        add("problem", line, "problem" if i == 0 else "")
    if len(against) > LINES_SHOWN:
        add("problem", f"and {len(against) - LINES_SHOWN} more, see summary.json", "")
    if summary["changed"]:
        add("changed", ", ".join(summary["changed"]))
    add("verdict", verdict_text(summary))
    found.append(("folder", "folder", [str(folder)]))  # in one piece: to be copied
    add("report", f"pcpc report {shlex.quote(str(folder))}")
    return found


def _device(told: Mapping[str, Any]) -> str:
    """Return what a device sent and how, in a line."""
    frames = [f"{name} {counts['received']:,}" for name, counts in told["frames"].items()]
    late = [f"late in {told['late_cycles']:,} cycles"] if told["late_cycles"] else []
    timing = [f"{name} {value:g}" for name, value in told["timing"].items()]
    return ", ".join([*frames, *late, *timing])


def verdict_text(summary: Mapping[str, Any]) -> str:
    """Return the verdict, and what was not judged."""
    judged, left = len(summary["judged"]), summary["not_judged"]
    if summary["verdict"] not in ("ok", "loss", "expectation not met"):
        return str(summary["verdict"])
    if left:
        reasons = ", ".join(dict.fromkeys(left.values()))
        return f"{summary['verdict']} ({_limits(len(left))} not judged: {reasons})"
    if not judged:
        what = f"the rig states no limits for {summary['controller']}"
        return f"{summary['verdict']} (nothing judged: {what})"
    return f"{summary['verdict']} ({_limits(judged)} judged)"


def _limits(count: int) -> str:
    return f"{count} limit" if count == 1 else f"{count} limits"


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width, subsequent_indent="  ", break_on_hyphens=False) or [""]


def _timing(summary: Mapping[str, Any], width: int) -> list[Row]:
    stages = summary["timing_us"]
    if not stages:
        return []
    points = list(next(iter(stages.values())))
    points = points[-max((width - 10) // 9, 1) :]  # as many as fit, the largest first
    head = f"{'us':10}" + "".join(f"{point:>9}" for point in points)
    lines = [head] + [
        f"{stage:10}" + "".join(f"{values[p]:9.1f}" for p in points)
        for stage, values in stages.items()
    ]
    if summary["pacing"] in WITHOUT_CLOCK:  # nothing that could be late
        return [("stages", "stages", lines)]
    share = f"lateness and work at p99.9: {summary['timing_share']:.1%} of a period"
    return [
        ("stages", "stages", lines),
        ("timing", "timing", _wrapped(f"{summary['timing_level']}; {share}", width)),
    ]


def _frames(summary: Mapping[str, Any], width: int) -> list[Row]:
    """Return where the frames went; without an account of all nodes the sums of all."""
    account = summary["frames_to"]
    total = {name: count for name, count in summary["frames"].items() if count}
    if not account:
        text = "  ".join(f"{name} {count:,}" for name, count in total.items())
        return [("frames", "frames", _wrapped(text or "none", width))]
    found: list[Row] = []
    for role, row in account.items():
        if role == "nobody":
            if not row["sent"]:
                continue
            text = f"heard by none of the nodes: {row['sent']:,}"
        else:
            rest = [
                f"{name} {n:,}" for name, n in row.items() if n and name not in ("sent", "used")
            ]
            text = f"to {role}: sent {row['sent']:,} = used {row['used']:,}"
            text = " + ".join([text, *rest])
        found.append(("frames", "" if found else "frames", _wrapped(text, width)))
    known = {
        "sent",
        "received",
        "lost",
        "repeated",
        "crc_errors",
        "lost_on_purpose",
        "wrong_sequence",
        "signs_on_purpose",
    }
    if not total.get("lost_on_purpose"):
        known |= {"missed", "starved"}  # as lost and stale
    others = [f"{name} {count:,}" for name, count in total.items() if name not in known]
    if others:
        found.append(("frames", "", _wrapped("  ".join(others), width)))
    if summary["most_cut"]:
        found.append(("frames", "", _wrapped(summary["most_cut"], width)))
    return found


def _columns(metrics: Mapping[str, float], width: int) -> list[str]:
    """Return names and values in as many columns as fit."""
    texts = [(name, f"{value:.4g}") for name, value in list(metrics.items())[:METRICS_SHOWN]]
    letters = max(len(name) for name, _ in texts), max(len(value) for _, value in texts)
    cell = sum(letters) + 1
    across = max((width + 2) // (cell + 2), 1)
    down = -(-len(texts) // across)
    lines = []
    for row in range(down):
        own = texts[row::down]
        lines.append("  ".join(f"{n:{letters[0]}} {v:>{letters[1]}}" for n, v in own)[:width])
    if len(metrics) > METRICS_SHOWN:
        lines.append(f"and {len(metrics) - METRICS_SHOWN} more, see summary.json")
    return lines
