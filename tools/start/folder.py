"""The folder of a run: made before its first cycle, gone again when nothing came of it.

What a command makes under `runs` is its own, also where several start in the same second.
"""

import contextlib
import itertools
import os
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from pcpc.executive.errors import FULL, RigError
from pcpc.executive.rig.reading import Rig

LOG, LINE = "log.mcap", "line.json"


def fresh(name: str) -> Path:
    """Make runs/<UTC time>-NAME, which no other command has; RigError if that cannot be."""
    for folder in _names(name):
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            continue
        except OSError as error:
            raise _refusal(folder, error) from None
    raise AssertionError("there is always another name")


@contextlib.contextmanager
def folder_of(named: str | None, name: str, empty: bool = False) -> Iterator[Path]:
    """Make the folder that a user names, else a fresh one; RigError if that cannot be.

    Nor if it has to be `empty` and is not. At the end what was made here and is still empty is
    removed.
    """
    check_name(named)
    made = _absent(Path(named or "runs"))
    folder = Path(named) if named else fresh(name)
    made = made if named else [folder, *made]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _check_links(folder)
        with tempfile.TemporaryFile(dir=folder):  # whether anything can be written there
            pass
    except OSError as error:
        raise _refusal(folder, error) from None
    if empty and any(folder.iterdir()):
        raise RigError(f"{folder}: is not empty; choose another folder with -o")
    try:
        yield folder
    finally:
        _remove_empty(made)


def check_name(named: str | Path | None) -> None:
    """Raise RigError for an empty name, as that of a variable that is not set."""
    if named is not None and (not str(named) or "\0" in str(named)):
        raise RigError(f"-o {str(named)!r}: expected a folder")


def _names(name: str) -> Iterator[Path]:
    """Yield names for what starts now, with a number where others start in the same second."""
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    for number in itertools.count(1):
        yield Path("runs") / (f"{stamp}-{name}" + (f"-{number}" if number > 1 else ""))


def _check_links(folder: Path) -> None:
    """Raise RigError for a link in place of a file: a run would write to where it leads."""
    for path in folder.iterdir():
        if path.is_symlink() and not path.is_dir():
            raise RigError(f"{path}: is a link; remove it, or choose another folder with -o")


def _absent(folder: Path) -> list[Path]:
    """Return what of a path is not there, the last part first."""
    return [path for path in (folder, *folder.parents) if not os.path.exists(path)]


def _remove_empty(made: list[Path]) -> None:
    with contextlib.suppress(OSError):  # not empty: it stays
        for path in made:
            path.rmdir()


def _refusal(folder: Path, error: OSError) -> Exception:
    if error.errno in FULL:
        return OSError(error.errno, error.strerror, str(folder))
    return RigError(f"{folder}: {error.strerror}; choose another folder with -o")


@contextlib.contextmanager
def run_folder(named: str | Path | None, rig: Rig) -> Iterator[Path]:
    """Make the run's folder with an empty log, which claims it; RigError if that cannot be.

    At the end what is still empty is removed; of a run without a cycle its line's record, too.
    """
    check_name(named)
    for own in _names(rig.config.rig):
        folder = Path(named or own)
        made = _absent(folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _check_links(folder)
            (folder / LOG).touch(exist_ok=False)
            break
        except FileExistsError:
            if named:
                what = "holds a log already" if folder.is_dir() else "is not a folder"
                raise RigError(f"{folder}: {what}; choose another folder with -o") from None
        except OSError as error:
            raise _refusal(folder, error) from None
    had_line = (folder / LINE).exists()
    try:
        yield folder
    finally:
        if not (folder / LOG).stat().st_size:
            (folder / LOG).unlink()
            if not had_line:
                (folder / LINE).unlink(missing_ok=True)
        _remove_empty(made)
