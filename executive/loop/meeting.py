"""How nodes find each other, recorded the same in every run without a clock.

Each node repeats its heartbeat until the other one is there, and one that waits for its first cycle
answers that of the node above, which may have come later. How often depends on who was started
first, so that in lockstep and virtual time only what always happens is taken and recorded; and an
executive that has answered is silent until the first sample comes: its next heartbeat would be one
of cycle 1.

    sent                 one heartbeat, once the node below was heard (the plant: at once)
    received from above  the first heartbeat, then SYNC(0)
    received from below  the first heartbeat, then the frames of the sample of t = 0

That sample has a heartbeat too, which looks like those before it. Of those the latest is held, and
taken when a frame comes that is sent after it; a frame that is sent before it shows that the
sample's own is still to come.

Nodes that are started one by one greet before each heartbeat, off the record: whose rig has another
plant is no part of this run, and neither node begins.
"""

from pcpc.drivers.can import codec
from pcpc.drivers.can.wire import put_frame
from pcpc.drivers.can.wire_layout import FRAME_BYTES
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.compiled.rows import LENGTH
from pcpc.drivers.compiled.structures import copy
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.strangers import blame, word_of

_ROLES = 0x1F  # its bits that say whose it is


class MeetingPart(NumberedEnum):
    """The part of a received frame: of heartbeats; of frames of a sample, by that of its node."""

    NO_PART, FROM_ABOVE, FROM_BELOW, BEFORE, AFTER = range(5)


class Turn(NumberedEnum):
    """What to do with a frame."""

    TAKE, LEAVE, HELD_FIRST = range(3)


@loop_function
def sorted_out(n: Loop, row: int) -> int:
    """Return what to do with `wire.rx`, a frame of `row` that came before the first cycle ended."""
    part, peer = n.rx.role[row].meeting, max(n.rx.role[row].peer - 1, 0)
    if part in (MeetingPart.FROM_ABOVE, MeetingPart.FROM_BELOW):
        if n.meeting.met[row] == 0 or (
            part == MeetingPart.FROM_BELOW and n.meeting.sampled[peer] != 0
        ):
            n.meeting.met[row] = 1
            return Turn.TAKE
        if part == MeetingPart.FROM_BELOW:
            n.meeting.holding[peer] = row + 1
            copy(n.meeting.held[peer], n.wire.rx)
        return Turn.LEAVE
    if part == MeetingPart.BEFORE:
        n.meeting.holding[peer] = int64(0)
    if part in (MeetingPart.BEFORE, MeetingPart.AFTER):
        n.meeting.sampled[peer] = 1
    return (
        Turn.HELD_FIRST if part == MeetingPart.AFTER and n.meeting.holding[peer] != 0 else Turn.TAKE
    )


@loop_inline
def asks(n: Loop) -> bool:
    """Return whether `wire.rx` is the heartbeat of the node above, which waits for one."""
    row = codec.frame_of(word_of(n.wire.rx), n.rx.frames, n.rx.n)
    return row >= 0 and n.rx.role[row].meeting == MeetingPart.FROM_ABOVE


@loop_inline
def is_over(n: Loop) -> bool:
    """Return whether, before the first cycle, all who wait for a heartbeat have one (no clock)."""
    return n.meeting.ordered != 0 and n.meeting.seeks_below != 0 and n.meeting.between == 0


@loop_function
def exchange_held(n: Loop, peer: int) -> None:
    """Exchange `wire.rx` for the frame of a node that is held, or back."""
    for i in range(FRAME_BYTES):
        byte = n.meeting.held[peer][i]
        n.meeting.held[peer][i] = n.wire.rx[i]
        n.wire.rx[i] = byte


@loop_function
def held_row(n: Loop, peer: int) -> int:
    """Return the row of the frame that is held, which is held no longer."""
    row = n.meeting.holding[peer] - 1
    n.meeting.holding[peer] = int64(0)
    return row


@loop_inline
def all_heard(n: Loop, row: int) -> bool:
    """Note that the sender of a frame of `row` was heard; return whether all below were."""
    peer = n.rx.role[row].peer
    if peer == 0:
        return False
    n.meeting.heard |= int64(1) << (peer - 1)
    return n.meeting.heard == (int64(1) << n.meeting.peers) - 1


@loop_function
def greet(n: Loop) -> None:
    """Say what plant this node's rig has, before the first cycle."""
    if n.meeting.greets != 0 and n.passes == 0:
        copy(n.wire.tx, n.meeting.greeting)
        put_frame(n.wire)


@loop_function
def compare_greeting(n: Loop, word: int) -> None:
    """Refuse to begin if `wire.rx` is the greeting of another node whose rig has another plant."""
    own = word_of(n.meeting.greeting)
    if n.meeting.greets == 0 or n.passes != 0 or word == own or word | _ROLES != own | _ROLES:
        return
    differs = n.wire.rx[LENGTH] != n.meeting.greeting[LENGTH]
    for i in range(8, 16):
        differs |= n.wire.rx[i] != n.meeting.greeting[i]
    if differs:
        blame(n, Fault.ANOTHER_SENDER, word)
