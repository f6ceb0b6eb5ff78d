"""What the CAN controller told a node, counted; while it is bus-off that is a fault.

An error frame is recorded as received, in the state BUS_ERROR. Emergency frames wait until the
controller is back: what is sent meanwhile is lost.
"""

import numpy as np

from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.compiled.structures import words
from pcpc.drivers.line import error_frames as told
from pcpc.executive.loop import control
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.rings import push_frame
from pcpc.executive.loop.variables import BUS_AT

COUNTER_WORDS = np.array([control.place(word) for word, *_ in control.BUS_COUNTERS])


@loop_function
def note_bus_error(n: Loop) -> None:
    """Count the error frame in `wire.rx`, and note whether the controller is off the bus."""
    frame = n.wire.rx
    kind, detail = int64(frame[0]) | int64(frame[1]) << 8, int64(frame[9])
    changed = kind & told.STATE != 0
    push_frame(n, n.wire.rx, 1, FrameState.BUS_ERROR)
    back = kind & told.RESTARTED != 0 or (changed and detail & told.ACTIVE != 0)
    n.control.bus_errors += 0 if back else 1
    _count(n, 0, changed and detail & told.WARNED != 0)
    _count(n, 1, changed and detail & told.TURNED_PASSIVE != 0)
    _count(n, 2, kind & told.OFF != 0)
    _count(n, 3, kind & told.RESTARTED != 0)
    _count(n, 4, kind & told.NO_ACK != 0)
    _count(n, 5, kind & told.TX_TIMEOUT != 0)
    if kind & told.OFF != 0:
        n.guard.off = 1
    elif kind & told.RESTARTED != 0:
        n.guard.off = 0


@loop_function
def _count(n: Loop, i: int, happened: bool) -> None:
    counts, at = words(n.control), COUNTER_WORDS[i]
    counts[at] += 1 if happened else 0
    n.v[BUS_AT + i] = np.float64(counts[at])


@loop_function
def fault_while_off(n: Loop) -> None:
    """Let a controller that is off be a fault, and stay one until it is back."""
    if n.guard.faulted == Fault.NONE:
        n.guard.faulted = Fault.BUS_OFF
