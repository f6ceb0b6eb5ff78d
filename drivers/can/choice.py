"""Which bus a run takes: a free one of its own, or that of the nodes it belongs to.

    named   as it is named, shared with whoever is there
    auto    the bus of a running node of the same rig and user that lacks what is started here,
            or else the first free one of  vcan0, vcan1, ...  where there is a vcan0 (missing ones
            are made where root can),  udp_multicast on port 43113 and on

Free is what nobody claims, where no node sits and, of a port, where no other program listens. Two
starts in the same instant choose in turn. A choice holds its bus and its seats on it, a seat for
each node of the rig that it starts, while its sockets are open.
"""

import hashlib
import itertools
import os
import socket
from collections.abc import Iterator
from dataclasses import dataclass, field

from pcpc.drivers.can.bus import (
    UDP_GROUP,
    UDP_PORT,
    BusAddress,
    bus_named,
    neighbour_of,
    udp_address,
    vcan_ready,
)
from pcpc.drivers.errors import BusError
from pcpc.drivers.machine import claim

_PORTS = 1000  # from the default one on; nobody runs so many rigs
_VCANS = 64
_RIG_CHARACTERS = 24  # of a longer name a seat bears the beginning and a digest


@dataclass(frozen=True)
class BusRequest:
    """What is started: nodes (`roles`) of a rig, on one bus or on several side by side.

    `interface` and `channel` are those of the command line or the rig, `auto` and None if they
    leave the choice. Without roles it is no node, and joins nobody.
    """

    interface: str
    channel: str | None
    rig: str
    roles: tuple[str, ...]
    count: int = 1  # of buses


@dataclass
class Choice:
    """The bus, what holds it, and a line for the user where there is something to say."""

    bus: BusAddress
    note: str = ""
    claims: list[socket.socket] = field(default_factory=list)

    def release(self) -> None:
        """Let bus and seats go."""
        for one in self.claims:
            one.close()
        self.claims.clear()


def take_bus(wanted: BusRequest) -> Choice:
    """Choose and hold a bus; BusError if there is none."""
    try:
        if wanted.interface != "auto" or (wanted.channel and vcan_ready(wanted.channel)):
            return _take_seats(Choice(bus_named(wanted.interface, wanted.channel)), wanted)
        with claim.turn():
            return _take_seats(_partners_bus(wanted) or _free_bus(wanted), wanted)
    except OSError as error:
        raise BusError(f"no bus can be claimed: {error.strerror}; name one with --bus") from None


def _take_seats(choice: Choice, wanted: BusRequest) -> Choice:
    """Add the claims of the bus and of a seat for each role, where they are free."""
    if not choice.bus.compiled:
        return choice
    names = [_seat(choice.bus, wanted.rig, role) for role in wanted.roles]
    for name in (_name(choice.bus), *names):
        one = claim.hold(name)
        if one is not None:
            choice.claims.append(one)
    return choice


def _partners_bus(wanted: BusRequest) -> Choice | None:
    """Return the first bus on which this user runs the rig without these roles."""
    seats: dict[str, list[str]] = {}
    for name in claim.held_names(f"seat/{os.getuid()}/"):
        _, _, bus, rig, role, *rest = [*name.split("/"), "", "", ""]
        if rig == _short_name(wanted.rig) and not any(rest) and _is_ours(name):
            seats.setdefault(bus, []).append(role)
    for bus, roles in seats.items():
        if wanted.roles and not set(roles) & set(wanted.roles):
            interface, _, channel = bus.partition(":")
            return Choice(BusAddress(interface, channel), f"joins the {' and '.join(roles)} there")
    return None


def _free_bus(wanted: BusRequest) -> Choice:
    """Return the first bus that is free, its neighbour too where two are needed."""
    names_in_use = {name.split("/")[2] for name in claim.held_names("seat/") if name.count("/") > 3}
    note = ""
    for bus, why_not in itertools.chain(_vcans(wanted), _udp_ports(wanted)):
        buses = [bus]
        while len(buses) < wanted.count:
            buses.append(neighbour_of(buses[-1]))
        if any(str(one) in names_in_use for one in buses):
            continue
        claims = [one for one in (claim.hold(_name(bus)) for bus in buses) if one is not None]
        choice = Choice(bus, note, claims)
        if len(claims) == len(buses) and not why_not:
            return choice
        if len(claims) == len(buses):
            note = note or f"{why_not}; to share it: --bus {bus}"
        choice.release()
    raise BusError(
        f"no free bus: {_PORTS} ports of udp_multicast from {UDP_PORT} on are in use; "
        "end a run or name a bus with --bus"
    )


def _vcans(wanted: BusRequest) -> Iterator[tuple[BusAddress, str]]:
    """Yield the vcan interfaces in order, as long as there is one or it can be made."""
    if wanted.channel is not None:
        return
    for number in range(_VCANS):
        if not all(vcan_ready(f"vcan{number + i}") for i in range(wanted.count)):
            return
        yield BusAddress("socketcan", f"vcan{number}"), ""


def _udp_ports(wanted: BusRequest) -> Iterator[tuple[BusAddress, str]]:
    """Yield the ports of the default group, each with why it is not free or nothing."""
    used = used_ports()
    for port in range(UDP_PORT, UDP_PORT + _PORTS):
        bus = bus_named("udp_multicast", f"{UDP_GROUP}:{port}")
        busy = [number for number in range(port, port + wanted.count) if number in used]
        yield bus, f"another program uses port {busy[0]}" if busy else ""


def used_ports() -> set[int]:
    """Return the UDP ports to which a socket of this machine is bound."""
    ports = set()
    for name in ("udp", "udp6"):
        try:
            with open(f"/proc/net/{name}", encoding="ascii") as file:
                rows = file.readlines()[1:]
        except OSError:
            continue
        ports |= {int(row.split()[1].rpartition(":")[2], 16) for row in rows}
    return ports


def _name(bus: BusAddress) -> str:
    if bus.interface == "udp_multicast":
        group, port = udp_address(bus.channel)
        return f"bus/{bus.interface}:{group}:{port}"
    return f"bus/{bus}"


def _seat(bus: BusAddress, rig: str, role: str) -> str:
    return f"seat/{os.getuid()}/{bus}/{_short_name(rig)}/{role}"


def _short_name(rig: str) -> str:
    if len(rig) <= _RIG_CHARACTERS:
        return rig
    return f"{rig[:8]}~{hashlib.sha256(rig.encode()).hexdigest()[:15]}"


def _is_ours(name: str) -> bool:
    """Return whether a seat was taken by this user: anybody may write a name."""
    holder = claim.holder(name)
    return holder is not None and holder.uid == os.getuid()
