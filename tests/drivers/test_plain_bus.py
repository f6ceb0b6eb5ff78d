"""A SocketCAN bus in Python that takes nothing: its end of the socket is that of a pair here."""

import errno
import select
import socket
import struct
import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import msgpack
import pytest
from free_bus import own_bus

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import can_id, plain_bus
from pcpc.drivers.can.plain_bus import BusFrame, Can
from pcpc.drivers.can.wire_layout import Flag
from pcpc.drivers.errors import BusError

FRAME = BusFrame(0x123, b"\x01\x02")


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


GOOD = {"arbitration_id": 0x7FF, "is_extended_id": False, "data": b"hi"}
STRANGE: list[Any] = [
    None, 5, "text", [1], {}, {"data": b""}, {"arbitration_id": 1},
    *(GOOD | {"arbitration_id": one} for one in (
        float("inf"), float("nan"), -1, 0x800, 1 << 29, 1 << 63, "x", None, [1], b"1x")),
    *(GOOD | {"is_extended_id": True, "arbitration_id": one} for one in (-1, 1 << 29)),
    *(GOOD | {"data": one} for one in (1 << 40, -1, 2.0, "hi", None, [1, 2], {})),
    *(GOOD | {"data": bytes(n)} for n in (9, 12)),
    *(GOOD | {"is_fd": True, "data": bytes(n)} for n in (9, 65)),
    GOOD | {"is_remote_frame": True}, GOOD | {"is_error_frame": 1},
]  # fmt: skip


@pytest.mark.parametrize("said", STRANGE, ids=repr)
def test_a_strange_datagram_is_no_frame(said: Any) -> None:
    assert plain_bus.frame_of_datagram(msgpack.packb(said)) is None


@pytest.mark.parametrize("text", [b"", b"\xc1", b"\x81", b"\xc7\xff\xff", b"\x93" * 600, b"junk"])
def test_what_is_no_message_at_all_is_no_frame(text: bytes) -> None:
    assert plain_bus.frame_of_datagram(text) is None


def test_a_datagram_with_the_largest_numbers_is_a_frame() -> None:
    def frame(**said: Any) -> BusFrame | None:
        return plain_bus.frame_of_datagram(msgpack.packb(GOOD | said))

    assert frame() == (0x7FF, b"hi", Flag.NONE)
    word = can_id.word_of(can_id.ID, True)
    assert frame(is_extended_id=True, arbitration_id=can_id.ID) == (word, b"hi", Flag.NONE)
    assert frame(is_fd=True, bitrate_switch=True, data=bytes(64)) == (
        0x7FF, bytes(64), Flag.FD | Flag.BRS
    )  # fmt: skip


def test_frames_go_both_ways_over_udp_and_none_of_its_own_comes_back() -> None:
    channel = own_bus().removeprefix("udp_multicast:")
    one, other = (plain_bus.open_bus(buses.BusAddress("udp_multicast", channel)) for _ in range(2))
    extended = can_id.word_of(0x18FF0001, True)
    sent = [FRAME, BusFrame(extended, bytes(12), Flag.FD | Flag.BRS), BusFrame(1, b"", Flag.FD)]
    for frame in sent:
        one.put(*frame)
    assert isinstance(one, plain_bus.Udp)
    one._tx.send(b"no frame")
    assert select.select([other.fileno()], [], [], 2.0)[0]
    assert [*other.frames()] == sent and [*one.frames()] == []
    one.close()
    other.close()


def test_frames_go_both_ways_over_can(
    monkeypatch: pytest.MonkeyPatch, ends: tuple[Can, socket.socket]
) -> None:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    monkeypatch.setattr(buses, "_open_socketcan", lambda channel, ids: far.detach())
    monkeypatch.setattr(socket.socket, "setsockopt", lambda *words: options.append(words[1:]))
    options: list[tuple[int, ...]] = []
    monkeypatch.setattr(buses, "_mtu", lambda channel: 72)
    bus = plain_bus.open_bus(buses.BusAddress("socketcan", "can7"))
    assert options == [(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)]
    bus.put(0x123, bytes(12), Flag.FD | Flag.BRS)
    assert near.recv(100) == struct.pack("<IBB2x64x", 0x123, 12, Flag.FD | Flag.BRS)
    bus.put(*FRAME)
    assert near.recv(100) == struct.pack("<IB3x8s", 0x123, 2, FRAME.data)
    for word, n, size in ((1, 2, 16), (1 | can_id.REMOTE, 2, 16), (1 | can_id.ERROR, 2, 16),
                          (1, 9, 16), (2, 12, 72)):  # fmt: skip
        near.send(struct.pack("<IBB", word, n, Flag.BRS).ljust(size, b"\0"))
    assert bus.fileno() == bus._can.fileno()  # type: ignore[union-attr]
    got = [BusFrame(1, bytes(2)), BusFrame(2, bytes(12), Flag.FD | Flag.BRS)]
    assert [*bus.frames()] == got
    bus.close()
    near.close()
    with pytest.raises(BusError, match=r"^can7: the interface has no CAN FD; run `sudo ip link"):
        ends[0].put(1, bytes(12), Flag.FD)


def test_no_other_bus_is_opened() -> None:
    with pytest.raises(BusError, match=r"^pcan:x: expected socketcan or udp_multicast$"):
        plain_bus.open_bus(buses.BusAddress("pcan", "x"))
