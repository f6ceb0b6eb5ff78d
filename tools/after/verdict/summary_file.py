"""summary.json: what a run came to, bound to the log and the figure that lie beside it.

`bound` holds the SHA-256 of these files and of the summary's own text. A summary that was changed,
or lies beside another log, is none: who asks judges the log anew.
"""

import contextlib
import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pcpc.tools.after.verdict.summary import Summary, note_missing
from pcpc.tools.start.folder import LOG
from pcpc.tools.terminal.outfile import whole_file

NAME, FIGURE = "summary.json", "figure.png"
_MOST_BYTES = 1 << 24
_WORDS = {"value", "limit", "margin"}  # of a requirement: numbers, "inf" and "nan" among them


def write_json(summary: Summary, path: Path) -> str:
    """Write summary.json, see `text_of`, if that can be; return its text."""
    summary.pop("bound", None)
    files = {name: digest for name in (LOG, FIGURE) if (digest := _digest(path.with_name(name)))}
    summary["bound"] = {**files, NAME: _seal(summary, files)}
    try:
        with whole_file(path) as unfinished:
            unfinished.write_text(text_of(summary) + "\n")
    except OSError as error:
        note_missing(summary, path, error)
    return text_of(summary)


def beside(log: Path) -> Summary | None:
    """Return the summary that lies beside a log and is of it; None for none."""
    try:
        path = log.with_name(NAME)
        if not path.is_file() or path.stat().st_size > _MOST_BYTES:
            return None
        summary = dict(json.loads(path.read_text("utf-8")))
        bound = {str(key): str(value) for key, value in dict(summary.pop("bound")).items()}
        seal = bound.pop(NAME)
        if seal != _seal(summary, bound) or bound[LOG] != _digest(log):
            return None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    summary["bound"] = {**bound, NAME: seal}
    metrics = summary.get("metrics", {}).items()
    summary["metrics"] = {k: math.nan if v is None else float(v) for k, v in metrics}
    for one in summary.get("requirements", ()):
        one |= {key: float(one[key]) for key in _WORDS if one.get(key) is not None}
    return summary


def figure_beside(log: Path, summary: Mapping[str, Any]) -> bytes:
    """Return the figure of a run's end that its summary is bound to; b"" for none."""
    path, known = log.with_name(FIGURE), summary.get("bound", {}).get(FIGURE)
    return path.read_bytes() if known and _digest(path) == known else b""


def text_of(summary: Mapping[str, Any]) -> str:
    """Return a summary as JSON, which has no word for them: with "inf", "-inf", "nan" as text."""
    return json.dumps(_told(summary), indent=2)


def _seal(summary: Mapping[str, Any], files: Mapping[str, str]) -> str:
    return hashlib.sha256(text_of({**summary, "bound": files}).encode()).hexdigest()


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file, "" if it cannot be had."""
    with contextlib.suppress(OSError):
        if path.is_file():
            with path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
    return ""


def _told(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _told(child) for key, child in value.items()}
    if isinstance(value, list | tuple):
        return [_told(child) for child in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
