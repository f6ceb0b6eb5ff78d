"""A browser that is connected: what it wants to see, and what it is sent.

Each has a task of its own that sends at a tick what is new and then waits until the network has
taken it: a slow one gets fewer and larger pieces, one that takes nothing for SILENT_S is cut off.
None of that is felt by other clients, and nothing of it by the loop. Ticks are common to all.
Where there is no room for one more, the one goes that has kept what it is sent waiting longest, and
of those that have not told the token yet the first.
"""

import asyncio
import json
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any, Protocol

from starlette.websockets import WebSocket, WebSocketDisconnect

from pcpc.drivers.errors import UserError
from pcpc.tools.live.host import client_messages as messages
from pcpc.tools.live.host import guard, status
from pcpc.tools.live.host.curve_expression import MARK, CurveExpression
from pcpc.tools.live.host.display import Display
from pcpc.tools.live.host.panels import PanelState
from pcpc.tools.live.host.plant_drawing import layout
from pcpc.tools.live.host.sources import RunSource, complete

TICK_S = 1 / 60
SCENE_TICKS, STATUS_TICKS = 2, 12  # common to all clients: what they are sent is made once
HELLO_S, SILENT_S = 5.0, 10.0
SLOW_S = 1.0  # who takes nothing for as long may be cut off for another
MOST_STRANGERS = 32
MOST_PANELS = 16
_NONE = (-1, -1)  # nothing was told or drawn yet


class Show(Protocol):
    """What clients have in common."""

    token: str
    write: bool
    most_clients: int
    clients: "set[Client]"
    strangers: list[asyncio.Timeout]  # of those that have not told the token yet, the first first
    runs_under_way: list[dict[str, Any]]  # the runs that go on; anew when it changes
    tick: "asyncio.Future[None]"  # done when what the runs have recorded was taken; then the next
    ticks: int  # that were

    def display(self, run: str) -> Display:
        """Return what shows a run; "": whichever is alone."""
        ...


