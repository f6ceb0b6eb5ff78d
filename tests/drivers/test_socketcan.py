"""SocketCAN's options, filters and cures, on a socket that notes what it is told.

A kernel with CAN has the same by `make test-vcan`.
"""

import errno
import io
import socket
import struct
import subprocess
from types import SimpleNamespace
from typing import Any

import pytest
from wires import new_wire

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import wire
from pcpc.drivers.can.bus import BusAddress
from pcpc.drivers.can.wire_layout import Arrival, Flag, Medium
from pcpc.drivers.errors import BusError

UP, DOWN = "0x41\n", "0x40\n"


class Machine:
    """A machine with interfaces: their flags and their sizes; its sockets are 77."""

    def __init__(self) -> None:
        self.flags: dict[str, str] = {"vcan0": UP, "can0": UP}
        self.mtu, self.root, self.sockets = 16, True, 0
        self.options: dict[int, Any] = {}
        self.commands: list[str] = []
        self.refusals: dict[str, OSError | Exception] = {}
        self.code = 0

    def refuse(self, what: str) -> None:
        if what in self.refusals:
            raise self.refusals[what]

    def socket(self, *_: Any, fileno: int | None = None) -> "Machine":
        self.refuse("socket")
        self.sockets += 1
        return self

    def setsockopt(self, level: int, option: int, value: Any) -> None:
        self.refuse(f"option {option}")
        self.options[option] = value

    def bind(self, address: tuple[str]) -> None:
        if address[0] not in self.flags:
            raise OSError(errno.ENODEV, "No such device")
        self.refuse("bind")

    def detach(self) -> int:
        return 77

    def close(self) -> None:
        self.sockets -= 1

    def exists(self, path: str) -> bool:
        return path.split("/")[4] in self.flags

    def open(self, path: str, **_: Any) -> io.StringIO:
        name, what = path.split("/")[-2:]
        return io.StringIO(self.flags[name] if what == "flags" else f"{self.mtu}\n")

    def run(self, command: list[str], **_: Any) -> SimpleNamespace:
        self.refuse("run")
        self.commands.append(" ".join(command))
        return SimpleNamespace(returncode=self.code)


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    """Let `drivers.can.bus` be on such a machine."""
    made = Machine()
    known = vars(socket) | {"socket": made.socket}
    monkeypatch.setattr(buses, "socket", SimpleNamespace(**known))
    monkeypatch.setattr(buses, "open", made.open, raising=False)
    monkeypatch.setattr(buses.os.path, "exists", made.exists)
    monkeypatch.setattr(buses.os, "geteuid", lambda: 0 if made.root else 1000)
    monkeypatch.setattr(buses.subprocess, "run", made.run)
    return made


def test_a_node_hears_its_frames_the_controller_and_no_others(machine: Machine) -> None:
    end = new_wire()
    buses.open_bus(BusAddress("socketcan", "vcan0"), [0x123, 0x18FF0001], end)
    assert (end.kind, end.fd_tx, end.fd_rx, end.fd_rx2) == (Medium.SOCKETCAN, 77, 77, -1)
    ids = 0x80000000 | 0x18FF0001, 0xC0000000 | 0x1FFFFFFF  # extended, and no remote frame
    assert machine.options[socket.CAN_RAW_FILTER] == struct.pack("=IIII", 0x123, 0xC00007FF, *ids)
    assert machine.options[buses._CAN_RAW_ERR_FILTER] == 0x1FFFFFFD
    assert machine.options[socket.SO_RCVTIMEO] == struct.pack("@ll", 0, 20_000)
    assert socket.CAN_RAW_FD_FRAMES not in machine.options and machine.sockets == 1


def test_who_may_not_enlarge_its_buffer_has_what_everybody_has(machine: Machine) -> None:
    machine.refusals["option 33"] = PermissionError(1, "no")
    buses.open_bus(BusAddress("socketcan", "vcan0"), [], new_wire())
    assert machine.options[socket.SO_RCVBUF] == buses.RECEIVE_BUFFER_BYTES


def test_can_fd_is_asked_for_where_the_rig_has_it_and_refused_where_the_interface_has_not(
    machine: Machine,
) -> None:
    for name, cure in (
        ("vcan0", "`sudo ip link set vcan0 mtu 72`"),
        (
            "can0",
            "down && sudo ip link set can0 up type can bitrate 1000000 dbitrate 5000000 fd on",
        ),
    ):
        with pytest.raises(BusError, match="the interface has no CAN FD") as refused:
            buses.open_bus(BusAddress("socketcan", name), [], new_wire(fd=1))
        assert cure in str(refused.value) and machine.sockets == 0
    machine.mtu = 72
    buses.open_bus(BusAddress("socketcan", "vcan0"), [], new_wire(fd=1))
    assert machine.options[socket.CAN_RAW_FD_FRAMES] == 1


@pytest.mark.parametrize(
    ("at", "refusal", "said"),
    [
        ("bind", OSError(errno.EPERM, "Operation not permitted"), "vcan0: Operation not perm"),
        ("bind", OSError("interface name too long"), "vcan0: interface name too long; "),
        ("socket", OSError(errno.EAFNOSUPPORT, "Address family"), "no CAN [(]Address family[)]; "),
    ],
)
def test_a_refusal_of_the_kernel_is_told_with_the_cure(
    machine: Machine, at: str, refusal: OSError, said: str
) -> None:
    machine.refusals[at] = refusal
    with pytest.raises(BusError, match=said) as refused:
        buses.open_bus(BusAddress("socketcan", "vcan0"), [], new_wire())
    assert "ip link add dev vcan0 type vcan" in str(refused.value)
    assert machine.sockets == 0


