"""Another sender of this node's frames: noticed by what comes, never taken, and soon a fault.

    own id       a frame that this node sends, heard from somebody else: a second node of its kind
    other source a frame that it receives, from another address than the first one of that frame;
                 udp_multicast only, nothing else tells who sent
    repeats      an awaited frame whose counter was there already, again and again: where nobody
                 can tell senders apart, the true frame behind a forged one

The first two are *foreign*: one alone keeps a run from being ok, FOREIGN_FRAMES of them within
FOREIGN_CYCLES are a fault, which on a clock is two cycles after the second sender began. A repeat
alone may come from the bus (a CAN controller that missed an acknowledgement sends again), so
REPEATED_FRAMES within REPEATED_CYCLES are one. Before its first cycle a node that hears a foreign
frame does not begin at all; it listens first.

A source that was silent for more than SILENT_TURNS of its frame's turns may be replaced: a node
that was started again is let in.
"""

from pcpc.drivers.can import can_id, codec
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.can.wire import get_frame
from pcpc.drivers.can.wire_layout import STRANGER, Arrival
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.executive.loop.clock import now, runs, stopping
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.reception_layout import Streak
from pcpc.executive.loop.rings import push_event, push_frame

FLOOD_NS = 200_000_000  # of a bus that is never empty

FOREIGN_FRAMES, FOREIGN_CYCLES = 3, 10
REPEATED_FRAMES, REPEATED_CYCLES = 10, 100
SILENT_TURNS = 3


@loop_inline
def word_of(frame: Cells[Byte]) -> int:
    """Return id and flags of a frame (16,)."""
    return codec.four_bytes(frame, 0)


@loop_function
def is_foreign(n: Loop, row: int, word: int) -> bool:
    """Return whether the frame in `wire.rx`, of `row` in the receive table or -1, is foreign."""
    source = n.wire.source
    if row < 0:
        return codec.frame_of(word, n.tx.frames, n.tx.n) >= 0
    if source == n.rx.source[row] or row == n.guard.stop_row:  # which anybody may send
        return False
    silent = n.rx.state[row].age_cycles > SILENT_TURNS * n.rx.frames[row].every_n
    if source != STRANGER and (n.rx.source[row] == 0 or n.passes == 0 or silent):
        n.rx.source[row] = source
        return False
    return True


@loop_function
def note_foreign(n: Loop, word: int) -> None:
    """Count and record the foreign frame in `wire.rx`; too many are a fault."""
    n.control.foreign += 1
    push_frame(n, n.wire.rx, 1, FrameState.FOREIGN)
    if _note(n, n.rx.foreign, FOREIGN_CYCLES) == 1:
        push_event(n, Event.FOREIGN, word & can_id.ID, n.control.foreign)
    if n.rx.foreign.count >= FOREIGN_FRAMES or n.passes == 0:
        blame(n, Fault.ANOTHER_SENDER, word)


@loop_function
def note_repeat(n: Loop, word: int) -> None:
    """Count a repeated awaited frame; too many are a fault."""
    if _note(n, n.rx.repeats, REPEATED_CYCLES) >= REPEATED_FRAMES:
        blame(n, Fault.REPEATED_INPUT, word)


@loop_function
def _note(n: Loop, streak: Streak, cycles: int) -> int:
    """Count one more of a kind; return how many there were within `cycles` cycles."""
    if streak.count == 0 or n.passes - streak.since >= cycles:
        streak.since = n.passes
        streak.count = 0
    streak.count += 1
    return streak.count


@loop_function
def blame(n: Loop, fault: int, word: int) -> None:
    """Fault because of a frame, if nothing else was wrong before."""
    if n.guard.faulted == Fault.NONE:
        n.guard.faulted = fault
        n.control.culprit = word


@loop_function
def refused(n: Loop) -> bool:
    """Return True if this node must not begin: another one of its kind is on the bus."""
    return n.passes == 0 and n.guard.faulted == Fault.ANOTHER_SENDER


@loop_function
def listen(n: Loop) -> None:
    """Hear the bus before the first word, for another node of this kind.

    Long enough for the cyclic frames of a running node and the heartbeats of a waiting one, counted
    from when the bus was opened; what has come since then is heard too, but for a flood.
    """
    if not runs(n.clock) or n.rx.listen_ns <= 0:
        return
    time, result = now(n.clock), int64(Arrival.FRAME)
    until = time + n.rx.listen_ns
    while time < until or (result == Arrival.FRAME and time < until + FLOOD_NS):
        if stopping(n) or n.guard.faulted != Fault.NONE:
            break
        result = int64(get_frame(n.wire, time < until))
        time = now(n.clock)
        if result == Arrival.FRAME:
            word = word_of(n.wire.rx)
            row = codec.frame_of(word, n.rx.frames, n.rx.n)
            if row < 0 and is_foreign(n, row, word):
                note_foreign(n, word)
        elif result == Arrival.FAILED:
            n.control.bus_errno = n.wire.errno
            n.guard.faulted = Fault.BUS_FAILED
