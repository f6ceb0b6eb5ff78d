"""The bus that a command line or a rig names, checked before anything is started."""

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import choice
from pcpc.drivers.errors import BusError
from pcpc.executive.errors import RigError
from pcpc.executive.rig.buses import wanted_bus
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role


def named_bus(named: tuple[str, str | None], place: str) -> buses.BusAddress:
    """Return the bus of an (interface, channel); `place` is where it was named.

    Raises RigError if there can be none of its name on any machine, BusError if this one lacks it.
    """
    bus = buses.bus_named(*named)
    if bus.interface == "udp_multicast":
        try:
            buses.udp_address(bus.channel)
        except BusError as error:
            raise RigError(str(error)) from None
    elif not bus.compiled:
        from can.interfaces import VALID_INTERFACES  # here, because it takes a while

        if bus.interface not in VALID_INTERFACES:
            raise RigError(
                f"{place}: no bus interface {bus.interface}; expected auto, vcan0, socketcan, "
                f"udp_multicast or another one of python-can"
            )
    return bus


def choose_bus(named: str | None, rig: Rig, roles: tuple[Role, ...]) -> choice.Choice:
    """Return the bus for `roles`, held; RigError if there can be none of its name anywhere."""
    wanted = wanted_bus(rig, roles, named)
    if wanted.interface != "auto":
        place = f"--bus {named}" if named else rig.where("bus.interface")
        named_bus((wanted.interface, wanted.channel), place)
    return choice.take_bus(wanted)
