"""A host in a process of its own, and clients that speak to it as they like."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from websockets.sync.client import connect

ANSWER_S = 30.0
LONG = {
    "duration_s": 3600.0, "rate_hz": 200.0, "supervisor.hold_cycles": 10**6,
    "supervisor.fault_after_cycles": 10**6,
}  # fmt: skip


@dataclass
class Host:
    """Where it listens, and the token that its pages have."""

    process: "subprocess.Popen[str]"
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
) -> Iterator["subprocess.Popen[str]"]:
    """Start `pcpc host`, whose token lies in `folder`; end it as Ctrl-C does, if it goes on.

    `before`: the words of a command that starts it, as prlimit does.
    """
    process = subprocess.Popen(
        [*before, sys.executable, "-m", "pcpc.tools.cli", "host", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"XDG_STATE_HOME": str(folder)},
    )  # fmt: skip
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
    """A client with the token."""

    def __init__(self, host: Host, **more: Any) -> None:
        self._connection = host.connect()
        self.socket = self._connection.__enter__()
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

    def until(self, key: str) -> dict[str, Any]:
        """Return the next message that has this key; others may come all the time."""
        end_s = time.monotonic() + ANSWER_S
        while True:
            assert time.monotonic() < end_s, f"no {key} within {ANSWER_S:g} s"
            found = self.next()
            if isinstance(found, dict) and key in found:
                return found

    def panel(self, number: int) -> tuple[Any, Any]:
        """Return the next head and values of a panel."""
        while True:
            found = self.next()
            if isinstance(found, tuple) and found[0][1] == number:
                return found

    def ask(self, **message: Any) -> dict[str, Any]:
        """Ask for something; return the answer."""
        self.last += 1
        self.say(id=self.last, **message)
        while True:
            found = self.next()
            if isinstance(found, dict) and self.last in (found.get("done"), found.get("refused")):
                return found
