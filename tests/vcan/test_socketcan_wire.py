"""Our frames on a real SocketCAN interface, alone and with python-can; `pcpc vm` has vcan0."""

import errno
import os
import subprocess
from collections.abc import Callable, Iterator
from typing import Any

import can
import pytest
from wires import new_wire, receive, send

from pcpc.drivers.can import bus, wire
from pcpc.drivers.can.bus import BusAddress
from pcpc.drivers.can.dbc import BusError
from pcpc.drivers.can.wire_layout import Arrival

pytestmark = pytest.mark.vcan

CHANNEL = "vcan0"
WAIT_S = 5.0  # only waited for when a frame is lost

Open = Callable[[list[int]], Any]


@pytest.fixture
def open_can() -> Iterator[Open]:
    """Open wires on vcan0 that are closed after the test."""
    wires = []

    def opener(receive_ids: list[int]) -> Any:
        end = new_wire()
        bus.open_bus(BusAddress("socketcan", CHANNEL), receive_ids, end)
        wires.append(end)
        return end

    yield opener
    for end in wires:
        os.close(end.fd_rx)


@pytest.fixture
def python_can() -> Iterator[can.BusABC]:
    """python-can's own SocketCAN bus, with CAN FD off."""
    with can.Bus(interface="socketcan", channel=CHANNEL) as opened:
        yield opened


def test_two_wires_exchange_frames_and_hear_only_each_other(open_can: Open) -> None:
    a, b = open_can([0x123, 0x124]), open_can([0x123, 0x124])
    send(a, 0x123, b"from a")
    send(b, 0x124, b"12345678")
    got = [receive(a), receive(a), receive(b), receive(b)]
    expected = [
        (0x124, b"12345678"),
        Arrival.NOTHING,
        (0x123, b"from a"),
        Arrival.NOTHING,
    ]
    assert got == expected, f"{got}"


def test_a_burst_waits_in_the_socket_in_order(open_can: Open) -> None:
    a, b = open_can([]), open_can(list(range(200)))
    for k in range(200):
        send(a, k, bytes([k]))
    got = [receive(b) for _ in range(200)]
    assert got == [(k, bytes([k])) for k in range(200)], f"{got}"


def test_python_can_and_we_read_each_other(open_can: Open, python_can: can.BusABC) -> None:
    ours = open_can([0x55, 0x1ABCDEF0])
    send(ours, 0x1ABCDEF1, b"12345678", extended=True)
    send(ours, 0x7FF, b"")
    for expected in ((0x1ABCDEF1, True, b"12345678"), (0x7FF, False, b"")):
        message = python_can.recv(WAIT_S)
        assert message is not None, f"python-can did not receive {expected}"
        got = (message.arbitration_id, message.is_extended_id, bytes(message.data))
        assert got == expected, f"python-can received {got}"
    python_can.send(can.Message(arbitration_id=0x55, data=b"hi", is_extended_id=False))
    python_can.send(can.Message(arbitration_id=0x1ABCDEF0, data=b"", is_extended_id=True))
    heard = [receive(ours), receive(ours), receive(ours)]
    assert heard == [(0x55, b"hi"), (0x9ABCDEF0, b""), Arrival.NOTHING], f"{heard}"


def test_only_data_frames_with_the_wanted_ids_arrive(
    open_can: Open, python_can: can.BusABC
) -> None:
    ours = open_can([0x123])
    for message in (
        can.Message(arbitration_id=0x122, is_extended_id=False),
        can.Message(arbitration_id=0x123, is_extended_id=True),
        can.Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True),
        can.Message(arbitration_id=0x123, is_extended_id=False, data=b"wanted"),
    ):
        python_can.send(message)
    got = [receive(ours), receive(ours)]
    assert got == [(0x123, b"wanted"), Arrival.NOTHING], f"{got}"


def test_a_wire_without_ids_hears_nothing(open_can: Open, python_can: can.BusABC) -> None:
    ours = open_can([])
    python_can.send(can.Message(arbitration_id=0x123, is_extended_id=False))
    got = [wire.get_frame(ours, False), wire.get_frame(ours, True)]
    assert got == [Arrival.NOTHING, Arrival.NOTHING], f"{got}"


def test_candump_reads_what_we_send(open_can: Open) -> None:
    ours = open_can([0x321])
    with subprocess.Popen(
        ["candump", "-L", "-n", "1", "-T", "10000", CHANNEL], stdout=subprocess.PIPE, text=True
    ) as candump:
        assert candump.stdout is not None
        while candump.poll() is None and not somebody_hears_all_frames():
            pass
        send(ours, 0x123, b"\xc0\xff\xee")
        line = candump.stdout.readline()
    assert line.split()[1:] == [CHANNEL, "123#C0FFEE"], f"candump printed {line!r}"


def somebody_hears_all_frames() -> bool:
    """Return True if a socket without filter is bound to vcan0: candump is, our wires are not."""
    with open("/proc/net/can/rcvlist_all") as receivers:
        return any(line.split()[:1] == [CHANNEL] for line in receivers)


def test_a_missing_interface_is_named_with_the_cure() -> None:
    with pytest.raises(BusError, match=r"^vcan77: no such interface; .*ip link add dev vcan77"):
        bus.open_bus(BusAddress("socketcan", "vcan77"), [], new_wire())


def test_an_interface_that_is_down_is_named_with_the_cure() -> None:
    name = f"vcan{os.getpid() % 100000}"
    subprocess.run(["ip", "link", "add", "dev", name, "type", "vcan"], check=True)
    try:
        with pytest.raises(BusError, match=rf"^{name}: the interface is down; .*set {name} up"):
            bus.open_bus(BusAddress("socketcan", name), [], new_wire())
    finally:
        subprocess.run(["ip", "link", "del", name], check=True)


def test_an_interface_taken_down_fails_with_its_error_number() -> None:
    name = f"vcan{os.getpid() % 100000}"
    assert bus.vcan_ready(name), f"{name} cannot be created"
    try:
        end = new_wire()
        bus.open_bus(BusAddress("socketcan", name), [1], end)
        subprocess.run(["ip", "link", "set", name, "down"], check=True)
        got = wire.get_frame(end, True)
        assert got == Arrival.FAILED and end.errno == errno.ENETDOWN, f"{got}, errno {end.errno}"
        assert not wire.put_frame(end) and end.errno == errno.ENETDOWN, f"errno {end.errno}"
        os.close(end.fd_rx)
    finally:
        subprocess.run(["ip", "link", "del", name], check=True)


def test_auto_is_vcan0() -> None:
    assert bus.bus_named("auto", None) == BusAddress("socketcan", CHANNEL)


def test_an_error_frame_is_heard_as_one(open_can: Open, python_can: can.BusABC) -> None:
    ours = open_can([0x123])
    python_can.send(
        can.Message(arbitration_id=0x040, is_error_frame=True, is_extended_id=False, data=bytes(8))
    )
    assert receive(ours) == Arrival.BUS_ERROR
    assert int.from_bytes(ours.rx[:4].tobytes(), "little") == 0x2000_0040
    assert receive(ours) == Arrival.NOTHING
