"""A host in a process of its own, and clients that speak to it as they like."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from copies import Heard, end_with_the_tests
from places import PATIENCE_S
from websockets.sync.client import connect

ANSWER_S = PATIENCE_S
LONG = {
    "duration_s": 3600.0, "rate_hz": 200.0, "supervisor.hold_cycles": 10**6,
    "supervisor.fault_after_cycles": 10**6,
}  # fmt: skip


@dataclass
class Host:
    """Where it listens, and the token that its pages have."""

    process: "subprocess.Popen[str] | Heard"
    port: int
    token: str

    @property
    def name(self) -> str:
        """What a Host header says."""
        return f"127.0.0.1:{self.port}"

    @property
    def url(self) -> str:
        """The page."""
        return f"http://{self.name}/#{self.token}"

    def connect(self, path: str = "/ws", **about: Any) -> Any:
        """Connect a client that has said nothing yet."""
        about = {"open_timeout": ANSWER_S, "proxy": None, "max_size": None} | about
        return connect(f"ws://{self.name}{path}", **about)


@contextmanager
def started(
    folder: Path, *words: str, before: Sequence[str] = ()
) -> Iterator["subprocess.Popen[str] | Heard"]:
    """Start `pcpc host`, whose token lies in `folder`; end it as Ctrl-C does, if it goes on.

    `before`: the words of a command that starts it, as prlimit does; without it is a copy.
    """
    environment = os.environ | {"XDG_STATE_HOME": str(folder)}
    process: subprocess.Popen[str] | Heard
    if before:
        process = subprocess.Popen(
            [*before, sys.executable, "-m", "pcpc.tools.cli", "host", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            preexec_fn=end_with_the_tests,
        )
    else:
        process = Heard(["host", *words], environment)
    try:
        yield process
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            _, error = process.communicate(timeout=ANSWER_S)
            assert (process.returncode, error) == (0, ""), f"{process.returncode}: {error}"
    finally:
        process.kill()
        print(process.communicate()[1], file=sys.stderr)


@contextmanager
def hosting(folder: Path, *words: str, port: int = 0, before: Sequence[str] = ()) -> Iterator[Host]:
    """Start it as `started` does, and read where it listens."""
    with started(folder, "--port", str(port), *words, before=before) as process:
        assert process.stdout and process.stderr
        url = urlsplit(process.stdout.readline().strip())
        assert url.port is not None, process.stderr.read()
        for line in process.stderr:  # of a log also how far it was read
            if "Ctrl-C ends" in line:
                break
        yield Host(process, url.port, url.fragment)


class Client:
    """A client with the token; what is waited for comes within ANSWER_S, or it is an error."""

    def __init__(self, host: Host, **more: Any) -> None:
        self._connection = host.connect()
        self.socket = self._connection.__enter__()
        self._events: list[dict[str, Any]] = []  # that came before an answer
        self.say(do="hello", token=host.token, **more)
        self.about: dict[str, Any] = self.until("about")["about"]
        self.last = 0

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *error: object) -> None:
        self._connection.__exit__(None, None, None)

    def say(self, **message: Any) -> None:
        """Send a message."""
        self.socket.send(json.dumps(message))

    def next(self) -> Any:
        """Return what comes next: a message, or the head and the values of a panel."""
        found = self.socket.recv(timeout=ANSWER_S)
        if isinstance(found, str):
            return json.loads(found)
        return np.frombuffer(found, np.float64, 8), np.frombuffer(found, np.float32, offset=64)

    def _until(self, met: Callable[[Any], bool], what: str) -> Any:
        """Return the next for which `met` is true; others may come all the time."""
        end_s = time.monotonic() + ANSWER_S
        while not met(found := self.next()):
            assert time.monotonic() < end_s, f"no {what} within {ANSWER_S:g} s"
        return found

    def until(self, key: str) -> dict[str, Any]:
        """Return the next message that has this key."""
        return dict(self._until(lambda found: isinstance(found, dict) and key in found, key))

    def event(self, name: str) -> dict[str, Any]:
        """Return the next event about `name`, also one that came before an answer."""
        end_s = time.monotonic() + ANSWER_S
        while True:
            found = self._events.pop(0) if self._events else self.until("event")["event"]
            if found.get("name") == name:
                return dict(found)
            assert time.monotonic() < end_s, f"no event about {name} within {ANSWER_S:g} s"

    def panel(self, number: int) -> tuple[Any, Any]:
        """Return the next head and values of a panel."""
        head, values = self._until(
            lambda found: isinstance(found, tuple) and found[0][1] == number, f"panel {number}"
        )
        return head, values

    def ask(self, **message: Any) -> dict[str, Any]:
        """Ask for something; return the answer."""
        self.last += 1
        self.say(id=self.last, **message)

        def answers(found: Any) -> bool:
            if isinstance(found, dict) and "event" in found:
                self._events.append(found["event"])
            return isinstance(found, dict) and self.last in (
                found.get("done"),
                found.get("refused"),
            )

        return dict(self._until(answers, f"answer to {message}"))
