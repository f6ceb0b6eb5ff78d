"""HTTP whose requests come in time and whose answers are taken: who holds a line is cut off.

A request has WAIT_S from the first byte of its line, or from the end of the answer before it, and
whoever takes nothing of an answer has as long. Where MOST lines wait, the one that has waited
longest is cut off for one that is new, so that half requests keep nobody out.
"""

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

WAIT_S = 5.0
MOST = 96  # below the web server's own limit, from which on it answers 503


class TimedHttp(H11Protocol):
    """The HTTP protocol of the web server, with an end to each wait."""

    _timer: asyncio.TimerHandle | None = None
    _left = 0  # bytes of an answer that were not taken yet
    _since_s = 0.0

    def connection_made(self, transport: Any) -> None:
        """Begin to wait, in the place of another one if there are many."""
        super().connection_made(transport)
        self._wait()
        waiting = [
            one
            for one in self.connections
            if isinstance(one, TimedHttp) and not one.transport.is_closing()
        ]
        if len(waiting) > MOST:
            min(waiting, key=lambda one: one._since_s).transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no more."""
        self._go_on()
        super().connection_lost(exc)

    def handle_events(self) -> None:
        """Begin anew where a whole request has come."""
        before = self.cycle
        super().handle_events()
        if self.cycle is not before and self._timer is not None:
            self._wait()

    def on_response_complete(self) -> None:
        """Begin anew: the answer is to be taken, and the next request to come."""
        self._wait()
        super().on_response_complete()

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Wait no more: a WebSocket has its own limits."""
        self._go_on()
        super().handle_websocket_upgrade(event)

    def _wait(self) -> None:
        self._go_on()
        self._since_s, self._left = self.loop.time(), self.transport.get_write_buffer_size()
        self._timer = self.loop.call_later(WAIT_S, self._late)

    def _go_on(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _late(self) -> None:
        """Cut it off, but where more of an answer was taken."""
        if 0 < self.transport.get_write_buffer_size() < self._left:
            self._wait()
        else:
            self.transport.abort()
