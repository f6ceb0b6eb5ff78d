"""Acme's bus: a cable of two ends on this machine, each a port. `--bus acme:PORT`.

A datagram is a struct can_frame, or canfd_frame. Multicast, as it takes what nobody listens to.
"""

import socket

GROUP, LOOPBACK = "239.74.163.9", socket.inet_aton("127.0.0.1")


def opened(channel: str, fd: bool) -> tuple[socket.socket, socket.socket]:
    """Return the sockets to send by and to receive from, at the end that is free; OSError."""
    port = int(channel)
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        receiver.bind((GROUP, port))
        other = port + 1
    except OSError:
        receiver.bind((GROUP, port + 1))
        other = port
    membership = socket.inet_aton(GROUP) + LOOPBACK
    receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, LOOPBACK)
    sender.connect((GROUP, other))
    return sender, receiver
