"""Frames that the drive wants to send by itself.

0x080 + node   emergency: code 2 bytes, register 1, nothing 5      CiA 301, 7.2.7
0x180 ...      PDOs
0x580 + node   SDO, its answer
0x700 + node   boot-up, heartbeat

"""

from pcpc.drivers.canopen.layout import Canopen, Heartbeat, Od
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.drive.outbox import put

EMERGENCY, SDO_ANSWER, HEARTBEAT = 0x080, 0x580, 0x700
HISTORY = 4


@loop_function
def put_heartbeat(d: Canopen) -> None:
    """Say in which state of the network the drive is; 0 after a start."""
    put(d, HEARTBEAT + d.node, 1, d.state.nmt, 0)
    d.state.beat_at = d.k


@loop_function
def tell_error(d: Canopen, code: int, register: int) -> None:
    """Send an emergency, code 0 for the end of all errors; note it in code, register, history."""
    if code != 0:
        for i in range(HISTORY - 1):
            d.value[Od.ERROR_4 - i] = d.value[Od.ERROR_3 - i]
        d.value[Od.ERROR_1] = code
        d.value[Od.ERROR_COUNT] = min(d.value[Od.ERROR_COUNT] + 1, HISTORY)
    d.value[Od.ERROR_CODE], d.value[Od.ERROR_REGISTER] = code, register
    if d.state.nmt != Heartbeat.STOPPED:
        put(d, EMERGENCY + d.node, 8, code | register << 16, 0)
