"""A bus that nobody else uses, for one test: claimed as runs claim theirs, until the tests end."""

import socket

from pcpc.drivers.can.choice import used_ports
from pcpc.drivers.machine import claim

GROUP = "239.74.163.11"
_PORTS = range(20000, 32000, 2)  # below those that the kernel gives to sockets that ask for any
_claims: list[socket.socket] = []


def own_port(group: str = GROUP) -> int:
    """Return a port of a multicast group on which nobody is, nor on the next one."""
    used = used_ports()
    for port in _PORTS:
        one = claim.hold(f"bus/udp_multicast:{group}:{port}")
        if one is not None:
            _claims.append(one)
            if used.isdisjoint((port, port + 1)):
                return port
    raise AssertionError("no free port")


def own_bus(group: str = GROUP) -> str:
    """Return `own_port` as the text of a bus."""
    return f"udp_multicast:{group}:{own_port(group)}"
