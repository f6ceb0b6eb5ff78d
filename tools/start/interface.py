"""The bus that a command line or a rig names, checked before anything is started."""

from pcpc.drivers.can import bus as buses
from pcpc.drivers.errors import BusError
from pcpc.executive.errors import RigError


def named_bus(named: tuple[str, str | None], place: str) -> buses.Bus:
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
