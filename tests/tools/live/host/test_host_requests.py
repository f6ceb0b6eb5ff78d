"""What a host refuses before it has let anybody in: requests and WebSockets."""

import base64
import json
import os
import select
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from hosting import ANSWER_S, Host, hosting
from processes import until
from websockets.exceptions import ConnectionClosed, InvalidStatus


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
    "its name and more": lambda h: ("GET / HTTP/1.1", f"Host: {h.name}.evil.example"),
    "its name and a digit": lambda h: ("GET / HTTP/1.1", f"Host: {h.name}0"),
    "more and its name": lambda h: ("GET / HTTP/1.1", f"Host: evil.example.{h.name}"),
    "its name in capitals": lambda h: ("GET / HTTP/1.1", f"Host: LOCALHOST:{h.port}"),
    "a part of its name": lambda h: ("GET / HTTP/1.1", f"Host: {h.name[:-1]}"),
    "a page whose site begins like its own": lambda h: (
        "GET / HTTP/1.1", f"Host: {h.name}", f"Origin: http://{h.name}.evil.example"),
    "a page whose site has more digits": lambda h: (
        "GET / HTTP/1.1", f"Host: {h.name}", f"Origin: http://{h.name}0"),
    "a page whose site ends like its own": lambda h: (
        "GET / HTTP/1.1", f"Host: {h.name}", f"Origin: http://evil.example/http://{h.name}"),
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
        host,
        "GET /ws HTTP/1.1",
        "Host: rebound.example:80",
        "Upgrade: websocket",
        "Connection: Upgrade",
        f"Sec-WebSocket-Key: {key}",
        "Sec-WebSocket-Version: 13",
    )
    assert code(found) == 403, found[:300]


def test_a_websocket_elsewhere_is_refused(host: Host) -> None:
    with pytest.raises(InvalidStatus), host.connect("/elsewhere"):
        raise AssertionError("there is something")


# Who holds a line

LISTENS = "0A"  # as /proc/net/tcp says it


def line_to(host: Host, held: ExitStack, small: bool = False) -> socket.socket:
    """Return a line that is open until the end of the test; `small`: it takes little at once."""
    line = held.enter_context(socket.socket())
    if small:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    line.settimeout(ANSWER_S)
    line.connect(("127.0.0.1", host.port))
    return line


def gone(line: socket.socket, wait_ms: int = 0) -> bool:
    """Return whether the server has let a line go, without taking anything from it."""
    look = select.poll()
    look.register(line, select.POLLRDHUP)
    return bool(look.poll(wait_ms))


def lines_of(host: Host) -> int:
    """Return how many lines the host holds; those that only the kernel still has count as none."""
    rows = [row.split() for row in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    own = [row for row in rows if int(row[1].rpartition(":")[2], 16) == host.port]
    return sum(row[3] != LISTENS and int(row[9]) != 0 for row in own)


def half(host: Host) -> bytes:
    return f"GET / HTTP/1.1\r\nHost: {host.name}\r\nX: ".encode()


def served(host: Host) -> bool:
    return code(answer(host, "GET / HTTP/1.1", f"Host: {host.name}")) == 200


def test_half_requests_keep_nobody_out(host: Host) -> None:
    with ExitStack() as held:
        for _ in range(200):
            line_to(host, held).sendall(half(host))
        assert served(host)
        for _ in range(200):
            line_to(host, held)
        assert served(host)
    assert served(host)


def test_a_request_that_does_not_end_has_an_end(host: Host) -> None:
    with ExitStack() as held:
        silent, begun, second, drips = (line_to(host, held) for _ in range(4))
        begun.sendall(half(host))
        second.sendall(half(host)[:-3] + b"\r\n" + half(host))
        drips.sendall(half(host))
        lines = {silent, begun, second, drips}

        def all_gone() -> bool:
            lines.difference_update([line for line in lines if gone(line, 50)])
            if drips in lines:
                drips.send(b"x")
            return not lines

        until(all_gone, "they are cut off", ANSWER_S)
    assert served(host)


def test_an_answer_that_nobody_takes_has_an_end(host: Host) -> None:
    with ExitStack() as held:
        until(lambda: lines_of(host) == 0, "nobody is there", ANSWER_S)
        line = line_to(host, held, small=True)
        asked = f"GET /uplot.js HTTP/1.1\r\nHost: {host.name}\r\n\r\n".encode()
        line.sendall(asked * 60)
        until(lambda: lines_of(host) == 1, "it is served", ANSWER_S)
        until(lambda: lines_of(host) == 0, "it is cut off", ANSWER_S)
    assert served(host)


def deaf(host: Host, held: ExitStack, *words: dict[str, object]) -> socket.socket:
    """Return a WebSocket that says these words and takes nothing."""
    line = line_to(host, held, small=True)
    key = base64.b64encode(os.urandom(16)).decode()
    head = (
        "GET /ws HTTP/1.1", f"Host: {host.name}", "Connection: Upgrade", "Upgrade: websocket",
        f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13",
    )  # fmt: skip
    line.sendall("\r\n".join([*head, "", ""]).encode())
    assert line.recv(1000).startswith(b"HTTP/1.1 101 ")
    for word in words:
        body = json.dumps(word).encode()
        line.sendall(struct.pack(">BBHI", 0x81, 0xFE, len(body), 0) + body)
    return line


def enters(host: Host) -> bool:
    """Return whether a client with the token is let in."""
    with host.connect() as line:
        line.send(json.dumps({"do": "hello", "token": host.token}))
        try:
            return bool(line.recv(timeout=ANSWER_S))
        except ConnectionClosed:
            return False


def test_clients_that_never_take_anything_are_cut_off(host: Host) -> None:
    with ExitStack() as held:
        hello = {"do": "hello", "token": host.token}
        for _ in range(32):
            deaf(host, held, hello)
        until(lambda: not enters(host), "they take all the room", ANSWER_S)
        until(lambda: enters(host), "there is room again", ANSWER_S)
        until(lambda: lines_of(host) == 0, "they are cut off", ANSWER_S)


def test_websockets_that_tell_no_token_keep_nobody_out(host: Host) -> None:
    with ExitStack() as held:
        for _ in range(300):
            deaf(host, held)
        assert served(host) and enters(host)
