"""A git repository: its working tree, and another version of it in a folder of its own.

A version is written out with an index of its own, so that nothing of the repository changes: no
branch, no worktree, no stash. The folder is named after commit and repository, so that compiled
code of a user's laws is found again the next time; it is held by a lock, removed at the end, and
by the next start if this one is killed.
"""

import fcntl
import hashlib
import itertools
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from pcpc.drivers.compiled import compile_cache
from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import one_line

_NEW = ("ls-files", "-z", "--others", "--exclude-standard", "--exclude=__pycache__/")
_OF_A_HOOK = (
    "GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE", "GIT_PREFIX", "GIT_COMMON_DIR", "GIT_NAMESPACE",
)  # fmt: skip
ALIVE = "alive"  # a file in the folder, locked by everything that still writes into it


class GitError(UserError):
    """What git refused, in its own words."""


@dataclass(frozen=True)
class Repository:
    """The repository around a folder."""

    root: Path

    @classmethod
    def around(cls, folder: Path = Path()) -> "Repository":
        """Return the one that holds a folder; GitError."""
        try:
            return cls(Path(_git(folder, "rev-parse", "--show-toplevel").rstrip("\n")).resolve())
        except GitError as error:
            if "not a git repository" not in str(error):
                raise
            what = "not in a git repository, so it has no versions; `git init` and commit it"
            raise GitError(f"{folder.resolve()}: {what}") from None

    @property
    def mark(self) -> str:
        """What the names of its folders hold, and no other repository's."""
        return hashlib.sha256(str(self.root).encode()).hexdigest()[:8]

    def git(self, *words: str) -> str:
        """Return what git prints here; GitError."""
        return _git(self.root, *words)

    def commit(self, ref: str, option: str = "--against ") -> str:
        """Return the hash of a version; GitError, which names the option that gave it."""
        try:
            words = ("rev-parse", "--verify", "--end-of-options", f"{ref}^{{commit}}")
            return _git(self.root, *words).strip()
        except GitError as error:
            cure = "`git log` lists versions; a shallow clone gets more by `git fetch --unshallow`"
            raise GitError(one_line(f"{option}{ref}: {error}; {cure}"), error.code) from None

    def files(self) -> list[str]:
        """Return the files of the working tree that are tracked, or could be."""
        names = self._names(*_NEW, "--cached")
        return sorted(name for name in names if (self.root / name).is_file())

    def files_of(self, commit: str) -> list[str]:
        """Return the files of a version."""
        return sorted(self._names("ls-tree", "-r", "-z", "--name-only", commit))

    def changed(self, commit: str) -> list[str]:
        """Return the files in which the working tree differs from a version."""
        tracked = self._names("diff", "--name-only", "--no-renames", "-z", commit, "--")
        return sorted(tracked | self._names(*_NEW))

    def _names(self, *words: str) -> set[str]:
        """Return the files that git lists."""
        return {name for name in _git(self.root, *words).split("\0") if name}

    @contextmanager
    def checked_out(self, commit: str) -> Iterator[Path]:
        """Give a folder with the files of a version in `tree/`; it is gone at the end."""
        with _claimed_folder(f"{commit[:12]}-{self.mark}") as folder:
            (tree := folder / "tree").mkdir()
            own = _git(self.root, "rev-parse", "--absolute-git-dir").rstrip("\n")
            git_paths = {"GIT_DIR": own, "GIT_WORK_TREE": str(tree)}
            git_paths |= {"GIT_INDEX_FILE": str(folder / "index")}
            _git(tree, "read-tree", commit, environment=git_paths)
            _git(tree, "checkout-index", "--all", "--quiet", environment=git_paths)
            yield folder


def _git(folder: Path, *words: str, environment: dict[str, str] | None = None) -> str:
    """Return what git prints; GitError, in its words."""
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), "-c", "core.fsmonitor=false", *words],
            capture_output=True,
            check=True,
            stdin=subprocess.DEVNULL,
            env=_surroundings() | (environment or {}),
        )
    except FileNotFoundError:
        problem = "git: no such program; install it, as with `sudo apt-get install git`"
        raise GitError(problem, Exit.ENVIRONMENT) from None
    except subprocess.CalledProcessError as error:
        lines = os.fsdecode(error.stderr).strip().splitlines() or [f"exit code {error.returncode}"]
        code = Exit.LOSS if "No space left on device" in lines[0] else None
        cure = "; `git config --global --add safe.directory FOLDER` trusts it"
        problem = lines[0].removeprefix("fatal: ") + cure * ("dubious ownership" in lines[0])
        raise GitError(one_line(f"git: {problem}"), code) from None
    return os.fsdecode(done.stdout)


def _surroundings() -> dict[str, str]:
    """Return the environment of git: not that of a hook, and the index is only read."""
    found = {key: value for key, value in os.environ.items() if key not in _OF_A_HOOK}
    return found | {"GIT_OPTIONAL_LOCKS": "0", "LC_ALL": "C"}


@contextmanager
def _claimed_folder(name: str) -> Iterator[Path]:
    """Give an empty folder of this name that nobody else uses; OSError."""
    base = Path(tempfile.gettempdir()).resolve() / f"pcpc-{os.geteuid()}" / "compare"
    compile_cache.make(base)
    for leftover in base.glob("*.lock"):
        with _locked_file(leftover) as lock:
            if lock is not None:
                _remove(leftover)
    for number in itertools.count(1):
        path = base / (f"{name}.lock" if number == 1 else f"{name}-{number}.lock")
        with _locked_file(path) as lock:
            if lock is None:
                continue
            folder = path.with_suffix("")
            folder.mkdir(mode=0o700)
            (folder / ALIVE).touch()
            try:
                yield folder
            finally:
                with (folder / ALIVE).open() as alive:
                    fcntl.flock(alive, fcntl.LOCK_EX)  # until the last process is gone
                _remove(path)
            return


@contextmanager
def _locked_file(path: Path) -> Iterator[IO[str] | None]:
    """Give the locked file; None if somebody else holds it, or has just removed it."""
    with path.open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield None
            return
        with suppress(FileNotFoundError):
            if os.fstat(lock.fileno()).st_ino == path.stat().st_ino:
                yield lock
                return
        yield None


def _remove(lock: Path) -> None:
    """Remove what a lock stands for, and the lock."""
    shutil.rmtree(lock.with_suffix(""), ignore_errors=True)
    lock.unlink(missing_ok=True)
