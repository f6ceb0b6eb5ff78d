"""The loop. One compiled cycle for executive and emulator; only what starts a cycle differs.

    wait       until an absolute deadline (pacing real and sync), or not at all
    receive    drain the bus: check counter and CRC, decode; or block until the frames are here
    overrun    after a cycle that ran past its end: go on, fault, or fall back
    supervise  the state machine and its ramp
    tune       take pending tunings, all or none
    step       the blocks in the rig's order, each on its views of the table; note changes
    limit      look for what is no finite number; clamp, rate-limit and ramp what is sent
    transmit   encode, protect, send: slow frames, frames of every cycle, SYNC last
    publish    snapshot of the table for other processes, and one row for the recorder

Time is t = k T. `k` counts periods, `passes` the cycles really done: after a stall whole periods
are skipped and counted, deadlines keep their phase, nothing is made up in a burst. Counters on the
wire count passes.

Order on the wire in every cycle k:  SYNC(k) -> feedback(k) -> command(k) -> SYNC(k+1).  The plant
samples at SYNC(k); the command computed from that sample acts from SYNC(k+1): always one sample of
delay.

`n` is the LOOP record of `executive.loop.shared`, set up by `executive.nodes.plan`. In here: no
Python object, no allocation, no lock, no file.
"""

from typing import Any

import numpy as np

from pcpc.drivers import dbc, e2e, libc
from pcpc.drivers.jit import i8, loop, loop_function, loop_inline, types
from pcpc.drivers.stage import ENTRY, call, part
from pcpc.drivers.structures import structure
from pcpc.executive.loop import meeting, on_wire, timing
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import supervisor as sv
from pcpc.executive.loop.clock import CLOCKED, next_period, now, runs, set_time, stopping, wait
from pcpc.executive.loop.drive import tell_drive
from pcpc.executive.loop.floods import flood
from pcpc.executive.loop.injected_values import OUTPUTS, PARAMETERS, SENT, spoil
from pcpc.executive.loop.limits import begin_ramp, limit_commands, quick_stop, settled
from pcpc.executive.loop.reception import receive, wait_for_peer
from pcpc.executive.loop.rings import publish_table, push_event, push_record
from pcpc.executive.loop.sending import announce, copy_inputs, request_first_sample, send_frame
from pcpc.executive.loop.stalls import own_up, stalled, stand_still
from pcpc.executive.loop.strangers import listen, refused
from pcpc.executive.loop.tuning import tune
from pcpc.executive.loop.variables import (
    DISARMED,
    ERROR_CODE,
    FALLBACK,
    FAULT,
    GAIN,
    MISSING,
    NMT,
    RESET_ASKED,
    STATE,
    STOP_ASKED,
    T_S,
)

N = structure(sh.LOOP)
STEPS = types.UniTuple(ENTRY, sh.MAX_BLOCKS)


# ------------------------------------------------------------------------------------------ overrun


@loop_function
def judge_overrun(n: Any) -> None:
    """Count cycles in a row that ran past their end; do what the rig says about too many."""
    guard, behind = n.guard, n.clock.behind
    guard.overruns = guard.overruns + 1 if behind > 0 and n.passes > guard.grace_passes else 0
    if guard.overrun_policy == sh.SKIP or guard.overruns < guard.overrun_after:
        return
    if guard.overrun_policy == sh.FAULT_AFTER:
        if guard.faulted == sv.NO_FAULT:
            guard.faulted = sv.OVERRUN
    elif n.v[FALLBACK] == 0.0:
        n.v[FALLBACK] = 1.0
        push_event(n, sh.FALLBACK_EVENT, behind, 0.0)


# ---------------------------------------------------------------------------------------- supervise


@loop_function
def over(n: Any) -> Any:
    """Return True once the run is over, by its duration, its host or the node above."""
    guard = n.guard
    told = guard.mode_index >= 0 and n.v[guard.mode_index] == sv.STOP
    return n.k >= guard.cycles or stopping(n) or told or guard.stop != 0