def test_a_group_that_cannot_be_joined_is_told_and_nothing_stays_open(machine: Machine) -> None:
    machine.flags = {}
    with pytest.raises(BusError, match=r"No such device; is the loopback interface up"):
        buses.open_bus(BusAddress("udp_multicast", buses.UDP_GROUP), [], new_wire())
    assert machine.sockets == 0


def test_an_interface_that_is_down_or_missing_is_told(machine: Machine) -> None:
    machine.flags["vcan0"] = DOWN
    with pytest.raises(BusError, match="vcan0: the interface is down; run `sudo ip link set vcan"):
        buses.open_bus(BusAddress("socketcan", "vcan0"), [], new_wire())
    assert machine.sockets == 0
    with pytest.raises(BusError, match="vcan7: no such interface; create it"):
        buses.open_bus(BusAddress("socketcan", "vcan7"), [], new_wire())


@pytest.mark.parametrize(
    ("name", "change", "ready", "commands"),
    [
        ("vcan0", {}, True, 0),
        ("vcan0", {"flags": {"vcan0": DOWN}}, False, 0),
        ("vcan0", {"refusals": {"socket": OSError("no CAN")}}, False, 0),
        ("vcan3", {}, True, 2),
        ("vcan3", {"code": 1}, False, 2),
        ("vcan3", {"root": False}, False, 0),
        ("can3", {}, False, 0),
        ("vcan3", {"refusals": {"run": OSError("no ip")}}, False, 0),
        ("vcan3", {"refusals": {"run": subprocess.TimeoutExpired("ip", 20)}}, False, 0),
    ],
)
def test_a_virtual_interface_is_ready_or_made_where_root_may(
    machine: Machine, name: str, change: dict[str, Any], ready: bool, commands: int
) -> None:
    vars(machine).update(change)
    assert buses.vcan_ready(name) == ready
    assert len(machine.commands) == commands
    if ready and commands:
        assert machine.commands == [f"ip link add dev {name} type vcan", f"ip link set {name} up"]


def test_auto_is_the_virtual_interface_where_there_is_one(machine: Machine) -> None:
    assert buses.bus_named("auto", None) == BusAddress("socketcan", "vcan0")
    assert buses.bus_named("auto", "can0") == BusAddress("socketcan", "can0")
    machine.refusals["socket"] = OSError("no CAN")
    assert buses.bus_named("auto", "can0") == BusAddress("udp_multicast", buses.UDP_GROUP)
    assert buses.bus_named("socketcan", None) == BusAddress("socketcan", "vcan0")


def test_the_bus_beside_one_is_the_next_of_its_kind(machine: Machine) -> None:
    group = buses.UDP_GROUP
    for channel, beside in ((group, f"{group}:43114"), (f"{group}:65535", group)):
        assert buses.neighbour_of(BusAddress("udp_multicast", channel)) == BusAddress(
            "udp_multicast", beside
        )
    assert buses.neighbour_of(BusAddress("socketcan", "vcan0")) == BusAddress("socketcan", "vcan1")
    assert len(machine.commands) == 2  # it was missing
    machine.flags["vcan1"] = DOWN  # another node is just making it
    assert buses.neighbour_of(BusAddress("socketcan", "vcan0")) == BusAddress("socketcan", "vcan1")
    assert len(machine.commands) == 4
    machine.flags["vcan1"] = UP
    assert buses.neighbour_of(BusAddress("socketcan", "vcan0")) == BusAddress("socketcan", "vcan1")
    assert len(machine.commands) == 4
    for odd in (BusAddress("pcan", "x1"), BusAddress("socketcan", "mycan")):
        with pytest.raises(BusError, match="which bus is beside it is unknown; name it"):
            buses.neighbour_of(odd)


def test_a_second_bus_is_of_the_kind_of_the_first(machine: Machine) -> None:
    end = new_wire()
    buses.open_bus(BusAddress("socketcan", "vcan0"), [], end)
    buses.open_second(BusAddress("socketcan", "can0"), [], end)
    assert (end.fd_tx2, end.fd_rx2) == (77, 77)
    buses.set_own_address(end)  # nothing comes back
    assert not end.own.any()
    for other in (BusAddress("udp_multicast", buses.UDP_GROUP), BusAddress("virtual", "x")):
        with pytest.raises(BusError, match="make both buses of a local node socketcan, or both"):
            buses.open_second(other, [], end)


def test_a_listener_hears_all_and_the_time(machine: Machine) -> None:
    buses.listener(BusAddress("socketcan", "vcan0"))
    assert socket.CAN_RAW_FILTER not in machine.options
    assert machine.options[buses._SO_TIMESTAMPNS] == 1


def test_an_interface_of_another_name_is_socketcan(machine: Machine) -> None:
    machine.flags["mycan"] = UP
    assert buses.parse("mycan") == ("socketcan", "mycan")


def test_a_frame_goes_out_on_socketcan_with_the_size_of_its_kind_and_errors_come_in() -> None:
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with here, there:
        end = new_wire()
        wire.prepare(end, Medium.SOCKETCAN, here.fileno(), here.fileno())
        for flags, size, said in ((Flag.NONE, 16, 0), (Flag.FD | Flag.BRS, 72, Flag.BRS)):
            end.tx[:] = 0
            end.tx[:6] = 0x23, 1, 0, 0, 8, flags
            assert wire.put_frame(end)
            sent = there.recv(100)
            assert (len(sent), sent[5], sent[:4]) == (size, said, b"\x23\1\0\0")
            assert end.tx[5] == flags, "as it was"
        there.send(b"\x04\0\0\x20\x08".ljust(16, b"\0"))
        assert wire.get_frame(end, True) == Arrival.BUS_ERROR
        there.send(b"\x04\0\0\x20\x08".ljust(72, b"\0"))
        assert wire.get_frame(end, True) == Arrival.FOREIGN
