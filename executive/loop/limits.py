"""What stands between the blocks' outputs and the wire, and belongs to no law.

finite   every output and every value to be sent is a finite number, else it is named and the
         node faults; a command keeps its last value
range    low <= command <= high
rate     |change| <= rate_per_s T a cycle, from the value sent before, also on a ramp and at
         the end of the run
ramp     command = safe + gain (last - safe), gain falling from 1 to 0 by `pace` a cycle: as
         fast as the supervisor's ramp_s, or as slow as the slowest command's rate
"""

from typing import Any

import numpy as np

from pcpc.drivers.jit import loop_function
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import supervisor as sv
from pcpc.executive.loop.rings import bits_of, push_event
from pcpc.executive.loop.variables import CLAMPED, STATE

FINITE = 1e300  # from here on, and as NaN, a value counts as not finite


@loop_function
def find_not_finite(n: Any, first: Any, past: Any) -> Any:
    """Return the first of these places that holds no finite number, -1 for none."""
    odd = np.int64(0)
    for i in range(first, past):
        odd |= not abs(n.v[i]) < FINITE
    if odd != 0:
        for i in range(first, past):
            if not abs(n.v[i]) < FINITE:
                return np.int64(i)
    return np.int64(-1)


@loop_function
def check_finite(n: Any) -> Any:
    """Look at all outputs and at what is to be sent; note the first value that is not finite."""
    place = np.int64(-1)
    for b in range(n.n_blocks):
        if place < 0:
            place = find_not_finite(n, n.views[b, 6], n.views[b, 7])
    if place < 0:
        place = find_not_finite(n, n.sent_first, n.sent_past)
    if place >= 0 and n.control[sh.ODD_PLACE] == 0:
        n.control[sh.ODD_PLACE] = place + 1
        n.control[sh.ODD_CYCLE] = n.k
        n.control[sh.ODD_BITS] = bits_of(n.v[place])
        push_event(n, sh.NOT_FINITE_EVENT, place, n.v[place])
    return place >= 0


@loop_function
def limit_commands(n: Any) -> None:
    """Judge what is to be sent: finite or a fault; clamp, limit the rate, ramp to safe."""
    odd = check_finite(n)
    n.v[CLAMPED] = 0.0
    ramping = n.v[STATE] >= sv.FAULT or n.pace > 0.0
    for i in range(n.n_limits):
        j = n.limit_index[i]
        wanted, last, safe = n.v[j], n.limits[i, sh.LAST], n.limits[i, sh.SAFE]
        rate, sent = n.limits[i, sh.RATE], n.limits[i, sh.SENT_VALUE]
        if not abs(wanted) < FINITE:
            if n.faulted == sv.NO_FAULT:
                n.faulted = sv.COMMAND_NOT_FINITE
            wanted = last
        if ramping:
            wanted = n.gain * last if safe == 0.0 else safe + n.gain * (last - safe)
        value = min(max(wanted, n.limits[i, sh.LOW]), n.limits[i, sh.HIGH])
        value = min(max(value, sent - rate), sent + rate)
        n.limits[i, sh.SENT_VALUE] = n.v[j] = value
        if ramping:
            continue
        if value != wanted:
            n.v[CLAMPED] = 1.0
            n.control[sh.SATURATED] += 1
        n.limits[i, sh.LAST] = value
    if odd and n.faulted == sv.NO_FAULT:
        n.faulted = sv.OUTPUT_NOT_FINITE if n.is_plant == 0 else sv.PLANT_NOT_FINITE


@loop_function
def settled(n: Any) -> Any:
    """Return whether every command may be its safe value in the next frame."""
    for i in range(n.n_limits):
        if abs(n.limits[i, sh.SENT_VALUE] - n.limits[i, sh.SAFE]) > n.limits[i, sh.RATE]:
            return False
    return True


@loop_function
def begin_ramp(n: Any, asked: Any) -> None:
    """Set the pace of the ramp by the slowest command; at an end nobody above is waited for."""
    n.pace = n.ramp_step
    for i in range(n.n_limits):
        way = abs(n.limits[i, sh.LAST] - n.limits[i, sh.SAFE])
        if way * n.pace > n.limits[i, sh.RATE]:
            n.pace = n.limits[i, sh.RATE] / way
    if asked:
        n.n_starters = 0
        n.n_awaited = 0
        for row in range(n.n_rx):
            n.n_starters += n.rx_role[row, sh.STARTS] * n.rx_role[row, sh.PEER]
            n.n_awaited += n.rx_role[row, sh.AWAITED] * n.rx_role[row, sh.PEER]