@loop_inline
def count_missing(n: Any, running: Any) -> None:
    """Count cycles without complete valid input; turn to the input of the next one."""
    guard, rx = n.guard, n.rx
    if rx.fresh >= rx.awaited:
        guard.missing = n.faults.missed = 0
    else:
        guard.missing += 1
        n.faults.missed = 0 if on_wire.taken_on_purpose(n) else n.faults.missed + 1
        n.control[sh.HELD] += running
        n.control[sh.STALE] += running if guard.missing > guard.hold_cycles else 0
        n.control[sh.STARVED] += running if n.faults.missed > guard.hold_cycles else 0
    rx.started = 0
    rx.fresh = 0
    n.wire.muted = 0
    e2e.begin_cycle(rx.state, rx.n)
    on_wire.age_frames(n)


@loop_function
def supervise(n: Any) -> None:
    """Advance the state machine by what is missing; ramp the gain in FAULT and at the end."""
    guard, before, asked = n.guard, np.int64(n.v[STATE]), over(n)
    count_missing(n, sv.DOES[before, sv.RUNS])
    silent = sv.DOES[before, sv.EXPECTS] != 0 and guard.missing >= guard.fault_after
    if silent and guard.faulted == sv.NO_FAULT and not asked:
        guard.faulted = sv.INPUT_MISSING
    watch_estop(n)
    safe = settled(n.limits)
    listens = n.clock.trigger == CLOCKED or not silent  # the node above, to what is sent
    leave = asked and (safe or not listens)
    fresh, ramped = guard.missing == 0, guard.gain <= 0.0 and safe
    if guard.reset != 0:
        judge_reset(n, fresh and ramped)
    disarmed = guard.disarmed != 0
    state = sv.advance(before, fresh, guard.faulted, leave, ramped and guard.waits == 0, disarmed)
    waits = disarmed and state == sv.READY
    ramps = sv.DOES[state, sv.RAMPS] != 0 or asked or waits
    if before == sv.READY and not ramps:
        guard.pace = 0.0
    if ramps and (guard.pace == 0.0 or guard.quick == sh.ASKED):
        begin_ramp(n, asked)
    if sv.DOES[before, sv.RAMPS] != 0 or (asked and not leave) or (waits and before == state):
        guard.gain = max(guard.gain - guard.pace, 0.0)
    elif not ramps and sv.DOES[state, sv.SENDS] != 0:
        guard.gain = min(guard.gain + guard.ramp_step, 1.0)
    enter(n, before, state)
    watch_input(n, state)


@loop_inline
def watch_estop(n: Any) -> None:
    """Let an emergency stop be a fault, whatever else is wrong, and the ramp a quick stop."""
    guard = n.guard
    if guard.estop_index >= 0 and n.v[guard.estop_index] != 0.0:
        quick_stop(n, sv.EMERGENCY_STOP)


@loop_function
def hear_requests(n: Any) -> None:
    """Note what was asked of the supervisor, for its next cycle; a request is heard once.

    Being disarmed is no request: it lasts.

    A reset forgets the fault, so that a detector that still sees one tells it until then.
    """
    guard, safe = n.guard, n.guard.gain <= 0.0 and settled(n.limits)
    guard.disarmed = np.int64(n.v[DISARMED] != 0.0)
    if n.v[RESET_ASKED] != 0.0:
        n.v[RESET_ASKED] = 0.0
        if n.v[STATE] == sv.FAULT and guard.waits != 0 and safe:
            guard.reset, guard.faulted, guard.quick = 1, sv.NO_FAULT, 0
    if n.v[STOP_ASKED] != 0.0:
        guard.stop = 1
        if n.v[STOP_ASKED] > 1.0 and guard.quick == 0:
            guard.quick = sh.ASKED


@loop_inline
def judge_reset(n: Any, possible: Any) -> None:
    """Leave no fault, if that is possible and none was seen since; else tell which one is there."""
    guard = n.guard
    guard.reset = 0
    if guard.faulted == sv.NO_FAULT and possible:
        guard.pace = 0.0
        return
    if guard.faulted == sv.NO_FAULT:
        guard.faulted = n.control[sh.FAULT]
    n.control[sh.FAULT] = guard.faulted
    push_event(n, sh.FAULT_EVENT, guard.faulted, 0.0)


