"""Ends of a bus that say when a frame came, who sent it, and what the controller had to tell.

stamp      the kernel's, CLOCK_REALTIME; of python-can what the adapter's driver says
hardware   the adapter's, of a clock of its own
own        this end's own frame, given back once it is sent (SocketCAN: acknowledged)
"""

import os
import select
import socket
import struct
import sys
import time
from collections.abc import Iterator, Sequence
from enum import Enum
from typing import Any, NamedTuple, Protocol

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import can_id, plain_bus
from pcpc.drivers.can.wire_layout import FRAME_BYTES, Flag, flags_of
from pcpc.drivers.errors import BusError

_SO_TIMESTAMPNS, _SO_TIMESTAMPING, _SO_RXQ_OVFL = 35, 37, 40
_STAMPS = 1 << 2 | 1 << 3 | 1 << 4 | 1 << 6  # of hardware and kernel, where they can be had
_MSG_CONFIRM = 0x800
_TIMES = struct.Struct("@6q")  # struct scm_timestamping: kernel, unused, hardware
_TIME = struct.Struct("@2q")
_ANCILLARY_BYTES = 256
_NEAR_NS = 10**9  # a stamp so near to the host's clock is of it


class Origin(Enum):
    """Whose frame it is."""

    OTHER, OWN, ERROR = range(3)


class HeardFrame(NamedTuple):
    """What came at an end; of an error frame `word` has the classes of linux/can/error.h."""

    word: int
    data: bytes
    flags: int
    read_ns: int
    "when this program had it, CLOCK_REALTIME"
    stamp_ns: int | None = None
    hardware_ns: int | None = None
    origin: Origin = Origin.OTHER


class End(Protocol):
    """One end of a bus; `dropped`: frames that this program was too slow for."""

    name: str
    has_fd: bool
    dropped: int

    def offer(self, word: int, data: bytes, flags: int = Flag.NONE) -> bool:
        """Send a frame; False where it is not taken."""

    def frames(self) -> Iterator[HeardFrame]:
        """Yield the frames that are there."""

    def fileno(self) -> int:
        """Return what `select` waits for; -1: nothing."""

    def close(self) -> None:
        """Leave the bus."""


class CanEnd(plain_bus.Can):
    """A channel of SocketCAN."""

    def __init__(self, channel: str) -> None:
        super().__init__(channel, None)
        self.name, self.has_fd, self.dropped = channel, self._most >= FRAME_BYTES, 0
        self._can.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 1)
        self._can.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPING, _STAMPS)
        self._can.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)

    def frames(self) -> Iterator[HeardFrame]:  # type: ignore[override]
        """Yield the frames that are there."""
        while True:
            try:
                text, about, said, _ = self._can.recvmsg(
                    FRAME_BYTES, _ANCILLARY_BYTES, socket.MSG_DONTWAIT
                )
            except BlockingIOError:
                return
            except OSError as error:
                raise BusError(f"{self.name}: {error.strerror} in the middle") from None
            read_ns = time.time_ns()
            stamp_ns, hardware_ns = self._times(about)
            word, n = int.from_bytes(text[:4], sys.byteorder), text[4]
            flags = text[5] | Flag.FD if len(text) == FRAME_BYTES else Flag.NONE
            origin = Origin.OWN if said & _MSG_CONFIRM else Origin.OTHER
            if word & can_id.ERROR:
                origin, word = Origin.ERROR, word & can_id.ID
            data = text[8 : 8 + n]
            yield HeardFrame(word, data, flags, read_ns, stamp_ns, hardware_ns, origin)

    def _times(self, about: Sequence[tuple[int, int, bytes]]) -> tuple[int | None, int | None]:
        stamp_ns = hardware_ns = None
        for _, kind, data in about:
            if kind == _SO_TIMESTAMPING and len(data) >= _TIMES.size:
                s, ns, _, _, own_s, own_ns = _TIMES.unpack_from(data)
                stamp_ns = s * 10**9 + ns or None
                hardware_ns = own_s * 10**9 + own_ns or None
            elif kind == _SO_RXQ_OVFL:
                self.dropped = max(self.dropped, int.from_bytes(data[:4], sys.byteorder))
        return stamp_ns, hardware_ns


