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

import msgspec

from pcpc.tools.after.verdict.summary import Summary
from pcpc.tools.start.folder import LOG
from pcpc.tools.terminal.outfile import whole_file

NAME, FIGURE = "summary.json", "figure.png"
_MOST_BYTES = 1 << 24


def write_json(summary: Summary, path: Path) -> str:
    """Write summary.json, see `text_of`, if that can be; return its text."""
    files = {name: digest for name in (LOG, FIGURE) if (digest := _digest(path.with_name(name)))}
    summary.bound = {**files, NAME: _seal(plain(summary), files)}
    try:
        with whole_file(path) as unfinished:
            unfinished.write_text(text_of(plain(summary)) + "\n")
    except OSError as error:
        summary.note_missing(path, error)
    return text_of(plain(summary))


def summary_beside(log: Path) -> Summary | None:
    """Return the summary that lies beside a log and is of it; None for none."""
    try:
        path = log.with_name(NAME)
        if not path.is_file() or path.stat().st_size > _MOST_BYTES:
            return None
        found = dict(json.loads(path.read_text("utf-8")))
        bound = {str(key): str(value) for key, value in dict(found["bound"]).items()}
        if bound.pop(NAME) != _seal(found, bound) or bound[LOG] != _digest(log):
            return None
        return from_json(found)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None


def from_json(found: Mapping[str, Any]) -> Summary:
    """Return a summary as summary.json has it: with "nan" and "inf", of older files None."""
    metrics = {k: "nan" if v is None else v for k, v in found["metrics"].items()}
    return msgspec.convert({**found, "metrics": metrics}, Summary, strict=False)


def figure_beside(log: Path, summary: Summary) -> bytes:
    """Return the figure of a run's end that its summary is bound to; b"" for none."""
    path, known = log.with_name(FIGURE), (summary.bound or {}).get(FIGURE)
    return path.read_bytes() if known and _digest(path) == known else b""


def plain(summary: Summary) -> dict[str, Any]:
    """Return a summary as summary.json has it, but with numbers for NaN and infinity."""
    return dict(msgspec.to_builtins(summary))


def text_of(summary: Mapping[str, Any] | list[Any]) -> str:
    """Return a summary or a part as JSON, which has no word for them: they become text."""
    return json.dumps(_json_value(summary), indent=2)


def _seal(summary: Mapping[str, Any], files: Mapping[str, str]) -> str:
    return hashlib.sha256(text_of({**summary, "bound": files}).encode()).hexdigest()


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file, "" if it cannot be had."""
    with contextlib.suppress(OSError):
        if path.is_file():
            with path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
    return ""


def _json_value(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _json_value(child) for key, child in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(child) for child in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