@loop_inline
def enter(n: Any, before: Any, state: Any) -> None:
    """Tell the state, and the fault with which it was entered."""
    guard = n.guard
    if state != before:
        push_event(n, sh.STATE_EVENT, state, 0.0)
        if state == sv.FAULT:
            n.control[sh.FAULT] = guard.faulted
            push_event(n, sh.FAULT_EVENT, guard.faulted, 0.0)
            if guard.manual != 0:
                n.v[DISARMED] = 1.0
    n.control[sh.STATE] = state
    n.v[STATE] = state
    n.v[FAULT] = guard.faulted
    n.v[GAIN] = guard.gain
    n.v[MISSING] = guard.missing
    n.v[NMT] = sv.NMT[state]
    tell_drive(n, state)


@loop_inline
def watch_input(n: Any, state: Any) -> None:
    """Be the watchdog: hold the input, in FAULT ramp it to the safe value, after a reset back."""
    guard, safe = n.guard, n.guard.safe
    ramps = sv.DOES[state, sv.RAMPS] != 0
    rises = not ramps and guard.gain < 1.0 and guard.pace == 0.0
    for i in range(guard.n_safe):
        j = guard.safe_index[i]
        if not ramps and (not rises or guard.missing == 0):
            safe[i, sh.LAST] = n.v[j]
        if ramps or rises:
            n.v[j] = safe[i, sh.SAFE] + guard.gain * (safe[i, sh.LAST] - safe[i, sh.SAFE])


# --------------------------------------------------------------------------------------------- step


@loop_function
def step(n: Any, steps: Any) -> None:
    """Step the blocks for this cycle; after a stall the emulator's for the periods it owes."""
    owed = n.clock.behind if n.blocks.owe_periods != 0 else 0
    if n.faults.n_values > 0:
        spoil(n, PARAMETERS)
    for k in range(n.k - owed, n.k + 1):
        step_blocks(n, steps, k)
    note_changes(n)
    n.timing.stepped = now(n.clock)


@loop_inline
def step_blocks(n: Any, steps: Any, k: Any) -> None:
    """Step every block at time k T on its views of the table."""
    v, blocks, dt = n.v, n.blocks, n.clock.period_ns * 1e-9
    v[T_S] = k * dt
    for b in range(blocks.n):
        if b == (blocks.controller if v[FALLBACK] > 0.0 else blocks.fallback):
            continue
        copy_inputs(n, b)
        if n.faults.n_values > 0:
            spoil(n, b)
        at = blocks.views[b]
        n.control[sh.STEPPING] = b + 1
        p, x, u, y = part(v, at[0]), part(v, at[2]), part(v, at[4]), part(v, at[6])
        call(steps[b], v[T_S], dt, p, x, u, y)
        if n.faults.n_values > 0:
            spoil(n, OUTPUTS + b)
    n.control[sh.STEPPING] = 0


@loop_inline
def note_changes(n: Any) -> None:
    """Tell which of the rig's noted variables changed."""
    blocks = n.blocks
    for i in range(blocks.n_noted):
        value = n.v[blocks.noted_index[i]]
        if value != blocks.noted[i]:
            push_event(n, sh.CHANGE_EVENT, blocks.noted_index[i], value)
            blocks.noted[i] = value


# ---------------------------------------------------------------------------------- limit, transmit


@loop_function
def limit(n: Any) -> None:
    """Carry the outputs into what is sent; clamp them, limit their rate, ramp them to safe."""
    copy_inputs(n, sh.MAX_BLOCKS)
    if n.faults.n_values > 0:
        spoil(n, SENT)
    limit_commands(n)


