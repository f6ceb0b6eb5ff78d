"""`pcpc run --xcp`: the slave of a run's leading node, in a process that no run waits for."""

import argparse
import re
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from pcpc.drivers.compiled import compile_cache
from pcpc.drivers.errors import UserError
from pcpc.executive.nodes import live
from pcpc.tools.start.children import Child
from pcpc.tools.start.page import NoPage

if TYPE_CHECKING:
    from pcpc.tools.live.xcp.serve import Server

_WHERE = re.compile(r"(udp|tcp):(\d{1,5})")
_LOOK_S = 0.05


class Page(NoPage):
    """That of one run, whose leading node is `node`; without --xcp none, which does nothing."""

    ENDED = "the XCP slave has ended: {}; the run goes on, `pcpc xcp` serves it again"
    FAILS_ONLY = True

    def __init__(self, options: argparse.Namespace, node: str) -> None:
        """Listen, so that what is wrong is told before the run begins; UserError."""
        self._node = node
        self._server: Server | None = None
        if (given := getattr(options, "xcp", None)) is not None:
            if (told := _WHERE.fullmatch(given)) is None:
                raise UserError(f"--xcp {given}: expected udp:PORT or tcp:PORT")
            from pcpc.tools.live.xcp import serve  # time

            self._server = serve.Server([(told[1].upper(), "127.0.0.1", int(told[2]))])

    def start(self) -> None:
        """Begin to serve, and tell where."""
        if self._server is not None:
            print("\n".join(self._server.addresses), file=sys.stderr, flush=True)
            self._child = Child.forked("xcp", self._serve, ())
            self._server.close()

    def _serve(self, words: Sequence[str]) -> int:
        compile_cache.watch.listener = None
        assert self._server is not None
        while (found := live.running().get(self._node)) is None:
            time.sleep(_LOOK_S)
        with self._server as server:
            server.serve(found)
        return 0

    def end(self) -> None:
        """End it with the run."""
        super().end()
        if self._server is not None:
            self._server.close()
