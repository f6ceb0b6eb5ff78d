"""Where compiled code is kept: a folder named after a hash of the sources (no numba in here).

numba's own cache checks only the file of the compiled function, so an edit in a file that it calls
would go unnoticed and the old code would run. HASH is that of drivers and executive, which call
nothing of plants; the names in it of plants' code and of users' have a hash of plants, too: with
an edit of a plant's law the loop need not be compiled again.

    $NUMBA_CACHE_DIR/HASH, else $XDG_CACHE_HOME/pcpc/compiled/HASH, else ~/.cache/...
    <temporary folder>/pcpc-UID/compiled/HASH    where the first one cannot be written
    drivers/compiled/shipped/MACHINE/HASH        read only: what a released wheel brings

Code in them is run, so none may belong to anybody but this user or root.
"""

import hashlib
import importlib.metadata
import os
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

SHORT_S = 2.0  # of compiling, or of waiting for who does: a user's law takes less, no word
FUNCTIONS = 180  # compiled by a first start of the barrel, in about 20 s on two processors
_PROJECT = Path(__file__).resolve().parents[2]
SHIPPED = Path(__file__).resolve().parent / "shipped"  # `make release` fills it
_CORE = ("drivers", "executive")
_COMPILED_FOLDERS = (*_CORE, "plants")
_INTO_CODE = (".py", ".csv", ".txt", ".npy", ".npz", ".mat")  # modules, and tables they may read


class _Watch:
    """Whom this process tells that it compiles: before each function, with those done so far.

    Or that it waits, with the process that compiles.
    """

    def __init__(self) -> None:
        self.listener: Callable[..., None] | None = None
        self.done = 0
        self.helper = 0  # the process that compiles for this one
        self._named: set[str] = set()

    def tell_holder(self, process: str) -> None:
        """Tell for which process this one waits, once, but for its own helper."""
        known = {*self._named, str(self.helper)}
        if self.listener is not None and process not in known:
            self._named.add(process)
            self.listener(self.done, process)


watch = _Watch()


def source_hash() -> str:
    """Return 16 hex digits over what gets into the loop's code, numba's and Python's version."""
    return _source_hash(_CORE)


def full_hash() -> str:
    """Return 16 hex digits over what gets into any code, plants' too."""
    return _source_hash(_COMPILED_FOLDERS)


@cache
def _source_hash(areas: tuple[str, ...]) -> str:
    digest = hashlib.sha256(importlib.metadata.version("numba").encode())
    digest.update(f"{sys.implementation.cache_tag} {sys.flags.optimize}".encode())
    for folder in areas:
        files = (
            os.path.join(at, name)
            for at, _, names in os.walk(_PROJECT / folder)
            for name in names
            if name.endswith(_INTO_CODE)
        )
        for file in filter(os.path.isfile, sorted(files)):
            with open(file, "rb") as content:
                digest.update(os.path.relpath(file, _PROJECT).encode() + content.read())
    return digest.hexdigest()[:16]


_by_content: dict[str, str] = {}  # files of users' laws, and what their code is kept by
_lies_at: dict[str, str] = {}  # folders in which such code was compiled, and where its file is now


def keep_by(file: Path, name: str) -> None:
    """Let the code of a user's file be kept by `name`, wherever an equal file lies; "": by path."""
    _by_content[str(file.resolve())] = name


def was_compiled(there: str, here: str) -> None:
    """Note that code of the file `here` was compiled when it lay elsewhere."""
    _lies_at[os.path.dirname(there)] = os.path.dirname(here)


def present_place(file: str) -> str:
    """Return where a file lies that compiled code names."""
    folder, name = os.path.split(file)
    return os.path.join(_lies_at.get(folder, folder), name)


def place(file: str) -> str:
    """Return the subfolder for the code of a file; "" for one that is kept by its path.

    It is the same in every copy of the project with equal sources, wherever that lies.
    """
    path = Path(file).resolve()
    if name := _by_content.get(str(path)):
        return "_".join((name, full_hash()))
    if not any(path.is_relative_to(_PROJECT / folder) for folder in _COMPILED_FOLDERS):
        return ""
    parts = path.parent.relative_to(_PROJECT).parts
    return "_".join((*parts, source_hash() if parts[0] in _CORE else full_hash()))


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
        return Path(named) / source_hash()
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


def shipped_folders() -> list[Path]:
    """Return the folder of code that came with the present sources, if there is one."""
    folder = SHIPPED / os.uname().machine / source_hash()
    return [folder] if folder.is_dir() and not distrust(folder) else []


def distrust(folder: Path) -> str:
    """Return why code in `folder`, or in what will be made there, is not run; "" if it is."""
    for path in (folder, *folder.parents):
        try:
            status = path.stat()
        except OSError:
            continue
        if status.st_uid not in (0, os.geteuid()):
            return f"{path} belongs to user {status.st_uid}"
        if path == folder and status.st_mode & stat.S_IWOTH:
            return f"everybody may write into {path}"
        return "" if stat.S_ISDIR(status.st_mode) else f"{path} is not a folder"
    return ""


def make(folder: Path) -> None:
    """Make a folder for compiled code, for this user alone where others could; OSError."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    for path in (None, *reversed(missing)):
        if path is not None:
            path.mkdir(mode=0o700, exist_ok=True)
        if why := distrust(folder):  # before, and what somebody else made meanwhile
            raise PermissionError(1, why)


def writable_folder(name: str) -> Path:
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


def count(since_s: float) -> int:
    """Return how many functions were compiled for the present sources since then (Unix time)."""
    files = (path for folder in folders() for path in _compiled_files(folder))
    return sum(_written_s(path) >= since_s for path in files)


def used_folder() -> Path | None:
    """Return the first folder that has code compiled for the present sources; None for none."""
    every = (*folders(), *shipped_folders())
    return next((folder for folder in every if any(_compiled_files(folder))), None)


def is_empty() -> bool:
    """Return whether nothing is compiled for the present sources, here or in what was shipped."""
    return used_folder() is None


def _compiled_files(folder: Path) -> Iterator[str]:
    """Find the files with functions that were compiled here."""
    for at, _, names in os.walk(folder):
        yield from (os.path.join(at, name) for name in names if name.endswith(".nbc"))


def _written_s(path: str) -> float:
    try:
        return os.stat(path).st_mtime
    except OSError:  # cleared away meanwhile
        return 0.0
