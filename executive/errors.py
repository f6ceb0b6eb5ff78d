"""What a user gets to see instead of a traceback, and the suggestion at its end."""

import errno
import os
import re
from collections.abc import Callable, Iterable, Sequence
from difflib import SequenceMatcher
from functools import lru_cache
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # of a disk: what was to be kept is missing
_NO_NAME = (errno.ENAMETOOLONG, errno.ELOOP)  # no machine could open it
_CLOSE = 0.6  # difflib's own cutoff
_CONTROL = re.compile("[\0-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")
_LIST_AT_MOST = 8  # candidates that still fit in one line


class RigError(UserError):
    """A rig file, or an option that overrides it, is wrong.

    The message is ready to print: `file:line:column: path: what; cure`, in one line.
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def code_of(error: OSError) -> Exit:
    """Return the exit code for what the machine refused."""
    if error.errno in _NO_NAME:
        return Exit.WRONG_INPUT
    return Exit.LOSS if error.errno in FULL else Exit.ENVIRONMENT


def one_line(text: str) -> str:
    """Return `text` with what would break its line or hide a part of it in written form."""
    return _CONTROL.sub(lambda found: ascii(found[0])[1:-1], text)


def did_you_mean(word: str, candidates: Iterable[str]) -> str:
    """Return `; did you mean X?`, else `; known: A, B` if few are known, else nothing.

    A candidate is also compared without its unit: `kvv` finds `kv_Nms_rad`.
    """
    known = list(dict.fromkeys(candidates))
    if best := _nearest(word, known):
        return f"; did you mean {best}?"
    return f"; known: {', '.join(known)}" if 0 < len(known) <= _LIST_AT_MOST else ""


def display_path(file: Path) -> str:
    """Return the path of `file` as messages show it: relative below the working directory."""
    try:
        return _path_below(file, os.getcwd())
    except OSError:  # it is gone
        return str(file)


@lru_cache(maxsize=64)  # every value of a rig has a place
def _path_below(file: Path, folder: str) -> str:
    return str(file.relative_to(folder) if file.is_relative_to(folder) else file)


def near_file(path: Path, would_do: Callable[[Path], bool] = Path.is_file) -> str:
    """Return `; did you mean X?` for a file that is not there, `; there is no folder Y`, or "".

    X is another file beside it, one that `would_do`.
    """
    try:
        beside = os.listdir(path.parent)
    except (OSError, ValueError):
        return f"; there is no folder {one_line(str(path.parent))}"
    names = [
        name
        for name in sorted(beside)
        if not name.startswith(".") and name != path.name and would_do(path.parent / name)
    ]
    best = _nearest(path.name, names)
    if not _nearest(path.stem, [Path(best).stem]):  # only their suffixes are alike
        return ""
    return f"; did you mean {one_line(str(path.parent / best))}?"


def _nearest(word: str, known: Sequence[str]) -> str:
    """Return the name that is like `word`, or ""."""
    best = max(known, key=lambda name: _likeness(word, name), default="")
    return best if best and _likeness(word, best) >= _CLOSE else ""


def _likeness(word: str, name: str) -> float:
    parts = name.split("_") if "/" not in name else [name]  # a unit is no folder
    stems = ["_".join(parts[:n]) for n in range(1, len(parts) + 1) if parts[0]] or [name]
    scores = [SequenceMatcher(None, word.lower(), stem.lower()).ratio() for stem in stems]
    return max(scores[-1], *(0.95 * score for score in scores))  # the whole name wins a tie
