"""Frames through any `can.Bus` of python-can: the interpreted loop's fourth kind of wire.

python-can costs 10 to 50 times a compiled frame; it is here for the adapters that have no socket
(PCAN, Kvaser, slcan, ...). The loop knows a bus by the number in `wire.fd_tx`.
"""

import atexit

import can

from pcpc.drivers.can import can_id
from pcpc.drivers.can.wire_layout import Arrival, Flag, Wire, flags_of
from pcpc.drivers.compiled.rows import FLAGS, LENGTH

_open: dict[int, can.BusABC] = {}
_BLOCK_S = 0.1  # as the sockets' receive time-out


def register(bus: can.BusABC) -> int:
    """Take `bus` into use until the process ends; return the number by which a wire names it."""
    number = len(_open)
    _open[number] = bus
    atexit.register(bus.shutdown)
    return number


def put(wire: Wire) -> bool:
    """Send `wire.tx`; return True when the bus took it."""
    frame = bytes(wire.tx)
    word = int.from_bytes(frame[:4], "little")
    message = can.Message(
        arbitration_id=word & can_id.ID,
        is_extended_id=bool(word & can_id.EXTENDED),
        data=frame[8 : 8 + frame[LENGTH]],
        is_fd=bool(frame[FLAGS] & Flag.FD),
        bitrate_switch=bool(frame[FLAGS] & Flag.BRS),
        error_state_indicator=bool(frame[FLAGS] & Flag.ESI),
    )
    try:
        _open[wire.fd_tx].send(message, timeout=0.0)
    except can.CanError:
        return False
    return True


def get(wire: Wire, block: bool) -> int:
    """Receive into `wire.rx`; return what came, an Arrival."""
    try:
        message = _open[wire.fd_tx].recv(_BLOCK_S if block else 0.0)
    except can.CanError:
        return Arrival.FAILED
    if message is None:
        return Arrival.NOTHING
    remote = bool(message.is_remote_frame)
    foreign = remote > wire.remotes or message.is_error_frame or message.is_fd > wire.fd
    if foreign or len(message.data) > (64 if message.is_fd else 8):
        return Arrival.FOREIGN
    word = can_id.word_of(message.arbitration_id, message.is_extended_id)
    word |= can_id.REMOTE if remote else 0
    head = word.to_bytes(4, "little") + bytes([len(message.data), flags_of(message), 0, 0])
    for i, byte in enumerate(head + bytes(message.data).ljust(8, b"\0")):
        wire.rx[i] = byte
    return Arrival.FRAME
