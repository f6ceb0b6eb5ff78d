"""Error frames of SocketCAN, by which a CAN controller tells what is wrong (linux/can/error.h).

    id, with the flag 0x20000000     what it tells                                 counted as
    0x001                            a transmission timed out                      tx_timeouts
    0x004, data[1] 0x04, 0x08        warning: an error counter reached 96          warnings
    0x004, data[1] 0x10, 0x20        error passive: it reached 128                 passives
    0x020                            nobody acknowledged                           no_acks
    0x040                            bus off                                       offs
    0x100                            restarted behind bus-off: it is back          restarts

0x004 with data[1] 0x40 says that the controller is active again.
"""

import numpy as np

from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import LENGTH
from pcpc.drivers.line import line as lines
from pcpc.drivers.line.line import Line, SenderState

FLAG = 0x20  # in the id's top byte
TX_TIMEOUT, STATE, NO_ACK, OFF, RESTARTED = 0x001, 0x004, 0x020, 0x040, 0x100
WARNED, TURNED_PASSIVE, ACTIVE = 0x04 | 0x08, 0x10 | 0x20, 0x40  # bits of data[1]
_TOLD = np.array([ACTIVE, 0x08, 0x20])  # by the state of a line's sender


@loop_function
def news(line: Line, s: int, frame: Cells[Byte]) -> bool:
    """Write into `frame` (16,) what sender `s` of a line has to tell; return False for nothing."""
    state, before = int64(lines.state_of(line, s)), line.told[s]
    if state == before:
        return False
    line.told[s] = state
    for i in range(16):
        frame[i] = 0
    frame[3], frame[LENGTH] = FLAG, 8
    if state == SenderState.OFF:
        frame[0] = OFF
    elif before == SenderState.OFF:
        frame[1] = RESTARTED >> 8
    else:
        frame[0], frame[9] = STATE, _TOLD[state]
    return True
