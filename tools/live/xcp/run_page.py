"""The XCP slaves of a run, one for each node, in processes that no run waits for."""

import sys
import time
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from pcpc.drivers.can.bus import BusAddress
from pcpc.drivers.compiled import compile_cache
from pcpc.executive.nodes import live
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.tools.start.children import Child
from pcpc.tools.start.page import NoPage
from pcpc.tools.terminal.request import Offers

if TYPE_CHECKING:
    from pcpc.tools.live.xcp.serve import XcpServer

_LOOK_S = 0.05


class Page(NoPage):
    """Those of one run; without the rig's key `xcp` none, which does nothing."""

    ENDED = "{name}: the XCP slave has ended: {why}; the run goes on, `pcpc xcp` serves it again"
    FAILS_ONLY = True

    def __init__(
        self, beside: Offers, nodes: Mapping[Role, str], rig: Rig, bus: BusAddress
    ) -> None:
        """Listen, so that what is wrong is told before the run begins; UserError."""
        self._nodes = nodes
        self._servers: dict[Role, XcpServer] = {}
        if rig.config.xcp is not None:
            from pcpc.tools.live.xcp import serve  # time

            try:
                for role in nodes:
                    self._servers[role] = serve.XcpServer.of_rig(rig, bus, role)
            except BaseException:
                self._close()
                raise

    def start(self) -> None:
        """Begin to serve, and tell where."""
        for role, server in self._servers.items():
            said = [f"{role}: {one}" for one in server.addresses]
            print("\n".join(said), file=sys.stderr, flush=True)
            child = Child.fork(f"xcp-{role}", partial(self._serve, role), ())
            self._children = [*self._children, child]
        self._close()

    def _serve(self, role: Role, words: object) -> int:
        compile_cache.watch.listener = None
        own_server = self._servers.pop(role)
        self._close()
        while (found := live.running().get(self._nodes[role])) is None:
            time.sleep(_LOOK_S)
        with own_server as server:
            server.serve(found)
        return 0

    def _close(self) -> None:
        for server in self._servers.values():
            server.close()

    def end(self) -> None:
        """End them with the run."""
        self._close()
        super().end()
