"""What comes, from the bus to the table.

receive      the frames of a cycle: those that are there, or until all awaited are
take_frame   whose is it: one of ours, a stranger's, or part of the meeting of the nodes
disturbed    what the rig does to it on purpose; the one seam between wire and acceptance
accept       counter and CRC
decode       signals to the table, but for what is doubted; or refuse, which counts why not
"""

from pcpc.drivers.can import can_id, codec, e2e
from pcpc.drivers.can.bus import RECEIVE_TIMEOUT_US
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.can.wire import WAIT_MS, get_frame
from pcpc.drivers.can.wire_layout import Arrival
from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.compiled.stage import call_at
from pcpc.drivers.compiled.structures import copy, data_of
from pcpc.executive.loop import meeting, on_wire
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.bus_state import fault_while_off, note_bus_error
from pcpc.executive.loop.clock import now, paced, runs, start, stopping
from pcpc.executive.loop.doubts import has_doubts, note_sender, note_used, take_values
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.injected_frames import AND_ANOTHER, GONE, excused, inject, judge
from pcpc.executive.loop.injection import peer_stalled
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.limits import quick_stop
from pcpc.executive.loop.losses import is_lost
from pcpc.executive.loop.meeting import Turn
from pcpc.executive.loop.rings import push_frame
from pcpc.executive.loop.sending import announce, announce_again
from pcpc.executive.loop.strangers import is_foreign, note_foreign, note_repeat, refused, word_of

DRAIN_FRAMES = 1024  # at most this many in one cycle
RECEIVE_NS, LONGEST_LOOK_NS = 1000 * RECEIVE_TIMEOUT_US, 1_000_000 * WAIT_MS


@loop_inline
def receive(n: Loop) -> None:
    """Drain what is there; before the clock runs, and in lockstep, block until all is here."""
    if paced(n):
        drain(n)
        n.timing.received = now(n.clock)
        if n.guard.off != 0:
            fault_while_off(n)
        return
    gather(n)
    if n.guard.off != 0:
        fault_while_off(n)
    if not refused(n):
        start(n)
        n.timing.received = n.clock.wake


@loop_inline
def drain(n: Loop) -> None:
    """Take the frames that are there."""
    for _ in range(DRAIN_FRAMES):
        result = take(n, False)
        if result in (Arrival.NOTHING, Arrival.FAILED):
            break


@loop_function
def gather(n: Loop) -> None:
    """Block until the frames that start this cycle are here, or the other node counts as silent.

    There is no limit of frames, unless the host asks for the end: those of others may come before.
    They break no silence. Of each look at most a time-out counts: a process that was stopped
    meanwhile has not waited.
    """
    waited_ns, drained, before, since = int64(0), 0, n.rx.started, now(n.clock)
    if peer_stalled(n):
        n.rx.started += n.rx.starters
    while n.rx.started < n.rx.starters and drained < DRAIN_FRAMES:
        result, time = take(n, True), now(n.clock)
        drained += stopping(n)
        waited_ns += min(time - since, LONGEST_LOOK_NS)
        since = time
        if n.rx.started > before or n.passes == 0:  # the host gives the first meeting up
            waited_ns, before = int64(0), n.rx.started
        if result == Arrival.FRAME:
            if refused(n):
                break
            if n.passes == 0 and runs(n.clock) and meeting.asks(n) and not meeting.is_over(n):
                announce_again(n)  # it may ask so often that no time-out comes
        elif result == Arrival.FAILED or (result == Arrival.NOTHING and stopping(n)):
            break
        elif result == Arrival.NOTHING and not runs(n.clock):  # all that is sent was sent
            give_up(n)
            break
        elif result == Arrival.NOTHING and n.passes == 0 and not meeting.is_over(n):
            announce_again(n)
        if waited_ns >= patience(n) * RECEIVE_NS:
            give_up(n)
            break


