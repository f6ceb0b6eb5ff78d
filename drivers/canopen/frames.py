"""Frames that the drive wants to send: written into its outbox, which whoever has the bus empties.

0x080 + node   emergency: code 2 bytes, register 1, nothing 5      CiA 301, 7.2.7
0x180 ...      PDOs
0x580 + node   SDO, its answer
0x700 + node   boot-up, heartbeat

"""

from pcpc.drivers.can.codec import put_four_bytes
from pcpc.drivers.canopen.layout import OUTBOX_FRAMES as OUTBOX
from pcpc.drivers.canopen.layout import Drive, Heartbeat, Od
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import int64

EMERGENCY, SDO_ANSWER, HEARTBEAT = 0x080, 0x580, 0x700
HISTORY = 4


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


@loop_function
def put_heartbeat(d: Drive) -> None:
    """Say in which state of the network the drive is; 0 after a start."""
    put(d, HEARTBEAT + d.node, 1, d.state.nmt, 0)
    d.state.beat_at = d.k


@loop_function
def tell_error(d: Drive, code: int, register: int) -> None:
    """Send an emergency, code 0 for the end of all errors; note it in code, register, history."""
    if code != 0:
        for i in range(HISTORY - 1):
            d.value[Od.ERROR_4 - i] = d.value[Od.ERROR_3 - i]
        d.value[Od.ERROR_1] = code
        d.value[Od.ERROR_COUNT] = min(d.value[Od.ERROR_COUNT] + 1, HISTORY)
    d.value[Od.ERROR_CODE], d.value[Od.ERROR_REGISTER] = code, register
    if d.state.nmt != Heartbeat.STOPPED:
        put(d, EMERGENCY + d.node, 8, code | register << 16, 0)
