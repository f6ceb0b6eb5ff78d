"""What is served beside a run: by each room that has a run_page.py, as live/host; else nothing."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

from pcpc.drivers.can.bus import BusAddress
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.tools.start.children import Child
from pcpc.tools.terminal.request import Offers
from pcpc.tools.terminal.rooms import parts_called

SAID = "page: "  # before its address
_END_S = 2.0


class NoPage:
    """The page of a run that has none; what others have in common, processes of their own.

    ENDED: what to say where one has ended before the run, with its {name} and the reason, {why}.
    FAILS_ONLY: not where it has come to its end.
    """

    ENDED, FAILS_ONLY = "", False
    _children: Sequence[Child] = ()

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
        for child in self._children:
            child.end(0.0, _END_S)

    def ended(self) -> str:
        """Return what to say where one has ended before the run, once; else ""."""
        for child in self._children:
            if child.ended and (child.code or not self.FAILS_ONLY):
                self._children = [one for one in self._children if one is not child]
                why = child.complaint()[-1:] or [f"exit code {child.code}"]
                return self.ENDED.format(name=child.name, why=why[0])
        return ""

    def farewell(self, folder: Path) -> None:
        """Tell how the log is shown, where the run had a page."""


class Pages(NoPage):
    """Those of all rooms, as one. `nodes`: the names of those that start here, the leader first."""

    def __init__(
        self, beside: Offers, nodes: Mapping[Role, str], rig: Rig, bus: BusAddress
    ) -> None:
        self._pages: list[NoPage] = []
        try:
            for room in parts_called("run_page"):
                self._pages.append(room.Page(beside, nodes, rig, bus))
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
