"""One CAN frame out, one CAN frame in, on every kind of bus, compiled and without allocation.

A frame is Linux' `struct canfd_frame`: [0:4] id little-endian with the flags of SocketCAN in its
upper bits, [4] length, [5] `Flag`, [6:8] 0 in one that came, since a log has nothing of a sender's
padding there, [8:72] data; what a classic one has lies in the first 16 bytes.
Three kinds of wire carry it:

    SOCKETCAN   the struct itself on a raw CAN socket
    UDP         python-can's udp_multicast format: one msgpack map a datagram, written from a
                template and read by walking the map, so that python-can's own tools share the bus
    MEMORY      an outbox and an inbox that `carry` connects (virtual time)

An end may lie on two buses of one kind: the ids in `second` go out on the second one, frames come
in from both. A fourth kind, PYTHON_CAN, hands frames to a `can.Bus` and exists only where the loop
runs interpreted.
"""

import errno
from typing import Any

import msgpack
import numpy as np

from pcpc.drivers.can.wire_layout import (
    ADDRESS_BYTES,
    CLASSIC_BYTES,
    FRAME_BYTES,
    LENGTHS,
    PACKET_BYTES,
    QUEUE_FRAMES,
    Arrival,
    Flag,
    Medium,
    Wire,
)
from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import LOOP_INTERPRETED, loop_function, loop_inline
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import FLAGS, LENGTH
from pcpc.drivers.compiled.structures import copy, structure

END = structure(Wire.dtype)  # the type of what all functions here take
WAIT_MS = 100  # as the receive time-out of drivers.can.bus
ERROR_FLAG, REMOTE_FLAG, ERROR_FLAGS = 0x20, 0x40, 0x60  # in the id's top byte; both


def _template() -> tuple[bytes, int, int, int]:
    """Return python-can's message map with 8 data bytes; offsets of id, dlc and data."""
    fields = {
        "timestamp": 0.0,
        "arbitration_id": 0xFFFFFFFF,
        "is_extended_id": False,
        "is_remote_frame": False,
        "is_error_frame": False,
        "channel": None,
        "dlc": 8,
        "data": b"01234567",
        "is_fd": False,
        "bitrate_switch": False,
        "error_state_indicator": False,
    }
    packed = msgpack.packb(fields, use_bin_type=True)
    return (
        packed,
        packed.index(b"arbitration_id") + 14,
        packed.index(b"dlc") + 3,
        packed.index(b"data") + 6,
    )


TEMPLATE, _ID, _DLC, _DATA = _template()
_EXTENDED = TEMPLATE.index(b"is_extended_id") + 14
_TAIL = np.frombuffer(TEMPLATE[_DATA + 8 :], np.uint8).copy()
_TAIL_BYTES = len(_TAIL)
_IS_FD, _SWITCH, _INDICATOR = (
    TEMPLATE.index(name) + len(name) - _DATA - 8
    for name in (b"is_fd", b"bitrate_switch", b"error_state_indicator")
)  # places in the tail
CAN_BE = np.zeros(256, np.uint8)  # 1: a length that FD has
CAN_BE[list(LENGTHS)] = 1
TEMPLATE_BYTES = len(TEMPLATE)


def prepare(wire: Wire, kind: int, fd_tx: int, fd_rx: int) -> None:
    """Fill the zeroed Wire record `wire`; descriptors are -1 where a kind has none."""
    wire.kind, wire.fd_tx, wire.fd_rx = kind, fd_tx, fd_rx
    wire.fd_tx2 = wire.fd_rx2 = -1
    wire.packet_tx[:TEMPLATE_BYTES] = np.frombuffer(TEMPLATE, np.uint8)


@loop_function
def _write_packet(frame: Cells[Byte], packet: Cells[Byte]) -> int:
    """Write `frame` into the msgpack template `packet`; return the packet's length.

    A length above 8, of an FD frame 64, counts as that, or the datagram would carry what lies
    behind the frame.
    """
    extended = frame[3] & 0x80 != 0
    packet[_ID + 1] = frame[3] & 31
    packet[_ID + 2] = frame[2]
    packet[_ID + 3] = frame[1]
    packet[_ID + 4] = frame[0]
    packet[_EXTENDED] = 0xC3 if extended else 0xC2
    flags = int64(frame[FLAGS])
    n = min(int64(frame[LENGTH]), int64(64 if flags & Flag.FD else 8))
    packet[_DLC] = n
    packet[_DATA - 1] = n
    for i in range(n):
        packet[_DATA + i] = frame[8 + i]
    tail = _DATA + n
    for i in range(_TAIL_BYTES):
        packet[tail + i] = _TAIL[i]
    if flags & Flag.FD != 0:
        packet[tail + _IS_FD] = 0xC3
        packet[tail + _SWITCH] = 0xC3 if flags & Flag.BRS else 0xC2
        packet[tail + _INDICATOR] = 0xC3 if flags & Flag.ESI else 0xC2
    return tail + _TAIL_BYTES


