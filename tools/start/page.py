"""What is served beside a run: by each room that has a run_page.py, as live/host; else nothing."""

import argparse
from pathlib import Path
from types import TracebackType

from pcpc.tools.terminal.rooms import parts_called

SAID = "page: "  # before its address


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


class Pages(NoPage):
    """Those of all rooms, as one."""

    def __init__(self, options: argparse.Namespace, node: str) -> None:
        self._pages: list[NoPage] = []
        try:
            for room in parts_called("run_page"):
                self._pages.append(room.Page(options, node))
        except BaseException:
            self.end()
            raise

    def start(self) -> None:
        """Begin to serve, and tell where."""
        for one in self._pages:
            one.start()

    def end(self) -> None:
        """End with the run."""
        for one in self._pages:
            one.end()

    def ended(self) -> str:
        """Return what to say where one has ended before the run, once; else ""."""
        return "\n".join(filter(None, [one.ended() for one in self._pages]))

    def farewell(self, folder: Path) -> None:
        """Tell how the log is shown, where the run had a page."""
        for one in self._pages:
            one.farewell(folder)