class Client:
    """One connection, from its first word to its end."""

    def __init__(self, socket: WebSocket, show: Show) -> None:
        self._socket, self._show = socket, show
        self.display = show.display("")
        self._runs_sent: tuple[object, str] = (None, "")  # runs and which of them, as it was told
        self._panels: dict[int, PanelState] = {}
        self._version, self._event = _NONE, 0
        self._values_sent: dict[str, float | None] = {}  # parameters
        self._status_at = self._scene_at = 0  # the tick from which on they are sent again
        self._at: int | None = None  # the cycle of a log that is looked at
        self._scene_sent = _NONE  # run and cycle of the scene that was sent
        self._lock = asyncio.Lock()
        self._since_s: float | None = None  # since when it does not take what is sent
        self._time_out: asyncio.Timeout | None = None

    async def serve(self) -> None:
        """Serve it until it leaves; whatever it does ends only itself."""
        await self._socket.accept()
        try:
            if not await self._greet():
                return
            self._show.clients.add(self)
            async with asyncio.TaskGroup() as tasks:
                sending = tasks.create_task(self._send())
                await self._hear()
                sending.cancel()
        except* (WebSocketDisconnect, RuntimeError, TimeoutError, OSError):
            pass  # it is gone
        finally:
            self._show.clients.discard(self)

    async def _greet(self) -> bool:
        """Return whether its first word has the token, and there is room for it."""
        try:
            async with self._stranger():
                word = messages.read(await self._word())
        except (messages.WrongMessage, TimeoutError):
            word = None
        if not isinstance(word, messages.Hello) or not guard.is_token(word.token, self._show.token):
            await self._socket.close(guard.WRONG_TOKEN, "the token is missing or wrong")
            return False
        if len(self._show.clients) >= self._show.most_clients and not self._make_room():
            await self._socket.close(guard.TOO_MANY, "there are too many clients")
            return False
        self.display = self._show.display(word.run)
        return True

    @asynccontextmanager
    async def _stranger(self) -> AsyncIterator[None]:
        """Give it HELLO_S; where there are many, the one that came first has to go."""
        strangers = self._show.strangers
        async with asyncio.timeout(HELLO_S) as limit:
            strangers.append(limit)
            if len(strangers) > MOST_STRANGERS:
                _end(strangers.pop(0))
            try:
                yield
            finally:
                if limit in strangers:
                    strangers.remove(limit)

    def _make_room(self) -> bool:
        """Cut off the client that is slowest; return whether there was a slow one."""
        now_s = asyncio.get_running_loop().time()
        since = {one: s for one in self._show.clients if (s := one._since_s) is not None}
        slowest = min(since, key=since.__getitem__, default=None)
        if slowest is None or now_s - since[slowest] < SLOW_S or slowest._time_out is None:
            return False
        self._show.clients.discard(slowest)
        _end(slowest._time_out)
        return True

    async def _word(self) -> str | bytes:
        message = await self._socket.receive()
        if message["type"] != "websocket.receive":
            raise WebSocketDisconnect(1000)
        return message.get("text") or message.get("bytes") or b""

    # Hearing

    async def _hear(self) -> None:
        flood = guard.Flood()
        while (word := await self._next(flood)) is not None:
            await self._carry_out(word)

    async def _next(self, flood: guard.Flood) -> messages.Word | None:
        """Return what is asked next; None where the client was cut off."""
        message = await self._word()
        if flood.too_many():
            await self._socket.close(guard.TOO_MANY, "too many messages")
            return None
        try:
            return messages.read(message)
        except messages.WrongMessage as error:
            await self._socket.close(guard.BAD_MESSAGE, str(error)[:120])
            return None

    async def _carry_out(self, word: Any) -> None:
        if isinstance(word, messages.Panel | messages.Phase):
            places = []
            for name in word.names:
                try:
                    places.append(self._curve(name))
                except UserError as error:
                    await self._tell({"refused": word.id, "name": name, "why": str(error)})
                    return
            if len(self._panels) >= MOST_PANELS and word.id not in self._panels:
                await self._tell({"refused": word.id, "why": f"at most {MOST_PANELS} panels"})
                return
            self._panels[word.id] = PanelState(word, places)
        elif isinstance(word, messages.Drop):
            self._panels.pop(word.id, None)
        elif isinstance(word, messages.At):
            self._at = round(word.t_s / self.display.source.period_s)
        elif isinstance(word, messages.Choose):
            await self._tell({"done": word.id})
            self._choose(word.run)
        elif isinstance(word, messages.Action):
            try:
                told = await asyncio.to_thread(self.display.actions.do, word)
                await self._tell({"done": word.id, "undoes": self.display.actions.undoes, **told})
            except UserError as error:
                await self._tell({"refused": word.id, "why": str(error)})

    def _choose(self, run: str) -> None:
        """Show another run from now on; it is told as one that is new."""
        self.display = self._show.display(run)
        self._panels.clear()
        self._version, self._event, self._at, self._scene_sent = _NONE, 0, None, _NONE

    def _curve(self, name: str) -> tuple[str, str] | CurveExpression:
        """Return what a curve is of; UserError."""
        source = self.display.source
        return CurveExpression(name, source) if name.startswith(MARK) else source.curve(name)

    # Sending

    async def _send(self) -> None:
        """Send what is new, at every tick."""
        while True:
            ticks = self._show.ticks
            await self._new_run()
            source = self.display.source
            for shown in list(self._panels.values()):
                if message := shown.message(source):
                    await self._send_in_time(self._socket.send_bytes(message))
            if ticks >= self._scene_at:
                self._scene_at = (ticks // SCENE_TICKS + 1) * SCENE_TICKS
                await self._draw(source)
            if source.live and source.nodes and ticks >= self._status_at:
                self._status_at = (ticks // STATUS_TICKS + 1) * STATUS_TICKS
                await self._tell_status()
            await self._offer()
            for number, event in [e for e in self.display.events if e[0] > self._event]:
                self._event = number
                await self._tell({"event": event})
            await asyncio.shield(self._show.tick)

    async def _tell_status(self) -> None:
        facts, values = self.display.status()
        changed = {k: v for k, v in values.items() if self._values_sent.get(k, math.inf) != v}
        self._values_sent = values
        recording = self.display.actions.recordings.state()
        await self._tell({"status": facts | {"values": changed, "recording": recording}})

    async def _offer(self) -> None:
        """Tell which runs go on, and which of them is shown, where that has changed."""
        offered = self._show.runs_under_way
        if self._runs_sent[0] is not offered or self._runs_sent[1] != self.display.run:
            self._runs_sent = offered, self.display.run
            await self._tell({"runs": offered, "shown": self.display.run})

    async def _draw(self, source: RunSource) -> None:
        """Send the plant as it is now, or at the instant of a log that is looked at."""
        first, last = source.span()
        last = complete(source) if source.live else last  # of all nodes
        cycle = last if self._at is None or source.live else max(first, min(last, self._at))
        if cycle >= 0 and self._scene_sent != (source.number, cycle):
            self._scene_sent = source.number, cycle
            if scene := self.display.scene(cycle):
                await self._send_in_time(self._socket.send_text(scene))

    async def _new_run(self) -> None:
        """Tell of a run that is not the one before; its panels have to be asked for again."""
        source = self.display.source
        if self._version != source.version:
            self._version = source.version
            self._panels.clear()
            self._values_sent = {}
            first, last = source.span()
            told = status.run_facts(source, self.display.actions.write) | {"layout": layout(source)}
            await self._tell({"about": told, "span": [first, last]})

    async def _tell(self, message: dict[str, Any]) -> None:
        await self._send_in_time(self._socket.send_text(json.dumps(message, allow_nan=False)))

    async def _send_in_time(self, sending: Any) -> None:
        async with self._lock, asyncio.timeout(SILENT_S) as self._time_out:
            self._since_s = asyncio.get_running_loop().time()
            await sending
            self._since_s = None


def _end(limit: asyncio.Timeout) -> None:
    """Let a time-out come now, if it has not come."""
    with suppress(RuntimeError):
        limit.reschedule(0.0)