@loop_function
def _value_end(b: Cells[Byte], offset: int, end: int) -> Any:
    """Return the end of the msgpack scalar, string or bytes at `offset`; -1 if cut or unknown."""
    tag = int64(b[offset])
    length = int64(-1)
    if tag <= 0x7F or tag >= 0xE0 or tag == 0xC0 or tag == 0xC2 or tag == 0xC3:
        length = int64(0)
    elif 0xA0 <= tag <= 0xBF:
        length = tag & 31
    elif tag == 0xCC or tag == 0xD0:
        length = int64(1)
    elif tag == 0xCD or tag == 0xD1:
        length = int64(2)
    elif tag == 0xCA or tag == 0xCE or tag == 0xD2:
        length = int64(4)
    elif tag == 0xCB or tag == 0xCF or tag == 0xD3:
        length = int64(8)
    elif (tag == 0xC4 or tag == 0xD9) and offset + 1 < end:
        length = int64(b[offset + 1]) + 1
    if length < 0 or offset + 1 + length > end:
        return int64(-1)
    return offset + 1 + length


@loop_function
def _uint(b: Cells[Byte], offset: int, stop: int) -> Any:
    """Return the msgpack unsigned integer (or bool) in b[at:stop]; -1 if it is something else."""
    tag = int64(b[offset])
    if tag <= 0x7F:
        return tag
    if tag == 0xC2 or tag == 0xC3:
        return tag - 0xC2
    value = int64(0)
    if 0xCC <= tag <= 0xCE:
        for i in range(offset + 1, stop):
            value = value * 256 + int64(b[i])
        return value
    return int64(-1)


@loop_function
def _read_packet(b: Cells[Byte], end: int, frame: Cells[Byte], remotes: int) -> bool:
    """Read a map b[:end] into `frame`; return True for a data frame, if `remotes` a remote one."""
    if end < 2 or end > PACKET_BYTES - 1 or b[0] & 0xF0 != 0x80:
        return False
    can_id, data_at, data_n, extended = int64(-1), int64(0), int64(-1), int64(0)
    offset, other, flags, remote = int64(1), False, int64(0), int64(0)
    for _ in range(int64(b[0] & 15)):
        if offset >= end or b[offset] < 0xA1 or b[offset] > 0xBF:
            return False
        n = int64(b[offset]) & 31
        key = offset + 1
        value = key + n
        if value >= end:
            return False
        stop = _value_end(b, value, end)
        if stop < 0:
            return False
        first, fourth = int64(b[key]), int64(b[key + min(n - 1, int64(3))])
        if n == 14 and first == 97:  # arbitration_id
            can_id = _uint(b, value, stop)
        elif n == 4 and first == 100:  # data
            if b[value] != 0xC4:
                return False
            data_at, data_n = value + 2, int64(b[value + 1])
        elif n == 14 and first == 105 and fourth == 101 and b[key + 4] == 120:  # is_extended_id
            extended = int64(0x80 if _uint(b, value, stop) == 1 else 0)
        elif n == 15 and fourth == 114 and remotes != 0:  # is_remote_frame
            remote = int64(REMOTE_FLAG if _uint(b, value, stop) == 1 else 0)
        elif (n == 15 and fourth == 114) or (n == 14 and fourth == 101):
            other |= _uint(b, value, stop) != 0  # is_remote_frame, is_error_frame
        elif n == 5 and _uint(b, value, stop) != 0:  # is_fd
            flags |= Flag.FD
        elif n == 14 and first == 98 and _uint(b, value, stop) == 1:  # bitrate_switch
            flags |= Flag.BRS
        elif n == 21 and first == 101 and _uint(b, value, stop) == 1:  # error_state_indicator
            flags |= Flag.ESI
        offset = stop
    highest = 0x1FFFFFFF if extended else 0x7FF
    if flags & Flag.FD == 0:
        flags = int64(0)
    elif data_n >= 0 and CAN_BE[np.uint64(data_n)] == 0:
        return False
    longest = 8 if flags == 0 else 64
    if other or offset != end or not 0 <= can_id <= highest or not 0 <= data_n <= longest:
        return False
    for i in range(4):
        frame[i] = (can_id >> (8 * i)) & 255
    frame[3] |= extended | remote
    frame[LENGTH], frame[FLAGS] = data_n, flags
    for i in range(longest):
        frame[8 + i] = b[data_at + i] if i < data_n else 0
    return True


