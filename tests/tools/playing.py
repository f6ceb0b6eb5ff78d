"""A `pcpc play` in a process of its own, and who hears its bus."""

import socket
import subprocess
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
from copies import program
from json_schemas import holds
from processes import ROOT

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can.wire_layout import Wire

ENOUGH_S = 120.0

Sent = tuple[int, bytes]  # id, data


class Listener:
    """Hears a bus in python-can's udp_multicast format, decoded by msgpack."""

    def __init__(self, bus: str) -> None:
        end = np.zeros(1, Wire.dtype).view(np.recarray)[0]
        buses.open_bus(buses.bus_named(*buses.parse(bus)), [], end)
        socket.socket(fileno=int(end.fd_tx)).close()
        self.socket = socket.socket(fileno=int(end.fd_rx))  # with a time-out of 0.1 s
        self.heard: list[Sent] = []

    def hear(self, at_least: int, running: Callable[[], bool]) -> None:
        """Listen until `at_least` frames have come, or nobody runs and nothing comes any more."""
        on = True
        while on and len(self.heard) < at_least:
            on = running()
            with suppress(BlockingIOError):
                while len(self.heard) < at_least:
                    message = msgpack.unpackb(self.socket.recv(512))
                    self.heard.append((message["arbitration_id"], message["data"]))


class Playing:
    """A player in a process of its own, and what a listener on its bus hears."""

    def __init__(self, path: Path, bus: str, *words: str) -> None:
        self.listener = Listener(bus)
        self.process = subprocess.Popen(
            [program(), "play", str(path), "--bus", bus, "--json", *words],
            cwd=ROOT,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )

    @property
    def heard(self) -> list[Sent]:
        """The frames heard so far."""
        return self.listener.heard

    def hear(self, at_least: int) -> None:
        """Listen until `at_least` frames have come or the player has ended."""
        self.listener.hear(at_least, lambda: self.process.poll() is None)

    def result(self, text: str = "") -> tuple[int, dict[str, Any], str]:
        """Return exit code, the printed JSON and stderr."""
        out, err = self.process.communicate(text, timeout=ENOUGH_S)
        assert out, f"{self.process.returncode}, no result: {err}"
        return self.process.returncode, dict(holds("play", out)), err

    def __enter__(self) -> "Playing":
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()
        self.listener.socket.close()
