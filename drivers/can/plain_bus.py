"""A bus in Python, frame by frame: for programs beside a run, which need no compiled loop.

python-can's udp_multicast is not used for it: that one hears its own frames and the network's,
needs a network, and raises an error at a datagram that is no frame.
"""

import errno
import select
import socket
import sys
import time
from collections.abc import Iterator
from typing import NamedTuple

import msgpack

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import can_id
from pcpc.drivers.can.wire_layout import CLASSIC_BYTES, FRAME_BYTES, LENGTHS, Flag
from pcpc.drivers.errors import BusError

PATIENCE_S = 2.0  # a frame of 64 bytes takes 60 ms at 10 kbit/s
_POLL_S = 1e-4
_SAID = {
    "timestamp": 0.0, "is_remote_frame": False, "is_error_frame": False, "channel": None,
    "error_state_indicator": False,
}  # fmt: skip


class BusFrame(NamedTuple):
    """A frame: its id as a word of `drivers.can.can_id`, its data, its `Flag`."""

    word: int
    data: bytes
    flags: int = Flag.NONE


class Udp:
    """A udp_multicast bus; python-can's datagrams, and none of this program's own."""

    def __init__(self, channel: str) -> None:
        sender, receiver = buses._open_udp(channel)
        self._tx, self._rx = socket.socket(fileno=sender), socket.socket(fileno=receiver)
        self._own = self._tx.getsockname()

    def fileno(self) -> int:
        """Return what `select` waits for."""
        return self._rx.fileno()

    def close(self) -> None:
        """Leave the bus."""
        self._tx.close()
        self._rx.close()

    def put(self, word: int, data: bytes, flags: int = Flag.NONE) -> None:
        """Send a frame."""
        self.offer(word, data, flags)

    def offer(self, word: int, data: bytes, flags: int = Flag.NONE) -> bool:
        """Send a frame; False where that fails."""
        message = {
            "arbitration_id": word & can_id.ID,
            "is_extended_id": bool(word & can_id.EXTENDED),
            "dlc": len(data),
            "data": data,
            "is_fd": bool(flags & Flag.FD),
            "bitrate_switch": bool(flags & Flag.BRS),
            **_SAID,
        }
        return self._tx.send(msgpack.packb(message)) > 0

    def frames(self) -> Iterator[BusFrame]:
        """Yield the frames that are there."""
        while True:
            try:
                text, sender = self._rx.recvfrom(2048, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return
            if sender != self._own and (frame := frame_of_datagram(text)) is not None:
                yield frame


def frame_of_datagram(text: bytes) -> BusFrame | None:
    """Return the data frame of a datagram."""
    try:
        message = msgpack.unpackb(text)
        number, extended = int(message["arbitration_id"]), bool(message.get("is_extended_id"))
        data = bytes(memoryview(message["data"]))
    except (ArithmeticError, ValueError, TypeError, KeyError, AttributeError,
            msgpack.UnpackException):  # fmt: skip
        return None
    flags = (
        (Flag.FD | Flag.BRS * bool(message.get("bitrate_switch"))) if message.get("is_fd") else 0
    )
    other = any(message.get(k) for k in ("is_remote_frame", "is_error_frame"))
    fits = len(data) in (LENGTHS if flags else LENGTHS[:9])
    fits &= 0 <= number <= (can_id.ID if extended else 0x7FF)
    return BusFrame(can_id.word_of(number, extended), data, flags) if fits and not other else None


class Can:
    """A SocketCAN bus."""

    def __init__(self, channel: str, receive_ids: list[int] | None) -> None:
        self._can = socket.socket(fileno=buses._open_socketcan(channel, receive_ids))
        self._channel, self._most = channel, buses._mtu(channel)
        if self._most >= FRAME_BYTES:
            self._can.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)

    def fileno(self) -> int:
        """Return what `select` waits for."""
        return self._can.fileno()

    def close(self) -> None:
        """Leave the bus."""
        self._can.close()

    def put(self, word: int, data: bytes, flags: int = Flag.NONE) -> None:
        """Send a frame; where the queue is full, wait. BusError: it takes none, or has no FD."""
        end_s = time.monotonic() + PATIENCE_S
        while not self.offer(word, data, flags):
            if time.monotonic() >= end_s:
                what = f"{self._channel}: took no frame for {PATIENCE_S:g} s"
                cure = "connect a node that acknowledges, and check bit rate and termination"
                raise BusError(f"{what}; {cure}")
            select.select((), (), (), _POLL_S)  # a full queue too is ready to take, it says

    def offer(self, word: int, data: bytes, flags: int = Flag.NONE) -> bool:
        """Send a frame; False where the queue is full. BusError: it has no FD."""
        size = FRAME_BYTES if flags & Flag.FD else CLASSIC_BYTES
        if size > self._most:
            cure = f"sudo ip link set {self._channel} mtu {FRAME_BYTES}"
            raise BusError(f"{self._channel}: the interface has no CAN FD; run `{cure}`")
        head = word.to_bytes(4, sys.byteorder) + bytes((len(data), flags, 0, 0))
        text = (head + data).ljust(size, b"\0")
        try:
            return self._can.send(text, socket.MSG_DONTWAIT) == size
        except OSError as error:
            if error.errno not in (errno.ENOBUFS, errno.EAGAIN):
                raise
            return False

    def frames(self) -> Iterator[BusFrame]:
        """Yield the frames that are there."""
        while True:
            try:
                text = self._can.recv(FRAME_BYTES, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return
            word, n = int.from_bytes(text[:4], sys.byteorder), text[4]
            flags = text[5] | Flag.FD if len(text) == FRAME_BYTES else Flag.NONE
            if not word & (can_id.REMOTE | can_id.ERROR) and n <= len(text) - 8:
                yield BusFrame(word, text[8 : 8 + n], flags)


def open_bus(bus: buses.BusAddress, receive_ids: list[int] | None = None) -> Udp | Can:
    """Open a bus; BusError. `receive_ids` as `drivers.can.bus.open_bus` has them."""
    if bus.interface == "udp_multicast":
        return Udp(bus.channel)
    if bus.interface == "socketcan":
        return Can(bus.channel, receive_ids)
    raise BusError(f"{bus}: expected socketcan or udp_multicast")
