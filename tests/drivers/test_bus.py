"""Real buses: our sockets among themselves and with python-can, refusals with their cure, locks."""

import atexit
import inspect
import os
import re
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest
from can.interfaces.udp_multicast import UdpMulticastBus
from free_bus import own_port
from hypothesis import given, settings
from hypothesis import strategies as st
from places import PATIENCE_S
from wires import new_wire, receive, send

from pcpc.drivers.can import bus, choice, python_can_port, wire
from pcpc.drivers.can.bus import BusAddress
from pcpc.drivers.can.dbc import BusError
from pcpc.drivers.can.wire_layout import Arrival, Medium
from pcpc.drivers.compiled.jit import LOOP_INTERPRETED
from pcpc.drivers.machine import outside

OTHER_GROUP, THIRD_GROUP = "239.74.163.9", "239.74.163.10"
GROUPS = (bus.UDP_GROUP, OTHER_GROUP)

Open = Callable[[str], Any]


def own_channel(group: str = bus.UDP_GROUP) -> str:
    """Return a group and a port on which nobody else is."""
    return f"{group}:{own_port(group)}"


@pytest.fixture
def open_udp() -> Iterator[Open]:
    """Open udp_multicast wires that are closed after the test."""
    wires = []

    def opener(channel: str) -> Any:
        end = new_wire()
        bus.open_bus(BusAddress("udp_multicast", channel), [], end)
        wires.append(end)
        return end

    yield opener
    for end in wires:
        os.close(end.fd_tx)
        os.close(end.fd_rx)


def test_who_only_sends_keeps_the_group_open_for_listeners_that_joined_elsewhere(
    open_udp: Open,
) -> None:
    """python-can joins at the interface of the default route, where loopback's frames are not."""
    channel = own_channel("239.74.163.12")
    end = open_udp(channel)
    os.close(end.fd_rx)  # as a player does
    end.fd_rx = os.dup(end.fd_tx)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.settimeout(PATIENCE_S)
        listener.bind(bus.udp_address(channel))
        with socket.socket(fileno=os.dup(end.fd_tx)) as sender:
            sender.send(b"frame")
        assert listener.recv(100) == b"frame"


@pytest.fixture
def open_python_can() -> Iterator[Callable[..., can.BusABC]]:
    """Open python-can buses that are shut down after the test."""
    buses = []

    def opener(**options: Any) -> can.BusABC:
        buses.append(can.Bus(interface="udp_multicast", **options))
        return buses[-1]

    yield opener
    for python_can in buses:
        python_can.shutdown()


@pytest.mark.parametrize("group", GROUPS)
def test_two_wires_exchange_frames_and_a_sender_hears_itself(open_udp: Open, group: str) -> None:
    channel = own_channel(group)
    a, b = open_udp(channel), open_udp(channel)
    send(a, 0x123, b"from a")
    send(b, 0x1ABCDEF0, b"", extended=True)
    expected = [(0x123, b"from a"), (0x9ABCDEF0, b""), Arrival.NOTHING]
    for name, end in (("a", a), ("b", b)):
        got = [receive(end) for _ in expected]
        assert got == expected, f"{name} received {got}"


def test_an_end_on_two_buses_sends_by_the_id_and_hears_both(open_udp: Open) -> None:
    channels = own_channel(), own_channel(OTHER_GROUP)
    end, first, second = open_udp(channels[0]), *map(open_udp, channels)
    bus.open_second(BusAddress("udp_multicast", channels[1]), [], end)
    bus.set_own_address(end)
    end.second[0], end.n_second = 0x9ABCDEF0, 1
    send(end, 0x123, b"first")
    send(end, 0x1ABCDEF0, b"second", extended=True)
    assert [receive(one) for one in (first, second)] == [(0x123, b"first"), (0x9ABCDEF0, b"second")]
    assert [receive(end) for _ in range(3)] == [Arrival.OWN, Arrival.OWN, Arrival.NOTHING]
    send(second, 2, b"")
    assert wire._wait_for_either(end) == 1
    assert receive(end) == (2, b"") and wire.get_frame(end, False) == Arrival.NOTHING
    later = threading.Timer(0.01, send, (second, 5, b""))
    later.start()
    looks, begin_s = 0, time.monotonic()
    while (taken := receive(end)) == Arrival.NOTHING:  # it waits for both
        looks += 1
    assert taken == (5, b"") and time.monotonic() - begin_s > looks * 0.99e-3 * wire.WAIT_MS
    end.in_turn = 1  # it waits for one bus after the other
    send(second, 3, b"")
    assert receive(end) == Arrival.NOTHING
    send(first, 4, b"")
    assert receive(end) == (4, b"")
    end.muted = 1
    assert receive(end) == (3, b"")
    os.close(end.fd_tx2)
    os.close(end.fd_rx2)


