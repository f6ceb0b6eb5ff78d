"""Where compiled code is kept: a folder named after a hash of the sources (no numba in here).

numba's own cache checks only the file of the compiled function, so an edit in a file that it calls
would go unnoticed and the old code would run.

    $NUMBA_CACHE_DIR, else $XDG_CACHE_HOME/pcpc/compiled/HASH, else ~/.cache/pcpc/compiled/HASH
    <temporary folder>/pcpc-UID/compiled/HASH    where the first one cannot be written

Code in them is run, so neither may belong to anybody but this user or root.
"""

import hashlib
import importlib.metadata
import os
import stat
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

FUNCTIONS = 150  # compiled by a first start of the barrel, in about half a minute
_PROJECT = Path(__file__).resolve().parent.parent
_COMPILED_FOLDERS = ("drivers", "executive", "plants")
_INTO_CODE = (".py", ".csv", ".txt", ".npy", ".npz", ".mat")  # modules, and tables they may read


class _Watch:
    """Whom this process tells that it compiles: before each function, with those done so far."""

    def __init__(self) -> None:
        self.listener: Callable[[int], None] | None = None
        self.done = 0


watch = _Watch()


@cache
def source_hash() -> str:
    """Return 16 hex digits over what gets into compiled code, numba's and Python's version."""
    digest = hashlib.sha256(importlib.metadata.version("numba").encode())
    digest.update(sys.version.encode())
    for folder in _COMPILED_FOLDERS:
        for path in sorted((_PROJECT / folder).rglob("*.*")):
            if path.suffix in _INTO_CODE and path.is_file():
                digest.update(str(path.relative_to(_PROJECT)).encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def place(file: str) -> str:
    """Return the subfolder for the code of one of these sources; "" for a file that is none.

    It is the same in every copy of the project with equal sources, wherever that lies.
    """
    path = Path(file).resolve()
    if not any(path.is_relative_to(_PROJECT / folder) for folder in _COMPILED_FOLDERS):
        return ""
    return "_".join((*path.parent.relative_to(_PROJECT).parts, source_hash()))


def user_cache() -> Path | None:
    """Return the folder for this user's caches; None without a home."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or "")
    if not base.is_absolute():
        try:
            base = Path.home() / ".cache"
        except RuntimeError:  # neither $HOME nor an entry in /etc/passwd: a container's user
            return None
    return base if base.is_absolute() else None


def cache_folder() -> Path:
    """Return the folder of compiled code for the present sources (not created here)."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    if named:
        return Path(named)
    base = user_cache()
    return temporary_folder() if base is None else base / "pcpc" / "compiled" / source_hash()


def temporary_folder() -> Path:
    """Return the folder that takes what `cache_folder` cannot (not created here)."""
    try:
        base = tempfile.gettempdir()
    except FileNotFoundError:
        base = "/tmp"
    return Path(base, f"pcpc-{os.geteuid()}", "compiled", source_hash())


def folders() -> list[Path]:
    """Return the folders to read from and to write into, in this order."""
    return [f for f in dict.fromkeys((cache_folder(), temporary_folder())) if not distrust(f)]


def distrust(folder: Path) -> str:
    """Return why code in `folder`, or in what will be made there, is not run; "" if it is."""
    for path in (folder, *folder.parents):
        try:
            found = path.stat()
        except OSError:
            continue
        if found.st_uid not in (0, os.geteuid()):
            return f"{path} belongs to user {found.st_uid}"
        if path == folder and found.st_mode & stat.S_IWOTH:
            return f"everybody may write into {path}"
        return "" if stat.S_ISDIR(found.st_mode) else f"{path} is no folder"
    return ""


def make(folder: Path) -> None:
    """Make a folder for compiled code, for this user alone where others could; OSError."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    for path in (None, *reversed(missing)):
        if path is not None:
            path.mkdir(mode=0o700, exist_ok=True)
        if why := distrust(folder):  # before, and what somebody else made meanwhile
            raise PermissionError(1, why)


def made(name: str) -> Path:
    """Return a folder `name` to write into, in the first one that takes it; OSError."""
    wanted = folders()
    for folder in wanted:
        try:
            make(folder / name)
            tempfile.TemporaryFile(dir=folder / name).close()
            return folder / name
        except OSError:
            if folder == wanted[-1]:
                raise
    raise PermissionError(1, distrust(cache_folder()), str(cache_folder()))


def count() -> int:
    """Return how many functions are compiled for the present sources."""
    found = 0
    for folder in folders():
        try:
            found += sum(1 for _ in folder.rglob("*.nbc"))
        except OSError:  # a part of it went away
            continue
    return found
