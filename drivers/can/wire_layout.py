"""The memory of one end of a bus, as a structure that the compiled loop uses (no numba here)."""

from typing import Any

from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import Byte, Cells, Record, carried, cells
from pcpc.drivers.compiled.rows import CLASSIC_BYTES, FRAME_BYTES, Flag, FrameBytes

__all__ = [
    "CLASSIC_BYTES",
    "FRAME_BYTES",
    "LENGTHS",
    "Arrival",
    "Flag",
    "Medium",
    "Wire",
    "flags_of",
]


class Medium(NumberedEnum):
    """What an end of a bus is on, its `kind`."""

    MEMORY, SOCKETCAN, UDP, PYTHON_CAN = range(4)


class Arrival(NumberedEnum):
    """What came, see `drivers.can.wire.get_frame`."""

    NOTHING, FRAME, FOREIGN, OWN, BUS_ERROR = range(5)
    FAILED = -1


LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)  # that an FD frame can have
QUEUE_FRAMES = 256  # one virtual-time exchange is about ten frames
SECOND_IDS = 32
ADDRESS_BYTES = 16  # struct sockaddr_in
STRANGER = -1  # as `source`: a replayed frame that did not come from the frame's own sender
PACKET_BYTES = 512  # python-can writes at most 251 (CAN FD); a longer datagram is cut and refused


class Wire(Record):
    """One end."""

    kind: int
    fd_tx: int
    fd_rx: int
    fd_tx2: int  # of a second bus, -1 without
    fd_rx2: int
    muted: int = carried()  # 1: a blocking receive listens to the second bus only
    in_turn: int  # 1: a blocking receive empties the first bus until it is muted
    fd: int  # 1: CAN FD frames are taken too
    remotes: int  # 1: remote frames too
    n_second: int  # how many ids go out on the second bus, and which
    second: Cells[int] = cells(SECOND_IDS)
    errno: int  # of the last call that failed
    inbox_put: int  # MEMORY: frames put into, and taken out of, the inbox
    inbox_taken: int
    outbox_put: int
    tx: FrameBytes  # the frame being sent
    rx: FrameBytes  # the frame last received
    source: int  # who sent it: the first half of `address`; 0 where nobody can tell
    own: Cells[int] = cells(2)  # the same of this end's own senders, whose frames come back on UDP
    address: Cells[int] = cells(2)  # UDP: struct sockaddr_in of the sender, and its length
    address_bytes: Cells[int] = cells(1)
    waiting: Cells[int] = cells(2)  # two of struct pollfd: descriptor, events, what came
    packet_tx: Cells[Byte] = cells(PACKET_BYTES)  # UDP: the msgpack template
    packet_rx: Cells[Byte] = cells(PACKET_BYTES)
    inbox: Cells[FrameBytes] = cells(QUEUE_FRAMES)
    outbox: Cells[FrameBytes] = cells(QUEUE_FRAMES)


def flags_of(message: Any) -> int:
    """Return the flags of a message of python-can, 0 of a classic one."""
    if not message.is_fd:
        return Flag.NONE
    return Flag.FD | Flag.BRS * message.bitrate_switch | Flag.ESI * message.error_state_indicator
