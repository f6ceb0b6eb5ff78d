"""WebSockets that send what is written at once as one piece: a tick is one call of the kernel.

Eight clients with five messages a tick at 60 Hz are 2,400 calls a second otherwise, each of which
may hold a processor that a loop is to be woken on.
"""

import asyncio
from typing import Any

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

_LAST_S = 5.0
_MOST_ENDING = 32  # that were told of their end, and do not answer that


class _BatchedTransport:
    """A transport whose writes of one pass of the event loop go out together."""

    def __init__(self, transport: asyncio.Transport, loop: asyncio.AbstractEventLoop) -> None:
        self._transport, self._loop = transport, loop
        self._parts: list[bytes] = []

    def write(self, data: bytes) -> None:
        if not self._parts:
            self._loop.call_soon(self._flush)
        self._parts.append(data)

    def close(self) -> None:
        self._flush()
        self._transport.close()
        self._loop.call_later(_LAST_S, self._transport.abort)  # where nobody takes the rest

    def _flush(self) -> None:
        if self._parts:
            whole = b"".join(self._parts)
            self._parts.clear()
            self._transport.write(whole)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)


class BatchedSocket(WebSocketsSansIOProtocol):
    """The WebSocket protocol of the web server over such a transport."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Wrap the transport once it is known; wait for the last word of a few only."""
        super().connection_made(transport)
        ending = [
            one for one in self.connections if isinstance(one, BatchedSocket) and one.close_sent
        ]
        for one in ending[_MOST_ENDING:]:
            one.transport.abort()
        self.transport = _BatchedTransport(self.transport, self.loop)  # type: ignore[assignment]
