"""The memory of one end of a bus, as a structure that the compiled loop uses (no numba here)."""

from typing import Any

import numpy as np

from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.rows import CLASSIC_BYTES, FRAME_BYTES, Flag

__all__ = [
    "CLASSIC_BYTES",
    "FRAME_BYTES",
    "LENGTHS",
    "WIRE",
    "Arrival",
    "Flag",
    "Medium",
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

WIRE = np.dtype(
    [
        ("kind", "<i8"),
        ("fd_tx", "<i8"),
        ("fd_rx", "<i8"),
        ("fd_tx2", "<i8"),  # of a second bus, -1 without
        ("fd_rx2", "<i8"),
        ("muted", "<i8"),  # 1: a blocking receive listens to the second bus only
        ("in_turn", "<i8"),  # 1: a blocking receive empties the first bus until it is muted
        ("fd", "<i8"),  # 1: CAN FD frames are taken too
        ("remotes", "<i8"),  # 1: remote frames too
        ("n_second", "<i8"),  # how many ids go out on the second bus, and which
        ("second", "<i8", (SECOND_IDS,)),
        ("errno", "<i8"),  # of the last call that failed
        ("inbox_put", "<i8"),  # MEMORY: frames put into, and taken out of, the inbox
        ("inbox_taken", "<i8"),
        ("outbox_put", "<i8"),
        ("tx", "u1", (FRAME_BYTES,)),  # the frame being sent
        ("rx", "u1", (FRAME_BYTES,)),  # the frame last received
        ("source", "<i8"),  # who sent it: the first half of `address`; 0 where nobody can tell
        ("own", "<i8", (2,)),  # the same of this end's own senders, whose frames come back on UDP
        ("address", "<i8", (2,)),  # UDP: struct sockaddr_in of the sender, and its length
        ("address_bytes", "<i8", (1,)),
        ("waiting", "<i8", (2,)),  # two of struct pollfd: descriptor, events, what came
        ("packet_tx", "u1", (PACKET_BYTES,)),  # UDP: the msgpack template
        ("packet_rx", "u1", (PACKET_BYTES,)),
        ("inbox", "u1", (QUEUE_FRAMES, FRAME_BYTES)),
        ("outbox", "u1", (QUEUE_FRAMES, FRAME_BYTES)),
    ],
    align=True,
)


def flags_of(message: Any) -> int:
    """Return the flags of a message of python-can, 0 of a classic one."""
    if not message.is_fd:
        return Flag.NONE
    return Flag.FD | Flag.BRS * message.bitrate_switch | Flag.ESI * message.error_state_indicator
