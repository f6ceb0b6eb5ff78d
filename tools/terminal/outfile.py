"""Output files that are whole or not there, and the one-line errors of `pcpc log`."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import code_of, near_file


class LogCommandError(UserError):
    """A log, or what is asked of it, cannot be had."""


@contextmanager
def new_file(
    path: Path, force: bool, cure: str = "choose another name, or overwrite it with --force"
) -> Iterator[Path]:
    """Give a file to write beside `path` that takes its place at the end, if there was no error.

    Raises LogCommandError if `path` exists and not `force`, or cannot be written.
    """
    if path.exists() and not (force and path.is_file()):
        what = f"exists; {cure}" if path.is_file() else "is no file; choose another name"
        raise LogCommandError(f"{path}: {what}")
    try:
        with whole_file(path) as unfinished:
            yield unfinished
    except OSError as error:
        what = f"{path}: cannot be written: {error.strerror}; choose another place"
        raise LogCommandError(what, code_of(error)) from None


def write_text(path: Path, text: str) -> None:
    """Write a file whole, in the place of one that is there; LogCommandError."""
    with new_file(path, force=True) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def check_file(option: str, path: Path | None) -> None:
    """Raise LogCommandError if no file can be `path`, as `option` named it; of None not."""
    if path is not None and (path.is_dir() or not path.parent.is_dir()):
        what = "is a folder" if path.is_dir() else f"there is no folder {path.parent}"
        raise LogCommandError(f"{option} {path}: {what}; choose another file")


def check_source(option: str, path: Path) -> None:
    """Raise LogCommandError if `path` is no file that is there, as `option` named it."""
    try:
        if path.exists() and not path.is_dir():
            return
        what = "is a folder; expected a file" if path.is_dir() else ""
    except (OSError, ValueError):  # no file can have this name
        what = ""
    raise LogCommandError(f"{option} {path}: {what or f'no such file{near_file(path)}'}")


def check_folder(option: str, path: Path) -> None:
    """Raise LogCommandError if no folder can be `path`, as `option` named it."""
    if path.exists() and not path.is_dir():
        raise LogCommandError(f"{option} {path}: is not a folder; choose another folder")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a file to write that takes the place of `path`, also of a link; OSError.

    Where it is removed meanwhile, or an error ends it, `path` stays what it was.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}{path.suffix}")
    try:
        unfinished.touch(exist_ok=False)
        yield unfinished
        if unfinished.exists():
            os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
