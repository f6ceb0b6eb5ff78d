"""Opening a bus: SocketCAN, udp_multicast, one of a package of others, or any of python-can.

Names are python-can's: interface, channel. As text `interface[:channel]`; for udp_multicast the
channel is `group[:port]`. `auto` is decided in `drivers.can.choice`.

On the default group frames go out as loopback broadcasts, because python-can's default is an IPv6
group: its socket takes IPv4 broadcasts, but no IPv4 multicast, and loopback has no IPv6 multicast.
So `python -m can.viewer -i udp_multicast` sees them with and without `-c 239.74.163.2`. What such
a tool sends reaches us on the IPv4 group only. Other groups are plain multicast.
"""

import ctypes
import errno as codes
import os
import re
import socket
import struct
import subprocess
from dataclasses import dataclass

from pcpc.drivers.can.wire_layout import FRAME_BYTES, Medium, Wire
from pcpc.drivers.errors import BusError, UserError
from pcpc.drivers.machine import outside

INTERFACES = "socketcan", "udp_multicast"  # that the compiled loop speaks itself
UDP_GROUP = "239.74.163.2"  # python-can's default IPv4 group and port
UDP_PORT = 43113
LOOPBACK = "127.0.0.1"
LOOPBACK_BROADCAST = "127.255.255.255"
RECEIVE_TIMEOUT_US = 20_000  # a blocking receive looks at the stop word fifty times a second
RECEIVE_BUFFER_BYTES = 4 << 20  # 5000 datagrams: four stalled seconds at 1 kHz
_SO_RCVBUFFORCE = 33
_SO_ATTACH_FILTER = 26
_SO_TIMESTAMPNS = 35
_CAN_RAW_ERR_FILTER = 2
_ERRORS = 0x1FFFFFFF & ~0x02  # error frames of all classes but lost arbitration, which is normal


@dataclass(frozen=True)
class BusAddress:
    """Which bus: python-can's interface name and channel."""

    interface: str
    channel: str

    def __str__(self) -> str:
        return f"{self.interface}:{self.channel}"

    @property
    def compiled(self) -> bool:
        """True if the compiled loop speaks to this bus itself."""
        return self.interface in INTERFACES or self.addition is not None

    @property
    def addition(self) -> outside.Addition | None:
        """What a package of others opens it by; None of one of pcpc's."""
        is_ours = self.interface in INTERFACES
        return None if is_ours else outside.named("buses", self.interface)


def bus_named(interface: str, channel: str | None) -> BusAddress:
    """Return the bus for an interface name; `auto` looks at the machine, not at who uses it.

    A bus has one name: the default port of udp_multicast is left out.
    """
    if interface == "auto":
        if vcan_ready(channel or "vcan0"):
            return BusAddress("socketcan", channel or "vcan0")
        return BusAddress("udp_multicast", UDP_GROUP)
    default = {"socketcan": "vcan0", "udp_multicast": UDP_GROUP}.get(interface, "")
    channel = channel or default
    if interface == "udp_multicast":
        channel = channel.removesuffix(f":{UDP_PORT}")
    return BusAddress(interface, channel)


def parse(text: str) -> tuple[str, str | None]:
    """Split `interface[:channel]`; an interface like `vcan0` or `can0` alone means socketcan."""
    interface, _, channel = text.partition(":")
    if channel or interface in ("auto", "socketcan", "udp_multicast"):
        return interface, channel or None
    if re.fullmatch(r"v?can\d+", interface) or os.path.exists(f"/sys/class/net/{interface}/flags"):
        return "socketcan", interface
    return interface, None


