"""`pcpc host --foxglove` in a process of its own, and clients that speak its protocol.

Text messages are JSON with `op`; the server's data are binary: 1, subscription (4 bytes), time of
the message in ns (8), payload. ws-protocol of Foxglove, subprotocol foxglove.sdk.v1.
"""

import json
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from copies import Heard
from hosting import ANSWER_S, started
from websockets.sync.client import connect

PROTOCOL = "foxglove.sdk.v1"


@dataclass
class Server:
    """A running one, and the token that it printed, "" if it only shows."""

    process: "subprocess.Popen[str] | Heard"
    url: str
    token: str


@contextmanager
def serving(folder: Path, *words: str) -> Iterator[Server]:
    """Start it; its token lies in `folder`; end it as Ctrl-C does."""
    with started(folder, *words, "--foxglove", "0") as process:
        assert process.stdout and process.stderr
        url, link = process.stdout.readline().strip(), process.stdout.readline()
        assert link.startswith("https://app.foxglove.dev/?") and url in link, process.stderr.read()
        told = [process.stderr.readline() for _ in range(3)]
        yield Server(process, url, told[2].split()[-1] if "--write" in words else "")


class Client:
    """A client; it gathers the channels that it has been told of."""

    def __init__(self, server: Server, **about: Any) -> None:
        about = {"subprotocols": [PROTOCOL], "proxy": None, "max_size": None} | about
        self._connection = connect(server.url, open_timeout=ANSWER_S, **about)
        self.socket = self._connection.__enter__()
        self.channels: dict[int, dict[str, Any]] = {}
        self.heard: list[str] = []  # all texts
        self.told: list[str] = []  # what it says to its user, and was not asked for yet
        self._asked = 0
        self.info = self.until(lambda said: said["op"] == "serverInfo")

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *error: object) -> None:
        self._connection.__exit__(None, None, None)

    def say(self, **message: Any) -> None:
        """Send a message."""
        self.socket.send(json.dumps(message))

    def next(self) -> Any:
        """Return a text message, or topic, time in ns and payload of one with data."""
        found = self.socket.recv(timeout=ANSWER_S)
        if isinstance(found, str):
            self.heard.append(found)
            said = json.loads(found)
            for one in said.get("channels", ()) if said["op"] == "advertise" else ():
                self.channels[one["id"]] = one
            if said["op"] == "status":
                self.told.append(said["message"])
            for number in said["channelIds"] if said["op"] == "unadvertise" else ():
                del self.channels[number]
            return said
        kind, number, time_ns = struct.unpack_from("<BIQ", found)
        assert kind == 1
        return self.channels[number]["topic"], time_ns, found[13:]

    def until(self, holds: Callable[[Any], bool]) -> Any:
        """Return the next text message for which `holds`."""
        deadline_s = time.monotonic() + ANSWER_S
        while time.monotonic() < deadline_s:
            said = self.next()
            if isinstance(said, dict) and holds(said):
                return said
        raise AssertionError(
            f"not within {ANSWER_S} s; heard {[text[:200] for text in self.heard]}"
        )

    def status(self) -> str:
        """Return what the server says next to its user."""
        while not self.told:
            self.next()
        return self.told.pop(0)

    def know(self, topics: set[str]) -> None:
        """Wait until these topics are there."""
        while not topics <= {one["topic"] for one in self.channels.values()}:
            self.next()

    def subscribe(self, *topics: str) -> None:
        """Subscribe to topics that are there; a subscription has the channel's id."""
        chosen = [i for i, one in self.channels.items() if one["topic"] in topics]
        assert len(chosen) == len(topics), (topics, self.channels)
        self.say(op="subscribe", subscriptions=[{"id": i, "channelId": i} for i in chosen])

    def gather(self, enough: Callable[[dict[str, Any]], bool]) -> dict[str, list[Any]]:
        """Return time and payload of the messages by topic, once they are enough."""
        found: dict[str, list[Any]] = {}
        deadline_s = time.monotonic() + ANSWER_S
        while not enough(found):
            assert time.monotonic() < deadline_s, {key: len(one) for key, one in found.items()}
            said = self.next()
            if isinstance(said, tuple):
                found.setdefault(said[0], []).append(said[1:])
        return found

    def get(self, *names: str) -> dict[str, Any]:
        """Return the values of parameters, all for no name."""
        number = self._number()
        self.say(op="getParameters", parameterNames=[*names], id=number)
        return self._values(number)

    def set(self, values: dict[str, Any]) -> dict[str, Any]:
        """Ask for parameters; return what they are then."""
        number = self._number()
        wanted = [{"name": name, "value": value} for name, value in values.items()]
        self.say(op="setParameters", parameters=wanted, id=number)
        return self._values(number)

    def _values(self, number: str) -> dict[str, Any]:
        said = self.until(lambda said: said.get("id") == number and said["op"] == "parameterValues")
        return {one["name"]: one["value"] for one in said["parameters"]}

    def _number(self) -> str:
        self._asked += 1
        return f"request {self._asked}"