if LOOP_INTERPRETED:
    from pcpc.drivers.can import python_can_port

    _put_python_can, _get_python_can = python_can_port.put, python_can_port.get
else:

    @loop_function
    def _put_python_can(wire: Wire) -> bool:
        return False

    @loop_function
    def _get_python_can(wire: Wire, block: bool) -> int:
        return Arrival.FAILED


@loop_function
def blank(frame: Cells[Byte]) -> None:
    """Let what lies behind a frame's data be 0."""
    for i in range(8 + min(int64(frame[LENGTH]), int64(64)), FRAME_BYTES):
        frame[i] = 0


@loop_function
def on_second(wire: Wire, frame: Cells[Byte]) -> bool:
    """Return whether `frame` goes out on the second bus."""
    if wire.n_second == 0:
        return False
    word = int64(0)
    for i in range(4):
        word |= int64(frame[i]) << (8 * i)
    is_second = False
    for i in range(wire.n_second):
        is_second |= wire.second[i] == word
    return is_second


@loop_inline
def put_frame(wire: Wire) -> bool:
    """Send `wire.tx`; return True when the bus took it (never blocks)."""
    if wire.kind != Medium.MEMORY:
        return _send(wire)
    if wire.outbox_put >= QUEUE_FRAMES:
        return False
    copy(wire.outbox[wire.outbox_put], wire.tx)
    wire.outbox_put += 1
    return True


@loop_function
def _send(wire: Wire) -> bool:
    """Send `wire.tx` by a system call; as `put_frame`."""
    if wire.kind == Medium.PYTHON_CAN:
        return _put_python_can(wire)
    if wire.kind == Medium.SOCKETCAN:
        n = int64(FRAME_BYTES if wire.tx[FLAGS] & Flag.FD else CLASSIC_BYTES)
        address = libc.address(wire.tx)
    elif wire.kind == Medium.UDP:
        n, address = _write_packet(wire.tx, wire.packet_tx), libc.address(wire.packet_tx)
    else:
        wire.errno = errno.EPROTONOSUPPORT
        return False
    fd = wire.fd_tx2 if on_second(wire, wire.tx) else wire.fd_tx
    flags = wire.tx[FLAGS]
    wire.tx[FLAGS] = flags & (Flag.BRS | Flag.ESI)  # FD says the size
    sent = libc.send(fd, address, n, libc.MSG_DONTWAIT) == n
    if not sent:
        wire.errno = libc.errno()
    wire.tx[FLAGS] = flags
    return sent


@loop_inline
def get_frame(wire: Wire, block: bool) -> int:
    """Receive into `wire.rx`; return what came.

    FRAME      a data frame; `wire.source` says who sent it, where that is known
    NOTHING    none came
    FOREIGN    no such frame
    OWN        on UDP, from this end's own sender, if known (`drivers.can.bus.set_own_address`)
    BUS_ERROR  what the CAN controller had to tell
    FAILED     the bus failed

    With `block` the call waits at most the socket's receive time-out (set when the bus was opened).
    """
    if wire.kind != Medium.MEMORY:
        return _receive(wire, block)
    if wire.inbox_taken == wire.inbox_put:
        return Arrival.NOTHING
    copy(wire.rx, wire.inbox[wire.inbox_taken % QUEUE_FRAMES])
    wire.inbox_taken += 1
    return Arrival.BUS_ERROR if wire.rx[3] & ERROR_FLAG != 0 else Arrival.FRAME


