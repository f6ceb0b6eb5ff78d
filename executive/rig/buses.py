"""The buses that a rig and a command line ask for."""

from collections.abc import Iterable
from typing import Any

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can.choice import BusRequest
from pcpc.drivers.can.wire_layout import Flag
from pcpc.drivers.line.ticks import MOST_TICKS, ticks_per_s
from pcpc.executive.errors import did_you_mean
from pcpc.executive.rig.messages import fd_frames, has_fd_drive
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role

OVER_LINE = "line"  # the pacing of a plan


def wanted_bus(rig: Rig, roles: tuple[Role, ...], named: str | None) -> BusRequest:
    """Return what `can.choice` needs to know; `named` is a --bus option, before the rig's."""
    config = rig.config
    channel = None if config.bus.channel is None else str(config.bus.channel)
    address = (config.bus.interface, channel) if named is None else buses.parse(named)
    second = [one.bus for one in config.plants.values() if one.bus is not None]
    beside = any((one.interface, one.channel) == ("auto", None) for one in second)
    count = 1 + (beside or (config.local is not None and config.local.bus is None))
    if config.bus.emulate is not None:  # all its sides, and that between local node and plant
        count += len(on_line(rig)) - 1 + (config.xcp_on_can is not None)
    return BusRequest(*address, rig=config.rig, roles=roles, count=count)


def second_bus(rig: Rig, bus: buses.BusAddress, role: Role) -> buses.BusAddress | None:
    """Return the bus of a node that is not the executive's; None where that is its only one.

    It is that between local node and plant, that of some plants, or, of a plant, its own side of
    an emulated line.
    """
    local, plants = rig.config.local, rig.config.plants
    if local is None and rig.config.bus.emulate is not None:
        return side_of(rig, bus, role) if role in plants else None
    bus = side_of(rig, bus, "local")
    second_buses = [
        one.bus for name, one in plants.items() if role in (name, "executive") and one.bus
    ]
    if local is None and not second_buses:
        return None
    keys = second_buses[0] if local is None else local.bus
    if keys is None:
        return buses.neighbour_of(bus)
    channel = None if keys.channel is None else str(keys.channel)
    if keys.interface == "auto" and channel is None:
        return buses.neighbour_of(bus)
    return buses.bus_named(keys.interface, channel)


def side_of(rig: Rig, bus: buses.BusAddress, role: Role) -> buses.BusAddress:
    """Return the bus of a node at an emulated line, or where none is `bus`, the executive's."""
    if rig.config.bus.emulate is not None and role in rig.roles:
        for _ in range(rig.roles.index(role)):
            bus = buses.neighbour_of(bus)
    return bus


def master_side(rig: Rig, bus: buses.BusAddress) -> buses.BusAddress:
    """Return the bus of an XCP master: the last side of an emulated line; where none is `bus`."""
    for _ in rig.roles if rig.config.bus.emulate is not None else ():
        bus = buses.neighbour_of(bus)
    return bus


def on_line(rig: Rig) -> tuple[Role, ...]:
    """Return the nodes at a rig's emulated line: all, but for the plant of a local node."""
    return rig.roles if rig.config.local is None else rig.roles[:2]


def check_line(rig: Rig, pacing: str) -> None:
    """Raise RigError if the rig's line cannot be emulated; `pacing` may be virtual."""
    problem, bus, nodes = "", rig.config.bus, on_line(rig)
    if bus.bitrates and bus.emulate is None:
        raise rig.error("bus.bitrates", "only an emulated line knows bit rates; give bus.emulate")
    if bus.emulate is None:
        return
    if strange := [name for name in bus.bitrates if name not in nodes]:
        what = f"{strange[0]} is no node at the line{did_you_mean(strange[0], nodes)}"
        raise rig.error("bus.bitrates", what)
    if len(bus.bitrates) == len(nodes):
        raise rig.error("bus.bitrates", "one node at least has that of bus.emulate; leave it out")
    nominal, fast = bus.bits_per_s or 0, bus.data_bitrate
    switched = [one.name for one in fd_frames(rig) if one.flags & Flag.BRS]
    switched += ["a moteus drive"] if has_fd_drive(rig) else []
    if pacing == "lockstep":
        problem = "in lockstep no clock runs; choose another pacing, `pcpc simulate`, or null"
    elif any(one.bus is not None for one in rig.config.plants.values()):
        problem = "some plants are on a second bus; only one can be emulated"
    elif not 1000 <= nominal <= 1_000_000:
        problem = (
            f"{bus.emulate}: classic CAN has 1 kbit/s to 1 Mbit/s, CAN FD before its switch too"
        )
    elif switched and fast is None:
        problem = f"{switched[0]} switches its bit rate; give bus.data_bitrate, in bit/s"
    elif fast is not None or bus.bitrates:
        problem = odd_rates(nominal, fast or nominal, bus.bitrates.values())
    if problem:
        raise rig.error("bus.emulate", problem)


def odd_rates(bitrate: int, data_bitrate: int, others: Iterable[int] = ()) -> str:
    """Return why a line cannot have these two bit rates, and those of some nodes; "" if it can."""
    if data_bitrate < bitrate:
        return f"data at {data_bitrate} bit/s is slower than the nominal {bitrate}; give more"
    if ticks_per_s(bitrate, data_bitrate, others) > MOST_TICKS:
        rates = " and ".join(map(str, dict.fromkeys([bitrate, data_bitrate, *others])))
        return f"no clock up to 9 GHz gives both {rates} bit/s; round them"
    return ""


def virtual_pacing(rig: Rig) -> str:
    """Return the pacing of nodes in virtual time: lockstep, or over the rig's emulated line."""
    return "lockstep" if rig.config.bus.emulate is None else OVER_LINE


def line_options(rig: Rig) -> dict[str, Any]:
    """Return what the rig says of its emulated line, for `drivers.line.line.prepare`."""
    bus = rig.config.bus
    others = {on_line(rig).index(name): rate for name, rate in bus.bitrates.items()}
    rates = {"bitrate": bus.bits_per_s, "data_bitrate": bus.data_bitrate, "others": others}
    return rates | {"p": bus.bit_error_rate, "burst": bus.error_burst, "seed": rig.config.seed}