def test_a_listener_hears_frames_with_the_time_at_which_they_came(open_udp: Open) -> None:
    channel, before = own_channel(), len(os.listdir("/proc/self/fd"))
    with bus.listener(BusAddress("udp_multicast", channel)) as ear:
        assert len(os.listdir("/proc/self/fd")) == before + 1, "it sends nothing"
        send(open_udp(channel), 0x123, b"frame")
        text, more, *_ = ear.recvmsg(2048, 64)
    assert b"frame" in text and [kind for _, kind, _ in more] == [35], "SCM_TIMESTAMPNS of Linux"


def test_a_bus_of_python_can_that_fails_is_told() -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise can.CanError("no")

    end, broken = new_wire(), SimpleNamespace(send=refuse, recv=refuse, shutdown=refuse)
    end.fd_tx = python_can_port.register(broken)  # type: ignore[arg-type]
    atexit.unregister(broken.shutdown)
    assert not python_can_port.put(end)
    assert python_can_port.get(end, True) == Arrival.FAILED


@pytest.mark.parametrize("group", GROUPS)
def test_a_burst_waits_in_the_socket_in_order(open_udp: Open, group: str) -> None:
    channel = own_channel(group)
    a, b = open_udp(channel), open_udp(channel)
    for k in range(200):
        send(a, k, bytes([k]))
    got = [receive(b) for _ in range(200)]
    assert got == [(k, bytes([k])) for k in range(200)], f"{got}"


@pytest.mark.parametrize("group", GROUPS)
def test_python_can_on_the_group_and_we_hear_each_other(
    open_udp: Open, open_python_can: Callable[..., can.BusABC], group: str
) -> None:
    port = own_port(group)
    ours, theirs = open_udp(f"{group}:{port}"), open_python_can(channel=group, port=port)
    send(ours, 0x1ABCDEF0, b"12345678", extended=True)
    message = theirs.recv(PATIENCE_S)
    assert message is not None, "python-can received nothing"
    got = (message.arbitration_id, message.is_extended_id, bytes(message.data))
    assert got == (0x1ABCDEF0, True, b"12345678"), f"python-can received {message}"
    theirs.send(can.Message(arbitration_id=0x55, data=b"hi", is_extended_id=False))
    heard = [receive(ours), receive(ours), receive(ours)]
    assert heard == [(0x9ABCDEF0, b"12345678"), (0x55, b"hi"), Arrival.NOTHING], f"{heard}"


def test_python_can_without_a_channel_hears_each_of_our_frames_once(
    open_udp: Open, open_python_can: Callable[..., can.BusABC]
) -> None:
    port = own_port(bus.UDP_GROUP)
    ours, viewer = open_udp(f"{bus.UDP_GROUP}:{port}"), open_python_can(port=port)
    named = open_python_can(channel=bus.UDP_GROUP, port=port)
    for k in range(3):
        send(ours, 0x100 + k, b"")
    for name, theirs in (("no channel", viewer), ("named group", named)):
        got = [theirs.recv(PATIENCE_S) for _ in range(3)] + [theirs.recv(0.0)]
        ids = [message and message.arbitration_id for message in got]
        assert ids == [0x100, 0x101, 0x102, None], f"{name}: {ids}"


def test_our_default_is_python_cans_group_and_port() -> None:
    port = inspect.signature(UdpMulticastBus.__init__).parameters["port"].default
    address = bus.udp_address(bus.bus_named("udp_multicast", None).channel)
    assert address == (UdpMulticastBus.DEFAULT_GROUP_IPv4, port), f"{address}"


def test_groups_on_one_port_are_separate_and_unicasts_are_not_heard(open_udp: Open) -> None:
    port = own_port(bus.UDP_GROUP)
    channels = [f"{group}:{port}" for group in (*GROUPS, THIRD_GROUP)]
    ends = {channel: open_udp(channel) for channel in channels}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(wire.TEMPLATE, (bus.LOOPBACK, port))
    for k, end in enumerate(ends.values()):
        send(end, k, b"")
    for k, (channel, end) in enumerate(ends.items()):
        got = [receive(end), receive(end)]
        assert got == [(k, b""), Arrival.NOTHING], f"{channel} heard {got}"


