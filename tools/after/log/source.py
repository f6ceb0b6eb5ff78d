"""A log as the sub-commands of `pcpc log` get it: named on the command line, read as a stream."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from pcpc.executive.log import reader as logs
from pcpc.executive.log.mcap_reader import Piece, Scan, walk
from pcpc.executive.log.mcap_records import message_dtype
from pcpc.tools.terminal.progress import Progress

_PATIENCE_S = 1.0


def stream(path: Path, scanned: Scan, progress: Progress) -> Iterator[Piece]:
    """Yield the messages of a log as they come, and show how far it is; LogError."""
    watch = Watch(path, progress)
    for piece in walk(path, scanned):
        watch(scanned)
        yield piece


class Watch:
    """Shows how much of a file is read, once that has taken a second."""

    def __init__(self, path: Path, progress: Progress) -> None:
        self._path, self._progress = path, progress
        self._from_s = time.monotonic() + _PATIENCE_S

    def __call__(self, found: Scan) -> None:
        """Show how far `found` is."""
        self.say(f"{found.place >> 20} of {found.size >> 20} MiB")

    def say(self, text: str) -> None:
        """Show `text` behind the name of the file."""
        if self._progress.due() and time.monotonic() > self._from_s:
            self._progress.show(f"{self._path}: {text}")


def read(path: Path, progress: Progress) -> logs.Log:
    """Return a whole log as `executive.log.reader` reads it, and show how far it is; LogError."""
    scanned = Scan()
    scanned.pieces.extend(stream(path, scanned, progress))
    with progress.going_on(f"{path}: sorting its messages"):
        log = logs.assemble(path, scanned)
    progress.close()
    return log


def messages(piece: NDArray[Any]) -> NDArray[Any]:
    """Return a piece as one structured array (n,) of `message_dtype`."""
    return piece.view(message_dtype(piece.shape[1] - message_dtype(0).itemsize))[:, 0]
