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

from pcpc.drivers.errors import printable
from pcpc.executive.log.long_logs import WITHOUT_CLOCK
from pcpc.tools.after.verdict.findings import NOT_JUDGED
from pcpc.tools.after.verdict.summary import UNFAILED, Summary
from pcpc.tools.terminal import document, screen

LATEST_SHOWN = 3  # of those in summary.json
METRICS_SHOWN = 24
LINES_SHOWN = 6  # of problems
NARROWEST = 40
_LABEL = 9  # letters
_LEAST = "report", "stages", "slowest", "records", "frames", "timing", "require", "run"  # first
_QUIET = {"warning", "problem", "verdict", "folder"}
_AS_THEY_ARE = {"stages", "metrics", "folder"}  # in columns, or in one piece: to be copied
_PROMPT = 2  # lines of the terminal that are not ours: the command, the next prompt
_ACCOUNTED = {  # counters that the account of all nodes tells
    "sent", "received", "lost", "repeated", "crc_errors", "lost_on_purpose", "wrong_sequence",
    "signs_on_purpose",
}  # fmt: skip

Rows = dict[str, list[str]]  # label -> lines


def show(summary: Summary, folder: Path, *, quiet: bool = False) -> None:
    """Print the summary on stdout; `quiet`: what it comes to, and what speaks against it."""
    size = shutil.get_terminal_size()
    shown = rows(summary, folder, max(size.columns, NARROWEST))
    if quiet:
        said = _QUIET | {"changed"} if summary.is_branch else _QUIET
        shown = {label: lines for label, lines in shown.items() if label in said}
    if sys.stdout.isatty():
        shown = fitted_rows(shown, size.lines - _PROMPT)
    lines = (
        f"{'' if number else label:{_LABEL}}{line}"
        for label, own in shown.items()
        for number, line in enumerate(own)
    )
    document.show(lines, _LABEL)


def fitted_rows(shown: Rows, lines: int) -> Rows:
    """Return the rows that fit: without those that matter least, then with fewer metrics."""
    for least in _LEAST:
        if sum(map(len, shown.values())) <= lines:
            break
        shown = {label: own for label, own in shown.items() if label != least}
    over = sum(map(len, shown.values())) - lines
    if over > 0 and (own := shown.get("metrics")):
        shown["metrics"] = [*own[: max(len(own) - over - 1, 1)], "the others are in summary.json"]
    return shown


def rows(summary: Summary, folder: Path, width: int) -> Rows:
    """Return what to print, wrapped to `width` letters."""
    wide, against = width - _LABEL, summary.problems()
    real = {None: "", True: ", SCHED_FIFO", False: ", no SCHED_FIFO"}[summary.realtime]
    cycles = {
        "late": summary.late_cycles, "skipped": summary.skipped_cycles, "held": summary.held_cycles
    }  # fmt: skip
    counts = ", ".join(f"{name} {count}" for name, count in cycles.items())
    texts = {
        "rig": [printable(f"{summary.rig}: {summary.title}".removesuffix(": "))],
        "run": [
            f"{summary.controller}, {summary.pacing}, {summary.bus}, seed {summary.seed}{real}"
        ],
        "stages": _stages(summary, wide),
        "timing": [timing_text(summary)],
        "slowest": [
            f"cycle {worst['cycle']}, {worst['wake_late_us']:g} us: {worst['cause']}"
            for worst in summary.latest_cycles[:LATEST_SHOWN]
        ],
        "frames": _frames(summary),
        "records": ["  ".join(f"{name} {value}" for name, value in summary.records.items())],
        "cycles": [f"{summary.cycles:,} at {summary.rate_hz:g} Hz; {counts}"],
        "device": [_device(summary.device)] if summary.device else [],
        "injected": [", ".join(summary.injected)],
        "metrics": _metrics(summary, wide),
        "require": [one.text for one in summary.requirements if one.held],
        "warning": summary.warned,
        "problem": screen.some(against, LINES_SHOWN, "and {} more, see summary.json")
        * (against != summary.reasons() or len(against) > 1),
        "changed": [", ".join(summary.changed)],
        "verdict": [verdict_text(summary)],
        "folder": [str(folder)],
        "report": [f"pcpc report {shlex.quote(str(folder))}"],
    }  # fmt: skip
    return {
        label: own if label in _AS_THEY_ARE else [one for text in own for one in _lines(text, wide)]
        for label, own in texts.items()
        if any(own)
    }


def _lines(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width, subsequent_indent="  ", break_on_hyphens=False)


