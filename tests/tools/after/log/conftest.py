"""Recordings are read in this process, which spares a quarter of a second each."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from math import inf
from pathlib import Path
from typing import IO

import pytest

from pcpc.tools.after.log import recording
from pcpc.tools.after.log.readers import child


@contextmanager
def _here(path: Path, channel: str | None, limits: child.ReaderLimits) -> Iterator[IO[bytes]]:
    """Give what a reader's process would write."""
    out = BytesIO()
    child.write(out, path, channel, replace(limits, stall_s=inf))
    out.seek(0)
    yield out


@pytest.fixture(autouse=True)
def _reads_here(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read so, but in tests that a file names in OWN_READERS, or in all of it."""
    own = getattr(request.module, "OWN_READERS", ())
    if own is not True and request.function.__name__ not in own:
        monkeypatch.setattr(recording, "reader", _here)