@loop_function
def give_up(n: Loop) -> None:
    """Wait no longer for the other node; note the first of its frames that did not come.

    Behind another fault, which keeps its own culprit, none.
    """
    first = n.guard.faulted == Fault.NONE
    n.guard.faulted = Fault.PEER_SILENT
    for row in range(n.rx.n - 1, -1, -1):
        role = n.rx.role[row]
        if first and role.starts != 0 and n.rx.state[row].fresh == 0:
            frame = n.rx.frames[row]
            n.control.culprit = frame.can_id | frame.extended << can_id.EXTENDED_BIT


@loop_function
def patience(n: Loop) -> int:
    """Return how many time-outs are silence: more while the recorder lags."""
    lags = n.record_ends.head != libc.load_acquire(n.record_taken, 0)
    waits = n.rings.wait_recorder != 0 and n.control.recorded != 0 and lags
    return n.rx.patience * (sh.RECORDER_PATIENCE if waits else 1)


@loop_inline
def take(n: Loop, block: bool) -> int:
    """Take one frame, if one comes; return what came, see `drivers.can.wire.get_frame`."""
    result = get_frame(n.wire, block)
    if result == Arrival.FRAME:
        take_one(n)
    elif result == Arrival.FAILED:
        n.control.bus_errno = n.wire.errno
        n.guard.faulted = Fault.BUS_FAILED
    elif result == Arrival.BUS_ERROR:
        note_bus_error(n)
    return result


@loop_function
def take_one(n: Loop) -> None:
    """Let the drive of this node, if it is one, or the node itself take `wire.rx`."""
    if n.drive.on == 0 or call_at(n.drive.hears, n) == 0:
        take_frame(n)


@loop_function
def wait_for_peer(n: Loop) -> bool:
    """Block until all nodes below are heard, and answer; return False when the host stops us.

    Without a clock a local node turns to the node above only then.
    """
    n.wire.muted = n.wire.in_turn
    while not stopping(n) and n.guard.faulted == Fault.NONE:
        result = get_frame(n.wire, True)
        if result == Arrival.FRAME:
            row = take_frame(n)
            if row >= 0 and meeting.all_heard(n, row):
                n.wire.muted = 0
                announce(n)
                return True
        if result == Arrival.NOTHING and not runs(n.clock):
            n.guard.faulted = Fault.PEER_SILENT
            return False
        if result == Arrival.NOTHING and (n.meeting.ordered == 0 or n.meeting.between == 0):
            announce_again(n)
        if result == Arrival.FAILED:
            n.control.bus_errno = n.wire.errno
            n.guard.faulted = Fault.BUS_FAILED
            return False
    return False


@loop_function
def take_frame(n: Loop) -> int:
    """Check and decode `wire.rx`; return its row in the frame table, -1 if it is not for us."""
    word = word_of(n.wire.rx)
    row = codec.frame_of(word, n.rx.frames, n.rx.n)
    if is_foreign(n, row, word):
        note_foreign(n, word)
        return int64(-1)
    if row < 0:
        meeting.compare_greeting(n, word)
        return row
    if n.meeting.ordered != 0 and n.passes == 0:
        turn = meeting.sorted_out(n, row)
        if turn == Turn.LEAVE:
            return int64(-1)
        if turn == Turn.HELD_FIRST:
            peer = n.rx.role[row].peer - 1
            meeting.exchange_held(n, peer)
            use_frame(n, meeting.held_row(n, peer))
            meeting.exchange_held(n, peer)
    return use_frame(n, row)


@loop_function
def use_frame(n: Loop, row: int) -> int:
    """Disturb, accept and decode `wire.rx`, a frame of `row`; return the row, -1 if it is lost."""
    after_loss = n.rx.loss_state[row].lost
    on_wire.note_as_came(n, row)
    if disturbed(n, row):
        return int64(-1)
    if n.faults.n > n.faults.n_values:
        done = inject(n, row)
        if done != 0:
            put_in_place(n, row, done)
            return row
    new = n.rx.state[row].fresh == 0
    state, lost = accept(n, row)
    if state == FrameState.OK or state == FrameState.OK_SOME_LOST:
        decode(n, row, new)
    else:
        note_sender(n, row, state, lost)
        refuse(n, row, state, after_loss)
    return row


