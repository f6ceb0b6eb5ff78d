"""A SocketCAN bus in Python that takes nothing: its end of the socket is that of a pair here."""

import errno
import socket
import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import plain_bus
from pcpc.drivers.can.plain_bus import Can, Frame
from pcpc.drivers.errors import BusError

FRAME = Frame(0x123, b"\x01\x02")


@pytest.fixture
def ends(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Can, socket.socket]]:
    """Yield a bus, and what takes its frames; ten wait in between."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    monkeypatch.setattr(buses, "_open_socketcan", lambda channel, ids: near.detach())
    monkeypatch.setattr(buses, "_mtu", lambda channel: 16)
    bus = Can("can7", None)
    with far:
        yield bus, far
    bus.close()


def fill(bus: Can) -> None:
    for _ in range(10_000):
        if not bus.offer(*FRAME):
            return
    pytest.fail("it takes all")


def test_a_full_queue_refuses_a_frame_at_once(ends: tuple[Can, socket.socket]) -> None:
    fill(ends[0])
    assert not ends[0].offer(*FRAME)
    ends[1].recv(64)
    assert ends[0].offer(*FRAME)


def test_a_bus_that_takes_nothing_is_given_up(
    ends: tuple[Can, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    fill(ends[0])
    monkeypatch.setattr(plain_bus, "PATIENCE_S", 0.05)
    with pytest.raises(BusError, match=r"^can7: took no frame for 0\.05 s; connect a node "):
        ends[0].put(*FRAME)


def test_one_that_takes_a_frame_in_the_end_is_waited_for(ends: tuple[Can, socket.socket]) -> None:
    fill(ends[0])
    reader = threading.Timer(0.05, ends[1].recv, (64,))
    reader.start()
    ends[0].put(*FRAME)
    reader.join()


@pytest.mark.parametrize(
    ("number", "waits"), [(errno.ENOBUFS, True), (errno.EAGAIN, True), (errno.ENETDOWN, False)]
)
def test_only_a_full_queue_is_waited_for(
    ends: tuple[Can, socket.socket], number: int, waits: bool
) -> None:
    def refuse(*_: Any) -> int:
        raise OSError(number, "no")

    bus = ends[0]
    real, bus._can = bus._can, SimpleNamespace(send=refuse)  # type: ignore[assignment]
    if waits:
        assert not bus.offer(*FRAME)
    else:
        with pytest.raises(OSError, match="no"):
            bus.offer(*FRAME)
    bus._can = real