def neighbour_of(bus: BusAddress) -> BusAddress:
    """Return the bus next to `bus`: vcan1 to vcan0, the next port of udp_multicast; BusError."""
    if bus.interface == "udp_multicast":
        group, port = udp_address(bus.channel)
        return bus_named(bus.interface, f"{group}:{port + 1 if port < 65535 else UDP_PORT}")
    name = re.fullmatch(r"(.*?)(\d+)", bus.channel)
    if bus.interface != "socketcan" or name is None:
        raise BusError(
            f"{bus}: which bus is beside it is unknown; name it: --set local.bus.channel=can1"
        )
    next_one = f"{name[1]}{int(name[2]) + 1}"
    if not vcan_ready(next_one):
        _make_vcan(next_one)  # there, but not up: another node is just making it
    return BusAddress(bus.interface, next_one)


def vcan_ready(name: str) -> bool:
    """Return True if CAN interface `name` is up; a missing vcan is created if that is possible."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    if os.path.exists(f"/sys/class/net/{name}"):
        with open(f"/sys/class/net/{name}/flags") as flags:
            return int(flags.read(), 16) & 1 == 1
    return _make_vcan(name)


def _make_vcan(name: str) -> bool:
    """Make a vcan interface and bring it up, where root may; return whether it is up.

    Two nodes may do so at once: that it is there already is no error.
    """
    if not name.startswith("vcan") or os.geteuid() != 0:
        return False
    code = 1
    for command in (f"ip link add dev {name} type vcan", f"ip link set {name} up"):
        try:
            code = subprocess.run(command.split(), capture_output=True, timeout=20).returncode
        except (OSError, subprocess.TimeoutExpired):
            return False
    return code == 0


def open_bus(bus: BusAddress, receive_ids: list[int] | None, end: Wire) -> None:
    """Open `bus` for one node that listens to `receive_ids` and put it into the Wire record `end`.

    `receive_ids` are SocketCAN's filter, above 0x7FF extended; other buses deliver every frame, and
    None stands for every frame.
    Raises BusError: what is missing and the cure.
    """
    from pcpc.drivers.can import wire  # here, because it imports numba
    from pcpc.drivers.compiled.jit import LOOP_INTERPRETED

    if bus.interface == "socketcan":
        both = _open_socketcan(bus.channel, receive_ids, bool(end.fd))
        wire.prepare(end, Medium.SOCKETCAN, both, both)
    elif bus.interface == "udp_multicast":
        wire.prepare(end, Medium.UDP, *_open_udp(bus.channel))
    elif bus.addition is not None:
        wire.prepare(end, Medium.SOCKETCAN, *_open_addition(bus, bool(end.fd)))
    elif LOOP_INTERPRETED:
        wire.prepare(end, Medium.PYTHON_CAN, _open_python_can(bus), -1)
    else:
        raise BusError(
            f"{bus}: the compiled loop speaks socketcan and udp_multicast; "
            "any other python-can interface needs the interpreted loop (PCPC_LOOP=interpreted)"
        )


def open_second(bus: BusAddress, receive_ids: list[int], end: Wire) -> None:
    """Open a second bus of the same kind for a node whose Wire record `end` is open; BusError."""
    if bus.interface == "socketcan" and end.kind == Medium.SOCKETCAN:
        end.fd_tx2 = end.fd_rx2 = _open_socketcan(bus.channel, receive_ids, bool(end.fd))
    elif bus.interface == "udp_multicast" and end.kind == Medium.UDP:
        end.fd_tx2, end.fd_rx2 = _open_udp(bus.channel)
    else:
        raise BusError(
            f"{bus}: make both buses of a local node socketcan, or both udp_multicast; "
            "choose with --set local.bus.interface=..."
        )


def listener(bus: BusAddress) -> socket.socket:
    """Return a socket that hears all frames of a compiled bus, with the kernel's time; BusError.

    Each comes with an SCM_TIMESTAMPNS: when it was sent or came in, CLOCK_REALTIME. Without a
    frame for RECEIVE_TIMEOUT_US a receive ends in BlockingIOError.
    """
    if bus.addition is not None:
        raise BusError(f"{bus}: who only listens needs socketcan or udp_multicast")
    if bus.interface == "socketcan":
        ear = _open_socketcan(bus.channel, None)
    else:
        mouth, ear = _open_udp(bus.channel)
        os.close(mouth)
    heard = socket.socket(fileno=ear)
    heard.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    return heard


def set_own_address(end: Wire) -> None:
    """Let the open Wire record `end` tell its own frames, which come back to it on udp_multicast.

    SocketCAN and python-can do not give a sender its own frames.
    """
    if end.kind != Medium.UDP:
        return
    for i, descriptor in enumerate((int(end.fd_tx), int(end.fd_tx2))):
        if descriptor >= 0:
            with socket.socket(fileno=os.dup(descriptor)) as sender:
                host, port = sender.getsockname()
            address = struct.pack("=H", socket.AF_INET) + port.to_bytes(2, "big")
            address += socket.inet_aton(host)
            end.own[i] = int.from_bytes(address, "little", signed=True)


def _open_socketcan(name: str, receive_ids: list[int] | None, fd: bool = False) -> int:
    up = f"sudo ip link set {name} up"
    cure = f"create it with `sudo ip link add dev {name} type vcan && {up}`"
    if not name.startswith("vcan"):
        up += " type can bitrate 1000000"
        cure = f"load its driver or plug the adapter in, then `{up}`"
    others = ", run under `pcpc vm -- ...`, or use --bus udp_multicast"
    try:
        can = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except OSError as error:
        raise BusError(
            f"{name}: this kernel has no CAN ({error.strerror}); {cure}{others}"
        ) from None
    try:
        if receive_ids is not None:
            can.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, _can_filters(receive_ids))
        can.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, _ERRORS)
        if fd:
            can.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        _receive_options(can)
        can.bind((name,))
    except OSError as error:
        can.close()
        what = "no such interface" if error.errno == codes.ENODEV else error.strerror or error
        raise BusError(f"{name}: {what}; {cure}{others}") from None
    if not vcan_ready(name):
        can.close()
        raise BusError(f"{name}: the interface is down; run `{up}`")
    if fd and _mtu(name) < FRAME_BYTES:
        can.close()
        cure = f"sudo ip link set {name} mtu {FRAME_BYTES}"
        if not name.startswith("vcan"):
            cure = f"sudo ip link set {name} down && {up} dbitrate 5000000 fd on"
        raise BusError(f"{name}: the interface has no CAN FD; run `{cure}`")
    return can.detach()


def _mtu(name: str) -> int:
    """Return the size of the largest frame that an interface takes."""
    with open(f"/sys/class/net/{name}/mtu", encoding="ascii") as file:
        return int(file.read())


def _can_filters(ids: list[int]) -> bytes:
    """Return struct can_filter for each id: data frames with this id and no other."""
    flags = socket.CAN_EFF_FLAG | socket.CAN_RTR_FLAG
    filters = b""
    for can_id in ids:
        if can_id > socket.CAN_SFF_MASK:
            filters += struct.pack("=II", can_id | socket.CAN_EFF_FLAG, flags | socket.CAN_EFF_MASK)
        else:
            filters += struct.pack("=II", can_id, flags | socket.CAN_SFF_MASK)
    return filters


def udp_address(channel: str) -> tuple[str, int]:
    """Split `group[:port]`; BusError if it is not an IPv4 multicast group and a port."""
    group, _, port = channel.partition(":")
    try:
        multicast = 224 <= socket.inet_pton(socket.AF_INET, group)[0] <= 239
        number = int(port) if port else UDP_PORT
    except (OSError, ValueError):
        multicast, number = False, 0
    if not multicast or not 0 < number < 65536:
        raise BusError(
            f"udp_multicast:{channel}: expected an IPv4 multicast group and perhaps a port, "
            f"like {UDP_GROUP}:{UDP_PORT}"
        )
    return group, number


def _open_udp(channel: str) -> tuple[int, int]:
    """Return (sending, receiving) descriptor; the sender is connected: send() needs no address."""
    group, port = udp_address(channel)
    loopback = socket.inet_aton(LOOPBACK)
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        for sharing in (socket.SO_REUSEADDR, socket.SO_REUSEPORT):  # as python-can
            receiver.setsockopt(socket.SOL_SOCKET, sharing, 1)
        _receive_options(receiver)
        if group == UDP_GROUP:
            _hear_only(group, receiver)
            receiver.bind(("", port))
            sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            sender.connect((LOOPBACK_BROADCAST, port))
        else:
            receiver.bind((group, port))
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
            sender.connect((group, port))
        membership = socket.inet_aton(group) + loopback
        for end in (receiver, sender):  # who only sends keeps the group open for its listeners
            end.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    except OSError as error:
        receiver.close()
        sender.close()
        if error.errno == codes.EADDRINUSE:
            other = port + 1 if port < 65535 else UDP_PORT
            raise BusError(
                f"udp_multicast:{group}: port {port} is in use by a program that does not share "
                f"it; end that program or choose another with --bus udp_multicast:{group}:{other}"
            ) from None
        raise BusError(
            f"udp_multicast:{group}:{port}: {error.strerror}; is the loopback interface up?"
        ) from None
    return sender.detach(), receiver.detach()


def _hear_only(group: str, sock: socket.socket) -> None:
    """Let in what was sent to `group` or to the loopback broadcast, as binding to one of them does.

    A classic BPF program of (code, jump if true, jump if false, operand). Without it a datagram
    from the network to this host's own address would be a frame.
    """
    wanted = [int.from_bytes(socket.inet_aton(a), "big") for a in (group, LOOPBACK_BROADCAST)]
    program = (
        (0x20, 0, 0, 0xFFF00000 + 16),  # load the destination: byte 16 of the IP header
        (0x15, 1, 0, wanted[0]),  # if equal, skip one
        (0x15, 0, 1, wanted[1]),  # if not equal, skip one
        (0x06, 0, 0, 0xFFFFFFFF),  # accept
        (0x06, 0, 0, 0),  # drop
    )
    code = b"".join(struct.pack("=HBBI", *instruction) for instruction in program)
    memory = ctypes.create_string_buffer(code, len(code))
    fprog = struct.pack("@HP", len(program), ctypes.addressof(memory))
    sock.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, fprog)


def _receive_options(sock: socket.socket) -> None:
    timeout = struct.pack("@ll", 0, RECEIVE_TIMEOUT_US)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeout)
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)
    except PermissionError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)


def _open_addition(bus: BusAddress, fd: bool) -> tuple[int, int]:
    """Return the descriptors of a bus of a package of others; BusError.

    Its `opened(channel, fd)` returns two sockets, to send by and to receive from: each datagram is
    a struct can_frame, or with `fd` a canfd_frame. What one sends does not come back to it.
    """
    addition = bus.addition
    assert addition is not None, "as it is one"
    try:
        both = outside.loaded(addition)(bus.channel, fd)
        sockets = [socket.socket(fileno=os.dup(end.fileno())) for end in both]
        for end in both:
            end.close()
        sender, receiver = sockets
        _receive_options(receiver)
    except UserError as error:
        raise BusError(str(error)) from None
    except Exception as error:
        raise BusError(
            f"{bus}: {addition} cannot open it: {type(error).__name__}: {error}"
        ) from None
    return sender.detach(), receiver.detach()


def _open_python_can(bus: BusAddress) -> int:
    import can

    from pcpc.drivers.can import python_can_port  # time

    try:
        port = can.Bus(interface=bus.interface, channel=bus.channel or None)
    except (can.CanError, ValueError, OSError, ImportError) as error:
        raise BusError(f"{bus}: python-can cannot open it: {error}") from None
    return python_can_port.register(port)
