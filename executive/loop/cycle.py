"""The loop: `one_pass` is a cycle, of executive and emulator alike; only what starts it differs.

    wait       until an absolute deadline (pacing real and sync), or not at all
    receive    drain the bus: check counter and CRC, decode; or block until the frames are here
    overrun    after a cycle that ran past its end: go on, fault, or fall back
    supervise  the state machine and its ramp
    tune       take pending tunings, all or none
    step       the blocks in the rig's order, each on its views of the table; note changes
    limit      look for what is no finite number; clamp, rate-limit and ramp what is sent
    transmit   encode, protect, send: slow frames, frames of every cycle, SYNC last
    publish    snapshot of the table for other processes, and one row for the recorder; once in a
               while all that the node carries into the next cycle

Time is t = k T. `k` counts periods, `passes` the cycles really done: after a stall whole periods
are skipped and counted, deadlines keep their phase, nothing is made up in a burst. Counters on the
wire count passes. Order on the wire in every cycle k:  SYNC(k) -> feedback(k) -> command(k) ->
SYNC(k+1).  The plant samples at SYNC(k); the command computed from that sample acts from SYNC(k+1):
always one sample of delay.

`n` is the LOOP record of `executive.loop.layout`, set up by `executive.nodes.plan`. In here: no
Python object, no allocation, no lock, no file.
"""

from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import loop_function, loop_inline, types
from pcpc.drivers.compiled.stage import ENTRY, Steps, call_at
from pcpc.drivers.compiled.structures import structure
from pcpc.executive.loop import control, meeting, timing
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import next_period, now, runs, set_time, wait
from pcpc.executive.loop.drive import tell_drive
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.keyframes import keep_frame
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.limits import settled
from pcpc.executive.loop.reception import receive
from pcpc.executive.loop.rings import publish_table, push_event, push_record
from pcpc.executive.loop.sending import LastWord, announce, transmit
from pcpc.executive.loop.stalls import pass_stalled_period, skip_stalled_periods, stalled
from pcpc.executive.loop.states import HEARTBEATS, State
from pcpc.executive.loop.stepping import limit, step
from pcpc.executive.loop.strangers import refused
from pcpc.executive.loop.supervisor import hear_requests, judge_overrun, supervise
from pcpc.executive.loop.tuning import tune
from pcpc.executive.loop.variables import NMT, STATE


@loop_function
def one_pass(n: Loop, steps: Steps) -> bool:
    """Run one cycle; return False when the node is to stop."""
    set_time(n)
    wait(n)
    if stalled(n):
        pass_stalled_period(n)
        return n.k < n.guard.cycles or not settled(n.limits)
    skip_stalled_periods(n)
    receive(n)
    if refused(n):
        return False
    judge_overrun(n)
    supervise(n)
    if n.v[STATE] == State.STOP or n.guard.faulted == Fault.PEER_SILENT:
        return False
    tune(n)
    hear_requests(n)
    n.faults.stalled = 0
    if n.drive.on != 0:
        call_at(n.drive.works, n)
    step(n, steps)
    limit(n)
    transmit(n)
    if n.drive.on != 0:
        call_at(n.drive.speaks, n)
    publish(n)
    next_cycle(n)
    return n.k < n.guard.cycles or not settled(n.limits)


N = structure(sh.LOOP)
STEPS = types.UniTuple(ENTRY, sh.MAX_BLOCKS)
DONE = control.place("done")


@loop_inline
def publish(n: Loop) -> None:
    """Publish the table and record the cycle; note when it was done."""
    timing.note(n)
    publish_table(n)
    push_record(n)
    n.control.passes = n.passes + 1
    n.control.cycle = n.k
    n.timing.done = now(n.clock)
    n.timing.publish_ns = n.timing.done - n.timing.sent
    if runs(n.clock):
        timing.count(n)
    keep_frame(n)


@loop_inline
def next_cycle(n: Loop) -> None:
    """Advance to the next cycle; tell how many periods were skipped."""
    next_period(n)
    if n.clock.behind > 0:
        push_event(n, Event.SKIP, n.clock.behind, 0.0)


@loop_function
def finish(n: Loop) -> None:
    """Send the last frames, with state STOP and a safe command, and mark the node as done.

    A node that was refused says nothing: its frames are those of another one.
    """
    guard = n.guard
    set_time(n)
    if n.v[STATE] != State.STOP:
        push_event(n, Event.STATE, State.STOP, 0.0)
    n.v[STATE] = State.STOP
    n.v[NMT] = HEARTBEATS[State.STOP]
    guard.gain = 0.0
    tell_drive(n, State.STOP)
    n.control.state = State.STOP
    if refused(n):
        n.control.fault = guard.faulted
        meeting.greet(n)
    elif n.tx.last_word == LastWord.ALL_FRAMES:
        limit(n)
        transmit(n)
    else:
        announce(n)
    if guard.faulted != Fault.NONE and n.control.fault == Fault.NONE:  # in the last cycle
        n.control.fault = guard.faulted
        push_event(n, Event.FAULT, guard.faulted, 0.0)
    publish_table(n)
    libc.store_release(n.control, "done", 1)


@loop_function
def pass_or_finish(n: Loop, steps: Steps) -> None:
    """Run one cycle of a node that has not ended, and its end when that comes."""
    if n.control.done == 0 and not one_pass(n, steps):
        finish(n)