@pytest.mark.parametrize(
    "datagram",
    [b"", b"x", b"\x8b" + bytes(50), wire.TEMPLATE[:-1], wire.TEMPLATE + bytes(600), bytes(3000)],
    ids=len,
)
def test_a_strange_datagram_is_foreign_and_the_next_frame_is_read(
    open_udp: Open, datagram: bytes
) -> None:
    end = open_udp(own_channel())
    sender = socket.socket(fileno=os.dup(end.fd_tx))
    with sender:
        sender.send(datagram)
    send(end, 1, b"next")
    got = [receive(end), receive(end)]
    assert got == [Arrival.FOREIGN, (1, b"next")], f"{got}"


def test_an_empty_bus_gives_nothing_with_and_without_blocking(open_udp: Open) -> None:
    end = open_udp(own_channel())
    got = [wire.get_frame(end, False), wire.get_frame(end, True)]
    assert got == [Arrival.NOTHING, Arrival.NOTHING], f"{got}"


@pytest.mark.parametrize("group", GROUPS)
def test_a_port_of_a_program_that_does_not_share_is_named(group: str) -> None:
    port = own_port(group)
    descriptors = len(os.listdir("/proc/self/fd"))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as selfish:
        selfish.bind(("", port))
        with pytest.raises(BusError, match=rf"port {port} is in use .* --bus udp_multicast:239"):
            bus.open_bus(BusAddress("udp_multicast", f"{group}:{port}"), [], new_wire())
    left = len(os.listdir("/proc/self/fd"))
    assert left == descriptors, f"{left - descriptors} descriptors left open"


@pytest.mark.parametrize(
    "channel",
    ["vcan0", "10.0.0.1", "240.0.0.1", "ff15::1", "239.1", "239.1.1.1 x", "239.1.1.1:x",
     "239.1.1.1:0", "239.1.1.1:65536", "239.1.1.1:-1", "239.1.1.1\0", "", ":43113"],
)  # fmt: skip
def test_a_bad_channel_is_refused_with_an_example(channel: str) -> None:
    with pytest.raises(BusError, match=rf"expected an IPv4 multicast group .* {bus.UDP_GROUP}:"):
        bus.open_bus(BusAddress("udp_multicast", channel), [], new_wire())


@given(st.text() | st.from_regex(r"\d{1,4}(\.\d{1,4}){0,4}(:\d{0,6})?", fullmatch=True))
@settings(deadline=None)
def test_any_channel_text_is_an_address_or_a_bus_error(channel: str) -> None:
    try:
        group, port = bus.udp_address(channel)
    except BusError:
        return
    assert re.fullmatch(r"2[23]\d(\.\d{1,3}){3}", group) and 0 < port < 65536, f"{group} {port}"


def test_a_missing_can_interface_is_refused_with_the_cure() -> None:
    with pytest.raises(BusError) as refused:
        bus.open_bus(BusAddress("socketcan", "vcan77"), [0x80], new_wire())
    text = str(refused.value)
    for part in ("vcan77: ", "ip link add dev vcan77 type vcan", "pcpc vm", "udp_multicast"):
        assert part in text, f"{part!r} is not in {text!r}"


@pytest.mark.parametrize("name", ["can7", "slcan7", "mycan"])
def test_a_missing_adapter_is_not_replaced_by_a_virtual_one(name: str) -> None:
    with pytest.raises(BusError) as refused:
        bus.open_bus(BusAddress("socketcan", name), [0x80], new_wire())
    text = str(refused.value)
    assert f"ip link set {name} up type can bitrate 1000000" in text, text
    assert "type vcan" not in text, text


@pytest.mark.parametrize("name", ["a" * 16, "b" * 300])
def test_an_impossible_interface_name_is_a_bus_error(name: str) -> None:
    with pytest.raises(BusError, match=rf"^{name}: "):
        bus.open_bus(BusAddress("socketcan", name), [], new_wire())


