"""How nodes find each other, recorded the same in every run without a clock.

Each node repeats its heartbeat until the other one is there. How often depends on who was started
first, so that in lockstep and virtual time only what always happens is taken and recorded:

    sent                 one heartbeat, once the node below was heard (the plant: at once)
    received from above  the first heartbeat, then SYNC(0)
    received from below  the first heartbeat, then the frames of the sample of t = 0

That sample has a heartbeat too, which looks like those before it. Of those the latest is held, and
taken when a frame comes that is sent after it; a frame that is sent before it shows that the
sample's own is still to come.
"""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from drivers import dbc
from drivers.jit import loop_function
from drivers.wire_layout import FRAME_BYTES
from executive import protocol
from executive import shared as sh

NO_PART, FROM_ABOVE, FROM_BELOW, BEFORE, AFTER = range(5)  # heartbeats; frames of a sample
TAKE, LEAVE, HELD_FIRST = range(3)


def parts(rx: Sequence[dbc.Frame], below: Collection[str], leads: bool) -> list[int]:
    """Return what each received frame is to the meeting; `below`: frames on the bus to the plant.

    `leads`: this is the executive, all of whose frames come from below.
    """
    lower = [frame for frame in rx if leads or frame.name in below]
    beats = sorted(filter(protocol.heartbeat, lower), key=protocol.sending_order)
    found = []
    for frame in rx:
        if protocol.heartbeat(frame) and frame not in lower:
            found.append(FROM_ABOVE)
        elif not beats or frame not in lower:
            found.append(NO_PART)
        elif frame is beats[0]:
            found.append(FROM_BELOW)
        else:
            later = protocol.sending_order(frame) > protocol.sending_order(beats[0])
            found.append(AFTER if later else BEFORE)
    return found


@loop_function
def sorted_out(n: Any, row: Any) -> Any:
    """Return what to do with `wire.rx`, a frame of `row` that came before the first cycle ended."""
    part = n.rx_role[row, sh.MEETING]
    if part in (FROM_ABOVE, FROM_BELOW):
        if n.met[row] == 0 or (part == FROM_BELOW and n.sampled != 0):
            n.met[row] = 1
            return TAKE
        if part == FROM_BELOW:
            n.holding = row + 1
            for i in range(FRAME_BYTES):
                n.held[i] = n.wire.rx[i]
        return LEAVE
    if part == BEFORE:
        n.holding = np.int64(0)
    if part in (BEFORE, AFTER):
        n.sampled = 1
    return HELD_FIRST if part == AFTER and n.holding != 0 else TAKE


@loop_function
def exchange_held(n: Any) -> None:
    """Exchange `wire.rx` for the frame that is held, or back."""
    for i in range(FRAME_BYTES):
        byte = n.held[i]
        n.held[i] = n.wire.rx[i]
        n.wire.rx[i] = byte


@loop_function
def held_row(n: Any) -> Any:
    """Return the row of the frame that is held, which is held no longer."""
    row = n.holding - 1
    n.holding = np.int64(0)
    return row
