"""What the CAN controller told a node, counted; while it is bus-off that is a fault.

An error frame is recorded as received, in the state BUS_ERROR. Emergency frames wait until the
controller is back: what is sent meanwhile is lost.
"""

from typing import Any

import numpy as np

from pcpc.drivers import error_frames as told
from pcpc.drivers.e2e_states import BUS_ERROR
from pcpc.drivers.jit import loop_function
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import supervisor as sv
from pcpc.executive.loop.rings import push_frame
from pcpc.executive.loop.variables import BUS_AT


@loop_function
def note_bus_error(n: Any) -> None:
    """Count the error frame in `wire.rx`, and note whether the controller is off the bus."""
    frame = n.wire.rx
    kind, detail = np.int64(frame[0]) | np.int64(frame[1]) << 8, np.int64(frame[9])
    changed = kind & told.STATE != 0
    push_frame(n, n.wire.rx, 1, BUS_ERROR)
    back = kind & told.RESTARTED != 0 or (changed and detail & told.ACTIVE != 0)
    n.control[sh.BUS_ERRORS] += 0 if back else 1
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
def _count(n: Any, i: Any, happened: Any) -> None:
    n.control[sh.BUS_WARNINGS + i] += 1 if happened else 0
    n.v[BUS_AT + i] = np.float64(n.control[sh.BUS_WARNINGS + i])


@loop_function
def fault_while_off(n: Any) -> None:
    """Let a controller that is off be a fault, and stay one until it is back."""
    if n.guard.faulted == sv.NO_FAULT:
        n.guard.faulted = sv.BUS_OFF