def test_another_interface_of_python_can_needs_the_interpreted_loop() -> None:
    end, wanted = new_wire(), BusAddress("virtual", "test")
    if not LOOP_INTERPRETED:
        with pytest.raises(BusError, match="PCPC_LOOP=interpreted"):
            bus.open_bus(wanted, [], end)
        return
    bus.open_bus(wanted, [], end)
    with can.Bus(interface="virtual", channel="test") as theirs:
        send(end, 0x1ABCDEF0, b"123", extended=True)
        message = theirs.recv(PATIENCE_S)
        assert message is not None and message.arbitration_id == 0x1ABCDEF0, f"{message}"
        assert bytes(message.data) == b"123" and message.is_extended_id, f"{message}"
        for sent in (
            can.Message(arbitration_id=0x7FF, data=b"hi", is_extended_id=False),
            can.Message(arbitration_id=1, data=bytes(12), is_fd=True),
            can.Message(arbitration_id=1, is_remote_frame=True),
            can.Message(arbitration_id=1, data=bytes(12), check=False),
        ):
            theirs.send(sent)
        got = [receive(end) for _ in range(5)]
        foreign = [Arrival.FOREIGN] * 3
        assert got == [(0x7FF, b"hi"), *foreign, Arrival.NOTHING], f"{got}"


CABLE = """
import socket
left = []

def opened(channel, fd):
    if channel != "1":
        raise ValueError(f"no cable {channel}")
    pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(2)]
    left.extend(far.detach() for _, far in pairs)
    return [near for near, _ in pairs]
"""


@pytest.fixture
def cable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Return the name of a bus of a package that this process finds."""
    name = f"cable{os.getpid()}"
    (info := tmp_path / f"{name}-1.0.dist-info").mkdir()
    (tmp_path / f"{name}.py").write_text(CABLE)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    points = f"[pcpc.buses]\n{name} = {name}:opened\nno{name} = no{name}:opened\n"
    (info / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(str(tmp_path))
    outside._all_additions.cache_clear()
    yield name
    outside._all_additions.cache_clear()
    sys.modules.pop(name, None)


def test_a_bus_of_a_package_carries_frames_or_says_why_it_cannot(cable: str) -> None:
    ends = new_wire(), new_wire()
    bus.open_bus(BusAddress(cable, "1"), [], ends[0])
    wire.prepare(ends[1], Medium.SOCKETCAN, *sys.modules[cable].left[::-1])
    for end, other in (ends, ends[::-1]):
        send(end, 0x123, b"abc")
        assert receive(other) == (0x123, b"abc")
    with socket.socket(fileno=os.dup(ends[0].fd_rx)) as receiver:
        limit = receiver.getsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, 16)
    seconds, us = struct.unpack("@ll", limit)
    assert seconds == 0 < us, "a receive ends, and the stop word is looked at"
    for end in ends:
        os.close(end.fd_tx)
        os.close(end.fd_rx)
    for name, channel, said in (
        (cable, "2", f"^{cable}:2: .* cannot open it: ValueError: no cable 2$"),
        (f"no{cable}", "1", f"ModuleNotFoundError: No module named 'no{cable}'"),
    ):
        with pytest.raises(BusError, match=said):
            bus.open_bus(BusAddress(name, channel), [], new_wire())
    with pytest.raises(BusError, match="who only listens needs socketcan or udp_multicast"):
        bus.listener(BusAddress(cable, "1"))


def test_a_bus_that_python_can_cannot_open_is_a_bus_error() -> None:
    with pytest.raises(BusError, match=r"^no_such_interface:x: "):
        bus.open_bus(BusAddress("no_such_interface", "x"), [], new_wire())


@pytest.mark.parametrize(
    ("text", "interface", "channel"),
    [
        ("auto", "auto", None), ("udp_multicast", "udp_multicast", None),
        ("udp_multicast:239.1.1.1:47000", "udp_multicast", "239.1.1.1:47000"),
        ("vcan0", "socketcan", "vcan0"), ("can7", "socketcan", "can7"),
        ("socketcan:vcan1", "socketcan", "vcan1"), ("socketcan", "socketcan", None),
        ("canalystii", "canalystii", None), ("cantact:0", "cantact", "0"),
        ("virtual", "virtual", None), ("pcan:PCAN_USBBUS1", "pcan", "PCAN_USBBUS1"),
    ],
)  # fmt: skip
def test_a_bus_text_is_split_as_written(text: str, interface: str, channel: str | None) -> None:
    got = bus.parse(text)
    assert got == (interface, channel), f"{text} became {got}"


def test_auto_is_a_bus_that_opens() -> None:
    taken = choice.take_bus(choice.BusRequest("auto", None, "test", ()))
    chosen, end = taken.bus, new_wire()
    bus.open_bus(chosen, [], end)
    taken.release()
    for descriptor in {int(end.fd_tx), int(end.fd_rx)}:
        os.close(descriptor)
    assert chosen.compiled and end.kind in (Medium.SOCKETCAN, Medium.UDP), f"{chosen}"
