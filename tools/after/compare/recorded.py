"""Runs that were recorded: two of them, or two folders of runs rig by rig."""

from pathlib import Path

from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.tools.after.compare.comparison import Comparison
from pcpc.tools.after.compare.overlay import Criteria, compared_pair
from pcpc.tools.after.compare.pair import ALONE, FAILED, Pair, fact
from pcpc.tools.after.log.recorded import log_of
from pcpc.tools.after.log.series import LARGE_BYTES
from pcpc.tools.start.folder import LOG
from pcpc.tools.terminal.progress import Progress

Key = tuple[str, str]  # rig, controller


def recorded_comparison(old: str, new: str, how: Criteria, progress: Progress) -> Comparison:
    """Compare two runs, or two folders of runs: of each rig and controller the newest one."""
    if not any(_holds_runs(Path(text)) for text in (old, new)):
        logs_of = log_of(old), log_of(new)
        if sum(log.stat().st_size for log in logs_of if log.is_file()) > LARGE_BYTES:
            progress.show(f"reading {old} and {new}")
        found = Comparison(old, new, [compared_pair(*logs_of, how)])
        progress.close()
        return found
    found = Comparison(old, new)
    ours, theirs = (_newest(text, found) for text in (old, new))
    keys = sorted({*ours, *theirs})
    for number, key in enumerate(keys):
        progress.show(f"comparing {number + 1}/{len(keys)}: {', '.join(key)}")
        if key in ours and key in theirs:
            found.pairs.append(_pair(key, ours[key], theirs[key], how))
        else:
            side, log = (old, ours[key]) if key in ours else (new, theirs[key])
            found.pairs.append(Pair(*key, ALONE, [f"only in {side}: {log}"]))
    progress.close()
    return found


def _pair(key: Key, old: Path, new: Path, how: Criteria) -> Pair:
    try:
        return compared_pair(old, new, how)
    except logs.LogError as error:
        return Pair(*key, FAILED, [str(error)])


def _holds_runs(path: Path) -> bool:
    """Return whether this is a folder of runs, and no run itself."""
    return path.is_dir() and not (path / LOG).exists()


def _newest(text: str, told: Comparison) -> dict[Key, Path]:
    """Return the newest log of each rig and controller; RigError if there is none.

    Those that cannot be read are `told` as not compared.
    """
    whole = _holds_runs(Path(text))
    paths = sorted(Path(text).rglob("*.mcap")) if whole else [log_of(text)]
    found: dict[Key, tuple[int, Path]] = {}
    for path in (path for path in paths if path.stat().st_size):
        try:
            head = logs.head(path)
        except logs.LogError as error:
            told.pairs.append(Pair(str(path), "", FAILED, [str(error)]))
            continue
        key = fact(head, "rig"), fact(head, "controller")
        begin_ns = int(fact(head, "clock_wall_ns") or 0)
        found[key] = max(found.get(key, (0, path)), (begin_ns, path))
    if not found:
        raise RigError(f"{text}: no log in this folder; name a run, or a folder that holds some")
    return {key: path for key, (_, path) in found.items()}
