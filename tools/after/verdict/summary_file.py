"""summary.json: what a run came to, bound to the log and the figure that lie beside it.

`bound` holds the SHA-256 of these files and of the summary's own text. A summary that was changed,
or lies beside another log, is none: who asks judges the log anew, and says so.
"""

import contextlib
import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from pcpc.executive.log import reader as logs
from pcpc.tools.after.verdict.findings import LINES, OF_THE_RIG, Finding, FindingKind, verdict_of
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.after.verdict.summary import Summary
from pcpc.tools.start.folder import LOG
from pcpc.tools.terminal.outfile import whole_file
from pcpc.tools.terminal.screen import json_text

NAME, FIGURE = "summary.json", "figure.png"
_MOST_BYTES = 1 << 24
_UNTOLD = "this run does not show it"
_DOUBT = "summary.json is not of this log: one was changed since"


def write_json(summary: Summary, path: Path) -> str:
    """Write summary.json, see `json_text`, if that can be; return its text."""
    files = {name: digest for name in (LOG, FIGURE) if (digest := _digest(path.with_name(name)))}
    summary.bound = {**files, NAME: _seal(plain(summary), files)}
    try:
        with whole_file(path) as unfinished:
            unfinished.write_text(json_text(plain(summary)) + "\n")
    except OSError as error:
        summary.note_missing(path, error)
    return json_text(plain(summary))


def beside(log: Path) -> tuple[Summary | None, str]:
    """Return the summary that lies beside a log and is of it, and why another one is none."""
    own = summary_beside(log)
    lies = own is None and os.path.lexists(log.with_name(NAME))
    return own, _DOUBT if lies else ""


def summary_beside(log: Path) -> Summary | None:
    """Return the summary that lies beside a log and is of it; None for none."""
    try:
        path = log.with_name(NAME)
        if not path.is_file() or path.stat().st_size > _MOST_BYTES:
            return None
        data = dict(json.loads(path.read_text("utf-8"), object_pairs_hook=_unique_keys))
        bound = {str(key): str(value) for key, value in dict(data["bound"]).items()}
        if bound.pop(NAME) != _seal(data, bound) or bound[LOG] != _digest(log):
            return None
        return from_json(data)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None


def from_json(data: Mapping[str, Any]) -> Summary:
    """Return a summary as summary.json has it: with "nan" and "inf", of older files None.

    Older ones call a run ok of which no limit was judged. No verdict is better than its own lines.
    """
    metrics = {k: "nan" if v is None else v for k, v in data["metrics"].items()}
    summary = msgspec.convert({**data, "metrics": metrics}, Summary, strict=False)
    told = [kind for kind, (key, _) in LINES.items() if key and getattr(summary, key)]
    told += [FindingKind.REQUIREMENT for one in summary.requirements if one.held is False]
    summary.verdict = verdict_of(map(Finding, told), summary.verdict)
    summary.enter()
    return summary


def figure_beside(log: Path, summary: Summary) -> bytes:
    """Return the figure of a run's end that its summary is bound to; b"" for none."""
    path, known = log.with_name(FIGURE), (summary.bound or {}).get(FIGURE)
    return path.read_bytes() if known and _digest(path) == known else b""


def findings_beside(summary: Summary, findings: Iterable[Finding]) -> Iterator[Finding]:
    """Yield a log's findings of limits and requirements; a worse word of `summary` counts."""
    denied = {
        (FindingKind.REQUIREMENT, one.name) for one in summary.requirements if one.held is False
    }
    for finding in findings:
        why, value = summary.not_judged.get(finding.key), summary.metrics.get(finding.key)
        if (
            finding.kind is FindingKind.LIMIT
            and value is not None
            and not finding.low <= value <= finding.high
        ):
            denied.add((finding.kind, finding.key))
        if finding.kind not in OF_THE_RIG:
            continue
        if why and (finding.kind is FindingKind.LIMIT or finding.held is not False):
            yield msgspec.structs.replace(finding, held=None, why=why)
        elif finding.held and (finding.kind, finding.key) in denied:
            yield msgspec.structs.replace(finding, held=False, why="summary.json says so")
        else:
            yield finding


def findings_of(summary: Summary, judge: Judge, log: logs.Log) -> list[Finding]:
    """Return what became of limits and requirements in a run with this summary.

    One that was read tells it of limits where nothing failed; else the log is judged again.
    """
    if summary.findings:
        return [one for one in summary.findings if one.kind in OF_THE_RIG]
    if summary.expectations_failed:
        return [*findings_beside(summary, judge.judge(log, list(summary.changed)).findings)]
    told = {True: (True, ""), False: (None, _UNTOLD)}
    limits = [
        judge.limit(name, *told[name in summary.judged], summary.metrics.get(name))
        for name in judge.rig.config.expected
    ]
    return [*findings_beside(summary, [*limits, *(one.finding for one in summary.requirements)])]


def plain(summary: Summary) -> dict[str, Any]:
    """Return a summary as summary.json has it, but with numbers for NaN and infinity."""
    return dict(msgspec.to_builtins(summary))


def _seal(summary: Mapping[str, Any], files: Mapping[str, str]) -> str:
    return hashlib.sha256(json_text({**summary, "bound": files}).encode()).hexdigest()


def _unique_keys(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of JSON; ValueError for a key that stands twice: readers differ on it."""
    if len(found := dict(pairs)) < len(pairs):
        raise ValueError("a key stands twice")
    return found


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file, "" if it cannot be had."""
    with contextlib.suppress(OSError):
        if path.is_file():
            with path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
    return ""
