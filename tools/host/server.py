"""The web server of the host: one page, its few files, and a WebSocket. It has no other state."""

import argparse
import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from importlib.resources import files
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from pcpc.drivers.errors import UserError
from pcpc.executive.nodes.live import Live
from pcpc.tools.host import drawn, guard
from pcpc.tools.host.actions import Actions
from pcpc.tools.host.asked import MOST_BYTES
from pcpc.tools.host.clients import TICK_S, Client
from pcpc.tools.host.drawn import Drawn
from pcpc.tools.host.recordings import recordings_of
from pcpc.tools.host.sources import Source, Watch

LOOK_S = 0.5  # how soon another run is seen
MOST_EVENTS = 200
_KINDS = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
_FILES = (
    "index.html", "main.js", "net.js", "panels.js", "side.js", "operate.js", "drawing.js",
    "host.css", "uplot.js", "uplot.css",
)  # fmt: skip


class Server:
    """A page about a run or log."""

    most_clients = 32

    def __init__(self, source: Source | Watch, token: str, options: argparse.Namespace) -> None:
        self._watch = source if isinstance(source, Watch) else None
        self._fixed = source if isinstance(source, Source) else None
        self._recordings = recordings_of(options)
        self.token = token
        self.actions = Actions(lambda: self.source, options.write, self._recordings)
        self.clients: set[Client] = set()
        self.events: list[tuple[int, dict[str, Any]]] = []
        self._count, self._options = 0, options
        self._drawn: tuple[int, Drawn | None] = (-1, None)  # of which run

    @property
    def source(self) -> Source:
        """The run that is shown now."""
        return self._watch.source if self._watch is not None else self._fixed  # type: ignore

    def nodes(self) -> Mapping[str, Live]:
        """Return all nodes that run and may be shown."""
        return self._watch.runs.nodes() if self._watch is not None else {}

    def scene(self, cycle: int) -> dict[str, Any]:
        """Return the drawing of the plant at a cycle, empty without one."""
        source = self.source
        mark = 10 * source.number + len(source.nodes)
        try:
            if self._drawn[0] != mark:
                self._drawn = mark, None  # should it fail, it does so once
                self._drawn = mark, drawn.of(source, self._options)
            found = self._drawn[1]
            return found.scene(source, cycle) if found else {}
        except UserError as error:
            self._drawn = mark, None
            return {"bounds": [0, 0, 1, 1], "note": str(error), "shapes": []}

    def app(self, names: frozenset[str], secure: bool) -> Any:
        """Return the ASGI application for a server with these names."""
        routes: list[Any] = [WebSocketRoute("/ws", self._connected)]
        routes += [
            Route("/" if name == "index.html" else f"/{name}", _file(name)) for name in _FILES
        ]
        return guard.Guard(Starlette(routes=routes, lifespan=self._life), names, secure)

    async def _connected(self, socket: WebSocket) -> None:
        await Client(socket, self).serve()

    @contextlib.asynccontextmanager
    async def _life(self, app: Starlette) -> AsyncIterator[None]:
        following = asyncio.create_task(self._follow()) if self._watch else None
        yield
        if following:
            following.cancel()
        await asyncio.to_thread(self._recordings.close)

    async def _follow(self) -> None:
        """Take what the run has recorded, and look for another one."""
        assert self._watch is not None
        next_look = 0.0
        loop = asyncio.get_running_loop()
        while True:
            if loop.time() >= next_look:
                next_look = loop.time() + LOOK_S
                self._watch.find()
            for role, cycle, topic, entry in self._watch.poll():
                self._count += 1
                event = {"node": role, "cycle": cycle, "topic": topic, **entry}
                self.events.append((self._count, event))
            del self.events[:-MOST_EVENTS]
            await asyncio.sleep(TICK_S)


def _file(name: str) -> Any:
    body = files("pcpc.tools.host").joinpath("page", name).read_bytes()
    kind = _KINDS[name.rpartition(".")[2]]

    async def answer(request: Any) -> Response:
        return Response(body, media_type=kind)

    return answer


def config(app: Any, certificate: tuple[str, str] | None) -> uvicorn.Config:
    """Return the settings of the web server: small messages, none of them compressed."""
    cert, key = certificate or (None, None)
    return uvicorn.Config(
        app, http="h11", ws="websockets-sansio", lifespan="on", log_level="critical",
        access_log=False, ws_max_size=MOST_BYTES, ws_per_message_deflate=False,
        limit_concurrency=128, timeout_keep_alive=5, timeout_graceful_shutdown=2,
        server_header=False, date_header=False, ssl_certfile=cert, ssl_keyfile=key,
        proxy_headers=False, h11_max_incomplete_event_size=16 * 1024,
    )  # fmt: skip