def _device(device: Mapping[str, Any]) -> str:
    """Return what a device sent and how, in a line."""
    frames = [f"{name} {counts['received']:,}" for name, counts in device["frames"].items()]
    late = [f"late in {device['late_cycles']:,} cycles"] if device["late_cycles"] else []
    timing = [f"{name} {value:g}" for name, value in device["timing"].items()]
    return ", ".join([*frames, *late, *timing])


def verdict_text(summary: Summary) -> str:
    """Return the verdict, its first reason, and what was not judged."""
    judged, unjudged, why = len(summary.judged), summary.not_judged, summary.reasons()
    text = ": ".join([summary.verdict, *why[:1]])
    if more := len([line for line in summary.problems() if line not in why[:1]]):
        text += f", and {more} more above"
    if warned := len(summary.warned):
        text += f", with {warned} warning{'s' * (warned > 1)} above"
    if summary.verdict not in (*UNFAILED, "loss", "expectation not met"):
        return text
    if unjudged:
        limits = f"{len(unjudged)} limit{'s' * (len(unjudged) > 1)} not judged"
        if summary.verdict != NOT_JUDGED:
            limits += f": {', '.join(dict.fromkeys(unjudged.values()))}"
    elif judged:
        limits = f"{judged} limit{'s' * (judged > 1)} judged"
    else:
        limits = f"nothing judged: the rig states no limits for {summary.controller}"
    return f"{text} ({limits})"


def timing_text(summary: Summary) -> str:
    """Return how late the executive was, and what it missed; "" without a clock."""
    if not summary.timing_us or summary.pacing in WITHOUT_CLOCK:
        return ""
    missed = {"skipped": summary.skipped_cycles, "held": summary.held_cycles}
    counts = ", ".join(f"{count:,} periods {name}" for name, count in missed.items() if count)
    told = f"; {counts} of {summary.cycles:,}" * (bool(counts) and summary.timing_level != "OK")
    share = f"lateness and work at p99.9: {summary.timing_share:.1%} of a period"
    return f"{summary.timing_level}; {share}{told}"


def _stages(summary: Summary, width: int) -> list[str]:
    """Return how long each stage took, as many percentiles as fit, the largest first."""
    stages = summary.timing_us
    points = list(next(iter(stages.values()), {}))[-max((width - 10) // 9, 1) :]
    return [
        f"{'us':10}" + "".join(f"{point:>9}" for point in points),
        *(
            f"{stage:10}" + "".join(f"{values[p]:9.1f}" for p in points)
            for stage, values in stages.items()
        ),
    ] * bool(stages)


def _frames(summary: Summary) -> list[str]:
    """Return where the frames went; without an account of all nodes the sums of all."""
    total = {name: count for name, count in summary.frames.items() if count}
    if not summary.frames_to:
        return ["  ".join(f"{name} {count:,}" for name, count in total.items()) or "none"]
    lines = []
    for role, row in summary.frames_to.items():
        if role != "nobody":
            parts = [f"{name} {n:,}" for name, n in row.items() if n and name != "sent"]
            if not row["used"]:
                parts.insert(0, "used 0")
            lines.append(f"to {role}: sent {row['sent']:,} = {' + '.join(parts)}")
        elif row["sent"]:
            lines.append(f"received by no node: {row['sent']:,}")
    known = _ACCOUNTED | ({"missed", "starved"} if "lost_on_purpose" not in total else set())
    others = [f"{name} {count:,}" for name, count in total.items() if name not in known]
    return [text for text in (*lines, "  ".join(others), summary.most_cut) if text]


def _metrics(summary: Summary, width: int) -> list[str]:
    """Return names and values, those with limits first, in as many columns as fit."""
    if not summary.metrics:
        return []
    first = {*summary.judged, *summary.not_judged}
    known = sorted(summary.metrics.items(), key=lambda pair: pair[0] not in first)
    texts = [(summary.named(name), f"{value:.4g}") for name, value in known[:METRICS_SHOWN]]
    broad, high = (max(map(len, column)) for column in zip(*texts, strict=True))
    across = max((width + 2) // (broad + high + 3), 1)
    down = -(-len(texts) // across)
    lines = [
        "  ".join(f"{name:{broad}} {value:>{high}}" for name, value in texts[row::down])[:width]
        for row in range(down)
    ]
    more = [f"and {len(known) - METRICS_SHOWN} more, see summary.json"]
    return lines + more * (len(known) > METRICS_SHOWN)
