"""The buses that a rig and a command line ask for."""

from pcpc.drivers import bus as buses
from pcpc.drivers.choice import Wanted
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role


def bus_wanted(rig: Rig, roles: tuple[Role, ...], named: str | None) -> Wanted:
    """Return what `drivers.choice` needs to know; `named` is a --bus option, before the rig's."""
    config = rig.config
    channel = None if config.bus.channel is None else str(config.bus.channel)
    asked = (config.bus.interface, channel) if named is None else buses.parse(named)
    two = config.local is not None and config.local.bus is None
    return Wanted(*asked, rig=config.rig, roles=roles, two=two)
