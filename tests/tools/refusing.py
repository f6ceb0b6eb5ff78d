"""A fixture that holds a command line to be refused as all are."""

import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from logcommand import run_here


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return what runs wrong words in `tmp_path`: one line says why, and all else stays as it was.

    Words are a command line as it is typed, or a list of them.
    """
    monkeypatch.chdir(tmp_path)

    def files() -> dict[Path, bytes | None]:
        there = sorted(tmp_path.rglob("*"))
        return {path: path.read_bytes() if path.is_file() else None for path in there}

    def check(words: str | list[str | Path], said: str, code: int = 2) -> None:
        before = files()
        done = run_here(*(shlex.split(words) if isinstance(words, str) else words))
        assert (done.code, done.out, done.err.count("\n")) == (code, "", 1), done
        assert said in done.err and not done.err.startswith(("usage", "Traceback")), done.err
        assert files() == before, "something is left behind"

    return check