@loop_function
def put_in_place(n: Loop, row: int, done: int) -> None:
    """Accept what faults put in the place of a frame, and the one that comes after it."""
    new, used = n.rx.state[row].fresh == 0, False
    n.faults.shown = 1
    if done & GONE == 0:
        state = judge(n, row)
        used = state == FrameState.OK or state == FrameState.OK_SOME_LOST
        if used:
            decode(n, row, new)
            n.control.lost_on_purpose -= 1
    if done & AND_ANOTHER != 0:
        copy(n.wire.rx, n.faults.another)
        state = judge(n, row)
        if state == FrameState.OK or state == FrameState.OK_SOME_LOST:
            decode(n, row, new and not used)
            used = True
    if not used:
        n.rx.started += n.rx.role[row].starts  # nobody waits for it


@loop_inline
def disturbed(n: Loop, row: int) -> bool:
    """Do to the frame what the rig wants of its bus; return True if nothing is left of it."""
    if not is_lost(n, row):
        return False
    n.control.lost_on_purpose += 1
    n.faults.on_wire[row].fresh = n.rx.state[row].fresh  # losses excuse no stale cycle
    n.rx.started += n.rx.role[row].starts  # nobody waits for it
    push_frame(n, n.wire.rx, 1, FrameState.LOST_ON_PURPOSE)
    return True


@loop_inline
def accept(n: Loop, row: int) -> tuple[int, int]:
    """Check counter and CRC, record the frame; return its state, and how many were lost."""
    frame = n.wire.rx
    state, lost = e2e.check(
        data_of(frame), codec.length_of(frame, row, n.rx.frames), row, n.rx.frames, n.rx.state
    )
    push_frame(n, frame, 1, state)
    n.control.lost += lost
    if n.faults.spoiled[row] == 0:
        on_wire.count(n, state, lost)
    return state, lost


@loop_inline
def decode(n: Loop, row: int, new: bool) -> None:
    """Write the frame's signals to the table; `new`: it is the first of its row in this cycle."""
    rx = n.rx
    if has_doubts(n, row):
        take_values(n, row, new)
    else:
        codec.unpack(data_of(n.wire.rx), row, rx.frames, rx.signals, n.v)
    note_used(n, row)
    n.control.received += 1
    if row == n.guard.stop_row:
        quick_stop(n, Fault.STOP_FRAME)
    if new:
        n.rx.started += n.rx.role[row].starts
        n.rx.fresh += n.rx.role[row].awaited
        if n.meeting.between != 0 and n.rx.role[row].starts > n.rx.role[row].awaited:
            n.wire.muted = 1  # what follows this SYNC belongs to the next cycle


@loop_function
def refuse(n: Loop, row: int, state: int, after_loss: int) -> None:
    """Do what follows from a frame that is not used; what was on purpose is no mistake."""
    if excused(n, row):
        n.rx.started += n.rx.role[row].starts
        if state == FrameState.REPEATED and n.rx.role[row].starts + n.rx.role[row].awaited > 0:
            note_repeat(n, word_of(n.wire.rx))
    elif state == FrameState.REPEATED:
        n.rx.started += n.rx.role[row].starts * after_loss  # of a whole turn of the counter
        if after_loss == 0 and n.rx.role[row].starts + n.rx.role[row].awaited > 0:
            note_repeat(n, word_of(n.wire.rx))
    elif state == FrameState.WRONG_SEQUENCE:
        if n.rx.role[row].starts > n.rx.role[row].awaited:
            n.wire.muted = 1
        n.rx.started += n.rx.role[row].starts  # it came; the next one will be trusted