@loop_function
def _receive(wire: Wire, block: bool) -> int:
    """Receive by system calls; as `get_frame`."""
    if wire.kind == Medium.PYTHON_CAN:
        return _get_python_can(wire, block)
    if wire.fd_rx2 < 0:
        return _take(wire, wire.fd_rx, 0 if block else libc.MSG_DONTWAIT)
    if block and wire.muted != 0:
        return _take(wire, wire.fd_rx2, 0)
    if block and wire.in_turn != 0:
        return _take(wire, wire.fd_rx, 0)
    for attempt in range(2):
        for fd in (wire.fd_rx, wire.fd_rx2):
            result = _take(wire, fd, libc.MSG_DONTWAIT)
            if result != Arrival.NOTHING:
                return result
        if attempt == 1 or not block or _wait_for_either(wire) <= 0:
            break
    return Arrival.NOTHING


@loop_function
def _take(wire: Wire, fd: int, flags: int) -> int:
    """Receive from one descriptor; as `get_frame`."""
    if wire.kind == Medium.SOCKETCAN:
        n = libc.recv(fd, libc.address(wire.rx), FRAME_BYTES, flags)
        odd = ERROR_FLAG if wire.remotes != 0 else ERROR_FLAGS
        known = n == CLASSIC_BYTES or (n == FRAME_BYTES and CAN_BE[wire.rx[LENGTH]] != 0)
        known &= wire.rx[3] & odd == 0
        if n == FRAME_BYTES:
            blank(wire.rx)
        if n == CLASSIC_BYTES and wire.rx[3] & ERROR_FLAG != 0:
            return Arrival.BUS_ERROR
        bits = Flag.BRS | Flag.ESI
        wire.rx[FLAGS] = wire.rx[FLAGS] & bits | Flag.FD if n == FRAME_BYTES else 0
        wire.rx[6] = wire.rx[7] = 0
    elif wire.kind == Medium.UDP:
        wire.address_bytes[0] = ADDRESS_BYTES
        packet, address = libc.address(wire.packet_rx), libc.address(wire.address)
        size = libc.address(wire.address_bytes)
        n = libc.recvfrom(fd, packet, PACKET_BYTES, flags, address, size)
        wire.source = wire.address[0]
        if n >= 0 and (wire.source == wire.own[0] or wire.source == wire.own[1]):
            return Arrival.OWN
        known = n > 0 and _read_packet(wire.packet_rx, n, wire.rx, wire.remotes)
    else:
        wire.errno = errno.EPROTONOSUPPORT
        return Arrival.FAILED
    if n < 0:
        e = libc.errno()
        if e == libc.EAGAIN or e == libc.EINTR:
            return Arrival.NOTHING
        wire.errno = e
        return Arrival.FAILED
    return Arrival.FRAME if known and (wire.fd != 0 or wire.rx[FLAGS] == 0) else Arrival.FOREIGN


@loop_function
def _wait_for_either(wire: Wire) -> int:
    """Sleep until one of both buses has a frame, at most the receive time-out; return poll's n."""
    wire.waiting[0] = wire.fd_rx | libc.POLLIN << 32
    wire.waiting[1] = wire.fd_rx2 | libc.POLLIN << 32
    return libc.poll(libc.address(wire.waiting), 2, WAIT_MS)


@loop_function
def carry(source: Wire, target: Wire) -> None:
    """Move `source`'s outbox into `target`'s inbox (kind MEMORY); what does not fit stays."""
    moved = min(source.outbox_put, QUEUE_FRAMES - (target.inbox_put - target.inbox_taken))
    for k in range(moved):
        copy(target.inbox[target.inbox_put % QUEUE_FRAMES], source.outbox[k])
        target.inbox_put += 1
    for k in range(moved, source.outbox_put):
        copy(source.outbox[k - moved], source.outbox[k])
    source.outbox_put -= moved


@loop_function
def deal(source: Wire, first: Wire, second: Wire) -> None:
    """Move `source`'s outbox into the inboxes of the ends of its two buses (kind MEMORY)."""
    for k in range(source.outbox_put):
        deliver(source.outbox[k], second if on_second(source, source.outbox[k]) else first)
    source.outbox_put = 0


@loop_function
def deliver(frame: Cells[Byte], target: Wire) -> None:
    """Put `frame` into an inbox; one more than it holds is lost, as on a bus."""
    if target.inbox_put - target.inbox_taken >= QUEUE_FRAMES:
        return
    copy(target.inbox[target.inbox_put % QUEUE_FRAMES], frame)
    target.inbox_put += 1
