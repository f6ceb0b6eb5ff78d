"""A log as a command line names it: a file, a run folder, or `latest`."""

import os
from collections.abc import Iterator
from pathlib import Path

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import RigError, did_you_mean

LATEST = "latest"
RUNS = Path("runs")
_LOG, _SUMMARY = "log.mcap", "summary.json"
_CURE = "; name a log, a run folder or `latest`"


def log_of(text: str) -> Path:
    """Return the log file that `text` names; RigError if that cannot be told.

    `latest` is the newest run below runs/, unless something here has this name.
    """
    if not text.strip():
        raise RigError("an empty name is not a log; `.` is this folder")
    path = Path(text)
    if text == LATEST and not path.exists():
        return _newest()
    if not path.exists():
        raise RigError(f"{text}: {no_log(text)}")
    if not path.is_dir() or (path / _LOG).exists():
        return path / _LOG if path.is_dir() else path
    logs = sorted(path.glob("*.mcap"))
    if len(logs) == 1:
        return logs[0]
    what = f"holds {len(logs)} logs; name one of them" if logs else f"holds no {_LOG}"
    raise RigError(f"{path}: this folder {what}")


def holds_several(text: str) -> bool:
    """Return whether it names a folder that is no run's, and does not hold just one log."""
    folder = Path(text)
    return folder.is_dir() and not (folder / _LOG).exists() and len([*folder.glob("*.mcap")]) != 1


def folders_below(top: Path) -> Iterator[tuple[Path, list[str], list[str]]]:
    """Yield each folder from `top` on, by way of links too, each once, and its folders and files.

    UserError for one that cannot be read.
    """

    def raise_unreadable(error: OSError) -> None:
        raise UserError(f"{error.filename}: {error.strerror}; its content is not known")

    seen = set[str]()
    for text, folders, files in os.walk(top, onerror=raise_unreadable, followlinks=True):
        if (real := os.path.realpath(text)) in seen:
            folders.clear()
            continue
        seen.add(real)
        yield Path(text), folders, files


def logs_below(top: Path) -> Iterator[Path]:
    """Yield every *.mcap below a folder, and the logs that runs with a summary have lost."""
    for folder, folders, files in folders_below(top):
        lost = [_LOG] if _SUMMARY in files and _LOG not in (*files, *folders) else []
        for name in (*files, *folders, *lost):
            if name.lower().endswith(".mcap"):
                yield folder / name


def no_log(text: str) -> str:
    """Return that there is no log of this name, and which one was meant."""
    return f"no such log{did_you_mean(text, known_logs(text)) or _CURE}"


def known_logs(text: str) -> list[str]:
    """Return the names of the runs below runs/, and of the logs where `text` would lie."""
    beside = Path(text).parent
    runs = [str(path.parent) for path in RUNS.glob(f"*/{_LOG}")]
    near = [str(path.parent) for path in beside.glob(f"*/{_LOG}")]
    return sorted({*map(str, beside.glob("*.mcap")), *near, *runs, *[LATEST] * bool(runs)})


def _newest() -> Path:
    """Return the log that was written last."""
    logs = [log for log in RUNS.glob(f"*/{_LOG}") if log.is_file() and log.stat().st_size]
    if not logs:
        raise RigError(f"{LATEST}: no run below {RUNS.resolve()}; name a log or a run folder")
    return max(logs, key=lambda log: log.stat().st_mtime_ns)