@loop_function
def transmit(n: Any) -> None:
    """Send what is due: slow frames, frames of every cycle, SYNC last (the rows' order)."""
    tx = n.tx
    if n.faults.n_floods > 0:
        flood(n)
    for row in range(tx.n):
        every = tx.frames[row, dbc.EVERY_N]
        if tx.role[row, sh.IS_EMERGENCY] != 0:
            code = np.int64(n.v[ERROR_CODE])
            if code != tx.role[row, sh.TOLD] and n.guard.off == 0:
                tx.role[row, sh.TOLD] = code
                send_frame(n, row, 0)
        elif n.passes % every == 0:
            send_frame(n, row, n.passes // every + tx.role[row, sh.IS_SYNC])
    n.timing.sent = now(n.clock)


# ------------------------------------------------------------------------------------ publish, next


@loop_function
def publish(n: Any) -> None:
    """Publish the table and record the cycle; note when it was done."""
    timing.note(n)
    publish_table(n)
    push_record(n)
    n.control[sh.PASSES] = n.passes + 1
    n.control[sh.CYCLE] = n.k
    n.timing.done = now(n.clock)
    n.timing.publish_ns = n.timing.done - n.timing.sent
    if runs(n.clock):
        timing.count(n)


@loop_function
def next_cycle(n: Any) -> None:
    """Advance to the next cycle; tell how many periods were skipped."""
    next_period(n)
    if n.clock.behind > 0:
        push_event(n, sh.SKIP_EVENT, n.clock.behind, 0.0)


# ----------------------------------------------------------------------------------------- the loop


@loop_function
def one_pass(n: Any, steps: Any) -> Any:
    """Run one cycle; return False when the node is to stop."""
    set_time(n)
    wait(n)
    if stalled(n):
        stand_still(n)
        return n.k < n.guard.cycles or not settled(n.limits)
    own_up(n)
    receive(n)
    if refused(n):
        return False
    judge_overrun(n)
    supervise(n)
    if n.v[STATE] == sv.STOP or n.guard.faulted == sv.PEER_SILENT:
        return False
    tune(n)
    hear_requests(n)
    n.faults.stalled = 0
    step(n, steps)
    limit(n)
    transmit(n)
    publish(n)
    next_cycle(n)
    return n.k < n.guard.cycles or not settled(n.limits)


@loop_function
def finish(n: Any) -> None:
    """Send the last frames, with state STOP and a safe command, and mark the node as done.

    A node that was refused says nothing: its frames are those of another one.
    """
    guard = n.guard
    set_time(n)
    if n.v[STATE] != sv.STOP:
        push_event(n, sh.STATE_EVENT, sv.STOP, 0.0)
    n.v[STATE] = sv.STOP
    n.v[NMT] = sv.NMT[sv.STOP]
    guard.gain = 0.0
    tell_drive(n, sv.STOP)
    n.control[sh.STATE] = sv.STOP
    if refused(n):
        n.control[sh.FAULT] = guard.faulted
        meeting.greet(n)
    elif n.tx.last_word == sh.ALL_FRAMES:
        limit(n)
        transmit(n)
    else:
        announce(n)
    if guard.faulted != sv.NO_FAULT and n.control[sh.FAULT] == sv.NO_FAULT:  # in the last cycle
        n.control[sh.FAULT] = guard.faulted
        push_event(n, sh.FAULT_EVENT, guard.faulted, 0.0)
    publish_table(n)
    libc.store_release(n.control, sh.DONE, 1)


@loop_function
def pass_or_finish(n: Any, steps: Any) -> None:
    """Run one cycle of a node that has not ended, and its end when that comes."""
    if n.control[sh.DONE] == 0 and not one_pass(n, steps):
        finish(n)


@loop(i8(N, STEPS))
def run(n: Any, steps: Any) -> Any:
    """Run the node on its bus to the end; return the number of cycles done."""
    listen(n)
    if n.meeting.seeks_below != 0:
        if wait_for_peer(n):
            request_first_sample(n)
    elif n.meeting.ordered != 0 and not refused(n):
        announce(n)
    while not refused(n) and one_pass(n, steps):
        pass
    finish(n)
    return n.passes
