"""Who may talk to the host: judged before a page is sent or a WebSocket is accepted.

    Host      one of the names that the server was started for, letter by letter: a page of another
              site that has rebound its name to this machine still sends its own
    Origin    absent, or http(s):// and one of those names; `null` is none of them
    token     the first message of a WebSocket; it stands in the fragment of the URL, which browsers
              send to nobody
    flood     more than RATE messages a second, on the average of some seconds

A page's address alone shows no more than the page itself, which holds no data.
"""

import hmac
import os
import secrets
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pcpc.drivers.machine.regular_files import open_regular

PORT = 8642  # the first that is tried
LOOPBACK = ("127.0.0.1", "localhost", "::1")
WRONG_TOKEN, TOO_MANY, BAD_MESSAGE = 4401, 4429, 4400  # why a WebSocket was closed
MOST_TOKEN = 200  # letters
RATE, BURST = 50.0, 200.0  # messages a second; at once
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
        "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def names_of(addresses: Iterable[str], port: int) -> frozenset[str]:
    """Return what a Host header may say for a server at these addresses."""
    return frozenset(place(address, port) for address in addresses)


def place(address: str, port: int) -> str:
    """Return an address and a port as they stand in a URL."""
    return f"[{address}]:{port}" if ":" in address else f"{address}:{port}"


def is_loopback(address: str) -> bool:
    """Return whether only this machine reaches what listens there."""
    return address in LOOPBACK


class DoorGuard:
    """An ASGI application in front of another that lets only requests for `names` through."""

    def __init__(self, app: Any, names: frozenset[str], secure: bool) -> None:
        self._app, self._names = app, names
        self._origins = {f"{'https' if secure else 'http'}://{name}" for name in names}

    def refusal(self, headers: Iterable[tuple[bytes, bytes]]) -> str:
        """Return why a request is refused, "" for one that is let through."""
        by_name: dict[bytes, list[str]] = {}
        for name, value in headers:
            by_name.setdefault(name.lower(), []).append(value.decode("latin-1"))
        host, origin = by_name.get(b"host", []), by_name.get(b"origin", [])
        if len(host) != 1 or host[0] not in self._names:
            return "this server has another name"
        if len(origin) > 1 or (origin and origin[0] not in self._origins):
            return "the request comes from the page of another site"
        return ""

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Answer as ASGI wants it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        why = self.refusal(scope["headers"])
        if scope["type"] == "http" and not why and scope["method"] not in ("GET", "HEAD"):
            why = "it is read-only"
        if not why:
            await self._app(scope, receive, _with_headers(send))
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": why})  # 403
        else:
            await _say(send, 403, why)


def _with_headers(send: Any) -> Any:
    async def send_with_headers(message: Any) -> None:
        if message["type"] == "http.response.start":
            more = [(k.lower().encode(), v.encode()) for k, v in HEADERS.items()]
            message["headers"] = [*message.get("headers", []), *more]
        await send(message)

    return send_with_headers


async def _say(send: Any, status: int, text: str) -> None:
    body = f"{text}\n".encode()
    head = [(b"content-type", b"text/plain; charset=utf-8")]
    await _with_headers(send)({"type": "http.response.start", "status": status, "headers": head})
    await send({"type": "http.response.body", "body": body})


class Flood:
    """Counts the messages of one client."""

    def __init__(self, rate: float = RATE, burst: float = BURST) -> None:
        self._rate, self._burst = rate, burst
        self._left, self._seen_s = burst, time.monotonic()

    def too_many(self) -> bool:
        """Note a message; return whether it is one too many."""
        now_s = time.monotonic()
        self._left = min(self._burst, self._left + self._rate * (now_s - self._seen_s))
        self._seen_s = now_s
        self._left -= 1.0
        return self._left < 0.0


def is_token(word: object, token: str) -> bool:
    """Return whether a client gave the token; how long that takes does not tell of it."""
    return isinstance(word, str) and hmac.compare_digest(word.encode(), token.encode())


def token_of(environment: Mapping[str, str], anew: bool = False) -> str:
    """Return this user's token, of a file that nobody else can read; make it if there is none.

    It stays the same, so that a page that is open finds the server again after a restart. Where no
    file can be written it lasts as long as the server.
    """
    home = environment.get("XDG_STATE_HOME") or f"{environment.get('HOME', '')}/.local/state"
    path = Path(home) / "pcpc" / "host-token"
    try:
        if not anew:
            with open_regular(path, os.O_NOFOLLOW) as file:
                about = os.fstat(file.fileno())
                text = file.read(MOST_TOKEN).decode().strip()
            if about.st_uid == os.geteuid() and not about.st_mode & 0o077 and len(text) >= 32:
                return text
    except (OSError, ValueError):
        pass
    token = secrets.token_urlsafe(24)
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        path.unlink(missing_ok=True)
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(token)
    except OSError:
        pass
    return token
