"""`pcpc run --host`: the page beside a run, in a process of its own that the run never waits for.

It listens before the run begins, so that what is wrong is told then; it ends with the run. Should
it end before, that is one line, and the run goes on.
"""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pcpc.drivers.compiled import compile_cache
from pcpc.drivers.errors import UserError
from pcpc.executive.rig.roles import Role
from pcpc.tools.live.host.commands import BesideRun, HostRequest
from pcpc.tools.start.children import Child
from pcpc.tools.start.page import SAID, NoPage
from pcpc.tools.terminal.request import Offers

if TYPE_CHECKING:
    from pcpc.tools.live.host.cli import Door

_GIVEN = "write", "port", "recordings", "recordings_mb"  # what `pcpc run` takes for it


class Page(NoPage):
    """That of one run, of its leading node; without --host none, which does nothing."""

    ENDED = "the page has ended: {why}; the run goes on, `pcpc host` shows it again"

    def __init__(self, beside: Offers, nodes: Mapping[Role, str], *_: object) -> None:
        request = beside.of(BesideRun)
        self._wanted, self._node = request.host, next(iter(nodes.values()))
        self._door: Door | None = None
        self._page = request.page
        if self._wanted:
            from pcpc.tools.live.host import cli  # time

            cli.check_packages()
            self._door = cli.open_door(HostRequest(page=self._page))
        elif alone := [key for key in _GIVEN if vars(request.page)[key] not in (None, False)]:
            words = ", ".join(f"--{key.replace('_', '-')}" for key in alone)
            raise UserError(f"{words}: options of the page; give --host, too")

    def start(self) -> None:
        """Begin to serve, and tell where."""
        if self._door is None:
            return
        print(f"{SAID}{self._door.url}", file=sys.stderr, flush=True)
        self._children = [Child.fork("page", self._serve, ())]
        self._door.line.close()

    def _serve(self, words: Sequence[str]) -> int:
        from pcpc.tools.live.host import cli  # time
        from pcpc.tools.live.host.sources import FollowedRun

        compile_cache.watch.listener = None
        assert self._door is not None
        cli.serve(self._door, FollowedRun(node=self._node), self._page)
        return 0

    def farewell(self, folder: Path) -> None:
        """Tell how the log is shown, where the run had a page."""
        if self._wanted:
            print(f"page: ended with the run; its log: pcpc host {folder}", file=sys.stderr)
