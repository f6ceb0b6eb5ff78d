"""The web server of the host: one page, its few files, and a WebSocket."""

import asyncio
import contextlib
import logging
import time
from collections.abc import AsyncIterator, Callable
from functools import partial
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from pcpc.tools.after.trust import ASKED, Trust
from pcpc.tools.live.host import guard, runs
from pcpc.tools.live.host.batched_socket import BatchedSocket
from pcpc.tools.live.host.client_messages import MOST_BYTES
from pcpc.tools.live.host.clients import SILENT_S, TICK_S, Client
from pcpc.tools.live.host.commands import PageRequest
from pcpc.tools.live.host.display import Display
from pcpc.tools.live.host.requests import WAIT_S, TimedHttp
from pcpc.tools.live.host.sources import FollowedRun, RunSource

LOOK_S = 0.5  # how soon another run is seen
IDLE_S = 10.0  # for a page that comes back
_KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}  # of the page's files


class PageServer:
    """A page about a log, or about runs: what was chosen of several, else the one that goes on."""

    most_clients = 32

    def __init__(
        self,
        source: RunSource | FollowedRun,
        token: str,
        page: PageRequest,
        trust: Trust = ASKED,
    ) -> None:
        self._watch = source if isinstance(source, FollowedRun) else None
        if self._watch is not None:
            self._watch.asks = True
        self.token, self.write = token, page.write
        self._files: list[Path] = []  # that were recorded
        self._display_of = partial(Display, page=page, files=self._files, trust=trust)
        self._displays = {"": self._display_of(source)}
        self._idle_s: dict[str, float] = {}  # since when nobody looks at one
        self.clients: set[Client] = set()
        self.strangers: list[asyncio.Timeout] = []
        self.runs_under_way: list[dict[str, Any]] = []
        self.tick: asyncio.Future[None]
        self.ticks = 0
        self.failure: BaseException | None = None
        self.at_failure: Callable[[], None] = lambda: None  # called once it can follow no more

    def display(self, run: str) -> Display:
        """Return what shows a run, which need not go on yet; "": whichever is alone."""
        if self._watch is None or not run:
            return self._displays[""]
        if run not in self._displays:
            if len(self._displays) > self.most_clients:
                self._let_go(time.monotonic(), 0.0)
            watch = FollowedRun(node=f"{run}.", runs=self._watch.runs)
            self._displays[run] = self._display_of(watch)
            self._displays[run].find()
        return self._displays[run]

    def app(self, names: frozenset[str], secure: bool) -> Any:
        """Return the ASGI application for a server with these names."""
        routes: list[Any] = [WebSocketRoute("/ws", self._serve_client)]
        for file in Path(__file__).with_name("page").iterdir():
            if file.suffix in _KINDS:
                routes.append(Route(f"/{file.name}".removesuffix("index.html"), _answer(file)))
        return guard.DoorGuard(Starlette(routes=routes, lifespan=self._life), names, secure)

    async def _serve_client(self, socket: WebSocket) -> None:
        await Client(socket, self).serve()

    @contextlib.asynccontextmanager
    async def _life(self, app: Starlette) -> AsyncIterator[None]:
        self.tick = asyncio.get_running_loop().create_future()
        following = asyncio.create_task(self._follow())
        following.add_done_callback(self._failed)
        yield
        following.cancel()
        for display in self._displays.values():
            await asyncio.to_thread(display.close)

    def _failed(self, following: "asyncio.Task[None]") -> None:
        if not following.cancelled():
            self.failure = following.exception()
            self.at_failure()

    async def _follow(self) -> None:
        """Take what the runs have recorded, look for others, and have the clients go on."""
        loop = asyncio.get_running_loop()
        next_s = next_look_s = loop.time()
        while True:
            if self._watch is not None and loop.time() >= next_look_s:
                next_look_s = loop.time() + LOOK_S
                self._look(time.monotonic())
            for display in self._displays.values():
                display.poll()
            self.ticks += 1
            done, self.tick = self.tick, loop.create_future()
            done.set_result(None)
            next_s = max(next_s + TICK_S, loop.time())
            await asyncio.sleep(next_s - loop.time())

    def _look(self, now_s: float) -> None:
        """Look which runs there are."""
        found = runs.run_list(self._watch.runs.nodes() if self._watch is not None else {})
        if found != self.runs_under_way:  # else it stays the same object
            self.runs_under_way = found
        for display in self._displays.values():
            display.find()
        self._let_go(now_s, IDLE_S)

    def _let_go(self, now_s: float, idle_s: float) -> None:
        """Let go the displays that nobody has looked at for so long."""
        seen = {id(client.display) for client in self.clients}
        for name, display in [*self._displays.items()]:
            since_s = self._idle_s.setdefault(name, now_s)
            if not name or id(display) in seen or display.records:
                self._idle_s[name] = now_s
            elif now_s >= since_s + idle_s:
                del self._displays[name], self._idle_s[name]


def _answer(file: Path) -> Any:
    body = file.read_bytes()

    async def answer(request: Any) -> Response:
        return Response(body, media_type=_KINDS[file.suffix])

    return answer


def config(app: Any, certificate: tuple[str, str] | None) -> uvicorn.Config:
    """Return the settings of the web server: small messages, none of them compressed."""
    cert, key = certificate or (None, None)
    logging.getLogger("asyncio").setLevel(logging.ERROR)  # a client that is gone is no warning
    return uvicorn.Config(
        app,
        http=TimedHttp,
        ws=BatchedSocket,
        lifespan="on",
        log_level="critical",
        access_log=False,
        ws_max_size=MOST_BYTES,
        ws_per_message_deflate=False,
        limit_concurrency=256,
        timeout_keep_alive=int(WAIT_S),
        timeout_graceful_shutdown=2,
        ws_ping_interval=WAIT_S,
        ws_ping_timeout=SILENT_S,
        server_header=False,
        date_header=False,
        ssl_certfile=cert,
        ssl_keyfile=key,
        proxy_headers=False,
        h11_max_incomplete_event_size=16 * 1024,
    )
