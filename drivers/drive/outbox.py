"""Frames that a drive wants to send: whoever has the bus empties its outbox."""

from pcpc.drivers.can.codec import put_four_bytes
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.drive.layout import OUTBOX_FRAMES as OUTBOX
from pcpc.drivers.drive.layout import Drive


@loop_function
def put(d: Drive, can_id: int, dlc: int, low: int, high: int) -> None:
    """Put a frame into the outbox: its data are two words of four bytes."""
    if d.n_out >= OUTBOX:
        return
    frame = d.outbox[d.n_out]
    put_four_bytes(frame, 0, int64(can_id))
    put_four_bytes(frame, 4, int64(dlc))
    put_four_bytes(frame, 8, int64(low))
    put_four_bytes(frame, 12, int64(high))
    d.n_out += 1