class UdpEnd(plain_bus.Udp):
    """A udp_multicast bus."""

    def __init__(self, channel: str) -> None:
        super().__init__(channel)
        self.name, self.has_fd, self.dropped = f"udp_multicast:{channel}", True, 0
        self._rx.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self._rx.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)

    def frames(self) -> Iterator[HeardFrame]:  # type: ignore[override]
        """Yield the frames that are there; a datagram that is none is one with an odd id."""
        while True:
            try:
                text, about, _, sender = self._rx.recvmsg(
                    2048, _ANCILLARY_BYTES, socket.MSG_DONTWAIT
                )
            except BlockingIOError:
                return
            read_ns, stamp_ns = time.time_ns(), None
            for _, kind, data in about:
                if kind == _SO_TIMESTAMPNS:
                    s, ns = _TIME.unpack_from(data)
                    stamp_ns = s * 10**9 + ns
                elif kind == _SO_RXQ_OVFL:
                    self.dropped = int.from_bytes(data[:4], sys.byteorder)
            frame = plain_bus.frame_of_datagram(text) or plain_bus.BusFrame(-1, text)
            origin = Origin.OWN if sender == self._own else Origin.OTHER
            word, frame_data, flags = frame
            yield HeardFrame(word, frame_data, flags, read_ns, stamp_ns, None, origin)


class PythonCanEnd:
    """Any interface of python-can."""

    def __init__(self, bus: buses.BusAddress) -> None:
        import can  # time

        self.name, self.has_fd, self.dropped = str(bus), False, 0
        self._errors = can.CanError, OSError
        try:
            self._port: Any = can.Bus(
                interface=bus.interface, channel=bus.channel or None, receive_own_messages=True
            )
        except Exception as error:  # without its library a driver raises NameError and others
            cure = "install its driver, plug it in, or see python-can's page of the interface"
            raise BusError(f"{bus}: python-can cannot open it: {error}; {cure}") from None

    def offer(self, word: int, data: bytes, flags: int = Flag.NONE) -> bool:
        """Send a frame; False where it is not taken."""
        import can  # time

        message = can.Message(
            arbitration_id=word & can_id.ID,
            is_extended_id=bool(word & can_id.EXTENDED),
            data=data,
            is_fd=bool(flags & Flag.FD),
            bitrate_switch=bool(flags & Flag.BRS),
        )
        try:
            self._port.send(message, timeout=0.0)
        except self._errors:
            return False
        return True

    def frames(self) -> Iterator[HeardFrame]:
        """Yield the frames that are there."""
        while True:
            try:
                one = self._port.recv(0.0)
            except self._errors as error:
                raise BusError(f"{self.name}: {error}") from None
            if one is None:
                return
            read_ns, at_ns = time.time_ns(), round(1e9 * one.timestamp)
            of_host = abs(at_ns - read_ns) < _NEAR_NS
            origin = Origin.ERROR if one.is_error_frame else Origin.OTHER
            origin = origin if one.is_rx or origin is Origin.ERROR else Origin.OWN
            word = can_id.word_of(one.arbitration_id, one.is_extended_id)
            stamp_ns, own_ns = (at_ns, None) if of_host else (None, at_ns or None)
            data, flags = bytes(one.data), flags_of(one)
            yield HeardFrame(word, data, flags, read_ns, stamp_ns, own_ns, origin)

    def fileno(self) -> int:
        """Return what `select` waits for; -1: nothing."""
        try:
            return int(self._port.fileno())
        except NotImplementedError:
            return -1

    def close(self) -> None:
        """Leave the bus."""
        self._port.shutdown()


def open_end(bus: buses.BusAddress) -> End:
    """Open an end of a bus; BusError: what it lacks, and the cure."""
    if bus.interface == "udp_multicast":
        return UdpEnd(bus.channel)
    if bus.interface == "socketcan":
        _check_permission(bus.channel)
        return CanEnd(bus.channel)
    if bus.channel.startswith("/") and not os.access(bus.channel, os.R_OK | os.W_OK):
        if not os.path.exists(bus.channel):
            raise BusError(f"{bus}: no such device; plug it in, see `ls -l /dev/serial/by-id`")
        cure = "sudo usermod -aG dialout $USER` and log in again"
        raise BusError(f"{bus}: no permission to open {bus.channel}; run `{cure}")
    return PythonCanEnd(bus)


def _check_permission(channel: str) -> None:
    """Raise BusError where this process may open no CAN socket at all."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except PermissionError:
        cure = "in a container add `--cap-add NET_RAW`, or ask who limits this process"
        raise BusError(f"{channel}: no permission for CAN sockets; {cure}") from None
    except OSError:
        return  # `CanEnd` knows more


def wait(ends: Sequence[End], timeout_s: float) -> None:
    """Wait until something came at an end, or the time is over."""
    numbers = [end.fileno() for end in ends]
    if min(numbers) >= 0:
        select.select(numbers, (), (), max(timeout_s, 0.0))
    else:
        time.sleep(min(max(timeout_s, 0.0), 2e-4))
