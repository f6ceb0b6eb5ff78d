"""What is served beside a run: by each room that has a run_page.py, as live/host; else nothing."""

import argparse
from pathlib import Path
from types import TracebackType

from pcpc.tools.start.children import Child
from pcpc.tools.terminal.rooms import parts_called

SAID = "page: "  # before its address
_END_S = 2.0


class NoPage:
    """The page of a run that has none; what others have in common, a process of its own.

    ENDED: what to say where it has ended before the run, with the reason as {}. FAILS_ONLY: not
    where it has come to its end.
    """

    ENDED, FAILS_ONLY = "", False
    _child: Child | None = None

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
        if self._child is not None:
            self._child.end(0.0, _END_S)

    def ended(self) -> str:
        """Return what to say where the page has ended before the run, once; else ""."""
        child = self._child
        if child is None or not child.ended or (self.FAILS_ONLY and not child.code):
            return ""
        why = child.complaint()[-1:] or [f"exit code {child.code}"]
        self._child = None
        return self.ENDED.format(why[0])

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
