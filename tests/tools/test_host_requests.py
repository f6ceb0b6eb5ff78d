"""What a host refuses before it has let anybody in: requests and WebSockets."""

import base64
import os
import socket
from collections.abc import Callable, Iterator

import pytest
from hosting import ANSWER_S, Host, hosting
from websockets.exceptions import InvalidStatus


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Host]:
    with hosting(tmp_path_factory.mktemp("token"), "--write", "--node", "none") as one:
        yield one


def answer(host: Host, *lines: str, body: bytes = b"") -> bytes:
    """Return the beginning of what the server answers to these lines."""
    with socket.create_connection(("127.0.0.1", host.port), ANSWER_S) as line:
        found = b""
        try:
            line.sendall("\r\n".join([*lines, "", ""]).encode("latin-1") + body)
            while len(found) < 4000 and (part := line.recv(4000)):
                found += part
                if b"\r\n\r\n" in found:
                    break
        except ConnectionError:
            pass
        return found


def code(found: bytes) -> int:
    """Return the status of an answer, 0 where the line was only cut."""
    return int(found.split(b" ")[1]) if found.startswith(b"HTTP/1.1 ") else 0


HTTP = {
    "another name": lambda h: ("GET / HTTP/1.1", f"Host: evil.example:{h.port}"),
    "a name rebound to this machine": lambda h: ("GET / HTTP/1.1", "Host: rebound.example"),
    "a name that begins like loopback":
        lambda h: ("GET / HTTP/1.1", f"Host: 127.0.0.1.attacker.example:{h.port}"),
    "another port": lambda h: ("GET / HTTP/1.1", "Host: 127.0.0.1:1"),
    "no port": lambda h: ("GET / HTTP/1.1", "Host: 127.0.0.1"),
    "a user before the name": lambda h: ("GET / HTTP/1.1", f"Host: a@127.0.0.1:{h.port}"),
    "no name": lambda h: ("GET / HTTP/1.0",),
    "an empty name": lambda h: ("GET / HTTP/1.1", "Host: "),
    "two names": lambda h: ("GET / HTTP/1.1", f"Host: {h.name}", "Host: evil.example"),
    "a dot behind the name": lambda h: ("GET / HTTP/1.1", f"Host: localhost.:{h.port}"),
    "another loopback address": lambda h: ("GET / HTTP/1.1", f"Host: 127.0.0.2:{h.port}"),
    "the page of another site":
        lambda h: ("GET / HTTP/1.1", f"Host: {h.name}", "Origin: http://evil.example"),
    "a page without a site": lambda h: ("GET / HTTP/1.1", f"Host: {h.name}", "Origin: null"),
    "a page with another scheme":
        lambda h: ("GET / HTTP/1.1", f"Host: {h.name}", f"Origin: https://{h.name}"),
    "two origins": lambda h: (
        "GET / HTTP/1.1", f"Host: {h.name}", f"Origin: http://{h.name}",
        "Origin: http://evil.example",
    ),
    "POST": lambda h: ("POST / HTTP/1.1", f"Host: {h.name}", "Content-Length: 0"),
    "DELETE": lambda h: ("DELETE /main.js HTTP/1.1", f"Host: {h.name}"),
    "OPTIONS": lambda h: ("OPTIONS / HTTP/1.1", f"Host: {h.name}"),
    "a way out of the folder": lambda h: ("GET /../cli.py HTTP/1.1", f"Host: {h.name}"),
    "a hidden way out": lambda h: ("GET /%2e%2e/cli.py HTTP/1.1", f"Host: {h.name}"),
    "a file that is none of the page's": lambda h: ("GET /server.py HTTP/1.1", f"Host: {h.name}"),
    "a head without an end": lambda h: ("GET / HTTP/1.1", f"Host: {h.name}", "X: " + "y" * 2**22),
    "a target of nonsense": lambda h: ("GET \x01 HTTP/1.1", f"Host: {h.name}"),
    "another protocol": lambda h: ("SSH-2.0-OpenSSH_9.2",),
    "a smuggled length": lambda h: (
        "POST / HTTP/1.1", f"Host: {h.name}", "Content-Length: 5", "Transfer-Encoding: chunked",
    ),
}  # fmt: skip


@pytest.mark.parametrize("lines", HTTP.values(), ids=HTTP)
def test_a_request_is_refused(host: Host, lines: Callable[[Host], tuple[str, ...]]) -> None:
    found = answer(host, *lines(host))
    assert code(found) in (0, 400, 403, 404, 405, 431), found[:300]
    assert b"Server" not in found


def test_the_page_comes_with_rules_and_without_data(host: Host) -> None:
    found = answer(host, "GET / HTTP/1.1", f"Host: {host.name}").decode("latin-1").lower()
    assert found.startswith("http/1.1 200 ")
    assert "content-security-policy: default-src 'none'; script-src 'self'" in found
    assert "unsafe" not in found and "nosniff" in found and host.token.lower() not in found
    for name in ("localhost", "[::1]"):
        assert code(answer(host, "GET /main.js HTTP/1.1", f"Host: {name}:{host.port}")) == 200


ORIGINS = {
    "the page of another site": "http://evil.example",
    "a page without a site": "null",
    "a site that begins like this one": "http://127.0.0.1.evil.example",
    "this machine on another port": "http://127.0.0.1:1",
    "this machine with another scheme": "file://",
}


@pytest.mark.parametrize("origin", ORIGINS.values(), ids=ORIGINS)
def test_a_websocket_of_another_page_is_refused(host: Host, origin: str) -> None:
    with pytest.raises(InvalidStatus) as refused, host.connect(origin=origin):
        raise AssertionError("it was let in")
    assert refused.value.response.status_code == 403


def test_a_websocket_under_a_rebound_name_is_refused(host: Host) -> None:
    key = base64.b64encode(os.urandom(16)).decode()
    found = answer(
        host, "GET /ws HTTP/1.1", "Host: rebound.example:80", "Upgrade: websocket",
        "Connection: Upgrade", f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13",
    )  # fmt: skip
    assert code(found) == 403, found[:300]


def test_a_websocket_elsewhere_is_refused(host: Host) -> None:
    with pytest.raises(InvalidStatus), host.connect("/elsewhere"):
        raise AssertionError("there is something")
