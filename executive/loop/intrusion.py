"""Two senders of one frame, recognised by what a single one never does.

    two senders     a counter that was there already comes with other data; or, as a hint, a counter
                    goes back, or a frame with a wrong CRC comes beside a good one of the cycle
    counter ahead   a counter moved by more than the time since it last did, and MAX_DELTA
    two places      a heartbeat comes before three quarters of its turn are over, and again so
                    within HINT_TURNS turns (a hint)

The first two are judged within a turn of the frame, so that a counter that went all the way round
is none. A bus that repeats a frame repeats its bytes; one that loses frames or lets them wait moves
a counter by no more than the time that passed. One that lets frames overtake each other looks like
two senders, for which a hint alone is not believed: HINTS of them within HINT_TURNS turns are.

What is believed leads to what the rig chose: it is counted and told (always), the frame is none of
this cycle's input and what came of it is taken back (hold), the node faults as well (fault).
"""

from pcpc.drivers.can import can_id, e2e
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.compiled.structures import copy
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.rings import push_event
from pcpc.executive.loop.strangers import blame, word_of

HINTS, HINT_TURNS = 3, 10
EVENT_CYCLES = 100  # a frame is told at most this often


class Reaction(NumberedEnum):
    """What follows."""

    COUNT, HOLD, FAULT = range(3)


REACTIONS = Reaction.words()


@loop_function
def suspect(n: Loop, row: int, state: int, lost: int) -> None:
    """Look for a second sender in a frame that is not used; `lost` before it, as of its check."""
    rx, period, before = n.rx, n.rx.frames[row].every_n, n.intrusion.counted_frame[row]
    if state == FrameState.ERROR:
        if rx.state[row].fresh != 0:
            note_sign(n, row, Event.TWO_SENDERS, 1)
    elif state == FrameState.REPEATED:
        if rx.state[row].still_cycles <= period and differs(n, row):
            note_sign(n, row, Event.TWO_SENDERS, HINTS)
    else:
        mask = rx.frames[row].counter_mask
        heard = int64(before[8 + rx.frames[row].counter_byte])
        ahead = rx.state[row].last_counter - (heard >> rx.frames[row].counter_shift)
        ahead &= mask
        turns = lost + 1  # since the counter moved, or more than it did
        if ahead > mask >> 1:
            if turns == 1:
                note_sign(n, row, Event.TWO_SENDERS, 1)
        elif ahead >= turns + n.clock.behind // period + e2e.MAX_DELTA:
            note_sign(n, row, Event.AHEAD, HINTS)
        copy(before, n.wire.rx)


@loop_function
def differs(n: Loop, row: int) -> bool:
    """Return whether the frame in `wire.rx` is another than the one that had its counter."""
    other = False
    for i in range(8, 8 + n.rx.frames[row].dlc):
        other |= n.wire.rx[i] != n.intrusion.counted_frame[row, i]
    return other


@loop_function
def watch_beat(n: Loop, row: int) -> None:
    """Look at the time between two heartbeats; after a stall they come together."""
    watch = n.intrusion
    period, before = watch.beat_every[row], watch.beat_at[row]
    watch.beat_at[row] = n.k
    if before > 0 and n.clock.behind == 0 and 4 * (n.k - before) < 3 * period:
        if n.k - watch.early_at[row] <= HINT_TURNS * period:
            note_sign(n, row, Event.TWO_PLACES, 1)
        watch.early_at[row] = n.k


@loop_function
def note_sign(n: Loop, row: int, event: int, weight: int) -> None:
    """Count and tell a sign of a second sender of a frame; believe it, or HINTS of them."""
    watch, word = n.intrusion, word_of(n.wire.rx)
    n.control.intrusions += 1
    n.control.signs_on_purpose += n.faults.shown
    if n.passes - watch.hint_since[row] >= HINT_TURNS * n.rx.frames[row].every_n:
        watch.hint_since[row], watch.hints[row] = n.passes, 0
    watch.hints[row] += weight
    if n.k >= watch.told_until[row]:
        watch.told_until[row] = n.k + EVENT_CYCLES
        push_event(n, event, word & can_id.ID, n.control.intrusions)
    if watch.hints[row] >= HINTS and watch.reaction != Reaction.COUNT:
        watch.doubted[row] = n.passes + 1
        if watch.reaction == Reaction.FAULT:
            blame(n, Fault.INTRUSION, word)


@loop_function
def is_out(n: Loop, row: int) -> bool:
    """Return whether a frame is none of this cycle's input, since two senders are believed."""
    return n.intrusion.doubted[row] == n.passes + 1


@loop_function
def keep_values(n: Loop, row: int, new: bool) -> None:
    """Keep the values that the first frame of its row in this cycle is about to replace."""
    rx, watch = n.rx, n.intrusion
    if new and watch.reaction != Reaction.COUNT:
        watch.kept[row] = n.passes + 1
        for i in range(rx.frames[row].first, rx.frames[row].end):
            watch.before[i] = n.v[rx.signals[i].variable]


@loop_function
def take_back(n: Loop, row: int) -> bool:
    """Take back what a frame that is out was to this cycle; return whether it was anything."""
    rx, watch = n.rx, n.intrusion
    if not is_out(n, row) or watch.kept[row] != n.passes + 1:
        return False
    watch.kept[row] = 0
    rx.fresh -= watch.fresh[row]
    for i in range(rx.frames[row].first, rx.frames[row].end):
        n.v[rx.signals[i].variable] = watch.before[i]
    return True
