"""A wire of the loop in a test's hands: frames that it sends and takes."""

from typing import Any

import numpy as np

from pcpc.drivers.can import wire, wire_layout
from pcpc.drivers.can.wire_layout import Arrival


def new_wire(fd: int = 0) -> Any:
    """Return a zeroed Wire record."""
    end: Any = np.zeros(1, wire_layout.Wire.dtype).view(np.recarray)[0]
    end.fd = fd
    return end


def send(end: Any, can_id: int, data: bytes, extended: bool = False, flags: int = 0) -> None:
    """Send a frame of either kind."""
    word = can_id | int(extended) << 31
    head = word.to_bytes(4, "little") + bytes([len(data), flags, 0, 0])
    end.tx[:] = np.frombuffer(head + data.ljust(64, b"\0"), np.uint8)
    assert wire.put_frame(end), f"errno {end.errno}"


def receive(end: Any) -> tuple[int, bytes] | int:
    """Return word and data of the next frame, or what else `get_frame` returned."""
    outcome = wire.get_frame(end, True)
    if outcome != Arrival.FRAME:
        return int(outcome)
    return int.from_bytes(end.rx[:4].tobytes(), "little"), end.rx[8 : 8 + end.rx[4]].tobytes()
