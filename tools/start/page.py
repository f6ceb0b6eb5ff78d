"""The page beside a run: that of the room live/host, where it is there; else none."""

import argparse
from pathlib import Path
from types import TracebackType
from typing import Any

from pcpc.tools.terminal.rooms import is_installed, part_of

SAID = "page: "  # before its address
_ROOM = "live/host"


class NoPage:
    """The page of a run that has none."""

    def __enter__(self) -> "NoPage":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        place: TracebackType | None,
    ) -> None:
        self.end()

    def start(self) -> None:
        """Begin to serve, and tell where."""

    def end(self) -> None:
        """End with the run."""

    def ended(self) -> str:
        """Return what to say where the page has ended before the run, once; else ""."""
        return ""

    def farewell(self, folder: Path) -> None:
        """Tell how the log is shown, where the run had a page."""


def page_of(options: argparse.Namespace, node: str) -> NoPage:
    """Return the page of a run whose leading node is `node`; UserError."""
    if not is_installed(_ROOM):
        return NoPage()
    page: Any = part_of(_ROOM, "run_page").Page(options, node)
    assert isinstance(page, NoPage)
    return page
