"""The loop. One compiled cycle for executive and emulator; only what starts a cycle differs.

    wait       until an absolute deadline (pacing real and sync), or not at all
    receive    drain the bus: check counter and CRC, decode; or block until the frames are here
    supervise  the state machine and its ramp
    overrun    after a cycle that ran past its end: go on, fault, or fall back
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
from pcpc.drivers.jit import i8, loop, loop_function, types
from pcpc.drivers.stage import ENTRY, call, part
from pcpc.drivers.structures import structure
from pcpc.drivers.wire import BUS_ERROR, FAILED, FRAME, NOTHING, get_frame
from pcpc.drivers.wire_layout import MEMORY
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import supervisor as sv
from pcpc.executive.loop import timing
from pcpc.executive.loop.limits import begin_ramp, limit_commands, settled
from pcpc.executive.loop.reception import take_frame
from pcpc.executive.loop.rings import now, publish, push_event, push_record, stopping
from pcpc.executive.loop.sending import (
    announce,
    announce_again,
    copy_inputs,
    request_first_sample,
    send_frame,
)
from pcpc.executive.loop.strangers import listen, refused
from pcpc.executive.loop.tuning import tune
from pcpc.executive.loop.variables import FALLBACK, FAULT, GAIN, MISSING, NMT, STATE, T_S

CLOCKED, ON_FRAMES = 0, 1
DRAIN_FRAMES = 1024  # at most this many in one pass

N = structure(sh.LOOP)
STEPS = types.UniTuple(ENTRY, sh.MAX_BLOCKS)


# --------------------------------------------------------------------------------------------- wait


@loop_function
def wait(n: Any) -> None:
    """Sleep until the deadline (virtual time is there); note how late the wake-up was."""
    n.timespec[0] = n.deadline // 1_000_000_000
    n.timespec[1] = n.deadline % 1_000_000_000
    until = libc.address(n.timespec)
    monotonic, absolute = libc.CLOCK_MONOTONIC, libc.TIMER_ABSTIME
    if n.wire.kind != MEMORY:
        while libc.clock_nanosleep(monotonic, absolute, until, 0) == libc.EINTR and not stopping(n):
            pass
    n.wake = now(n)
    late = n.wake - n.deadline
    if late > n.late_ns:
        n.control[sh.LATE] += 1
    n.control[sh.WAKE_MAX_NS] = max(n.control[sh.WAKE_MAX_NS], late)


@loop_function
def arm(n: Any) -> None:
    """Put the first deadline on the common grid of whole periods, plus this node's phase."""
    soonest = now(n) + n.period_ns // 8 - n.phase_ns
    n.deadline = (soonest // n.period_ns + 1) * n.period_ns + n.phase_ns


@loop_function
def next_cycle(n: Any) -> None:
    """Advance by one period, and by every period that is over already."""
    n.passes += 1
    n.k += 1
    n.deadline += n.period_ns
    n.behind = 0
    if n.trigger == CLOCKED and n.passes > n.arm_pass and n.done > n.deadline:
        n.behind = (n.done - n.deadline) // n.period_ns + 1
        n.k += n.behind
        n.deadline += n.behind * n.period_ns
        n.control[sh.SKIPPED] += n.behind
        push_event(n, sh.SKIP_EVENT, n.behind, 0.0)


# ------------------------------------------------------------------------------------------ receive


@loop_function
def patience(n: Any) -> Any:
    """Return how many time-outs are silence: more while the recorder lags."""
    lags = n.record_ends[sh.PUT] != libc.load_acquire(n.record_taken, 0)
    waits = n.wait_recorder != 0 and n.control[sh.RECORDED] != 0 and lags
    return n.patience * (sh.RECORDER_PATIENCE if waits else 1)


@loop_function
def receive(n: Any) -> None:
    """Drain what is there; before the clock runs, and in lockstep, block until all is here.

    What is waited for has no limit of frames: those of others may come before it.
    """
    gather = n.trigger != CLOCKED or n.passes <= n.arm_pass
    waits = 0
    drained = 0
    while drained < DRAIN_FRAMES:
        if gather and n.started >= n.n_starters:
            break
        result = get_frame(n.wire, gather)
        if not gather or stopping(n):
            drained += 1
        if result == FRAME:
            take_frame(n)
            waits = 0
            if refused(n):
                break
        elif result == NOTHING:
            if not gather or stopping(n):
                break
            waits += 1
            if n.passes == 0 and n.wire.kind != MEMORY:
                announce_again(n)
                waits = 0
            elif waits >= patience(n) or n.wire.kind == MEMORY:
                n.faulted = sv.PEER_SILENT
                break
        elif result == FAILED:
            n.control[sh.BUS_ERRNO] = n.wire.errno
            n.faulted = sv.BUS_FAILED
            break
        elif result == BUS_ERROR:
            n.control[sh.BUS_ERRORS] += 1
    n.received = now(n)


# ---------------------------------------------------------------------------------------- supervise


@loop_function
def over(n: Any) -> Any:
    """Return True once the run is over, by its duration, its host or the node above."""
    told = n.mode_index >= 0 and n.v[n.mode_index] == sv.STOP
    return n.k >= n.cycles or stopping(n) or told


@loop_function
def supervise(n: Any) -> None:
    """Count missing input, advance the state machine, ramp the gain in FAULT and at the end."""
    before = np.int64(n.v[STATE])
    asked = over(n)
    running = before == sv.RUN or before == sv.HOLD
    if n.fresh >= n.n_awaited:
        n.missing = 0
    else:
        n.missing += 1
        n.control[sh.HELD] += running
        n.control[sh.STALE] += running and n.missing > n.hold_cycles
    n.started = 0
    n.fresh = 0
    n.wire.muted = 0
    e2e.begin_cycle(n.rx_state, n.n_rx)
    silent = before != sv.INIT and n.missing >= n.fault_after
    if silent and n.faulted == sv.NO_FAULT and not asked:
        n.faulted = sv.INPUT_MISSING
    safe = settled(n)
    leave = asked and (safe or (silent and n.trigger != CLOCKED))  # nobody listens any more
    state = sv.advance(before, n.missing == 0, n.faulted, leave, n.gain <= 0.0 and safe)
    if n.pace == 0.0 and (state == sv.FAULT or asked):
        begin_ramp(n, asked)
    if before == sv.FAULT or (asked and not leave):
        n.gain = max(n.gain - n.pace, 0.0)
    if state != before:
        push_event(n, sh.STATE_EVENT, state, 0.0)
        if state == sv.FAULT:
            n.control[sh.FAULT] = n.faulted
            push_event(n, sh.FAULT_EVENT, n.faulted, 0.0)
    n.control[sh.STATE] = state
    n.v[STATE] = state
    n.v[FAULT] = n.faulted
    n.v[GAIN] = n.gain
    n.v[MISSING] = n.missing
    n.v[NMT] = sv.NMT[state]
    for i in range(n.n_safe):  # the watchdog: hold, then ramp from the held value to the safe one
        j = n.safe_index[i]
        if state < sv.FAULT:
            n.safe[i, sh.LAST] = n.v[j]
        else:
            n.v[j] = n.safe[i, sh.SAFE] + n.gain * (n.safe[i, sh.LAST] - n.safe[i, sh.SAFE])


@loop_function
def judge_overrun(n: Any) -> None:
    """Count cycles in a row that ran past their end; do what the rig says about too many."""
    n.overruns = n.overruns + 1 if n.behind > 0 and n.passes > n.grace_passes else 0
    if n.overrun_policy == sh.SKIP or n.overruns < n.overrun_after:
        return
    if n.overrun_policy == sh.FAULT_AFTER:
        if n.faulted == sv.NO_FAULT:
            n.faulted = sv.OVERRUN
    elif n.v[FALLBACK] == 0.0:
        n.v[FALLBACK] = 1.0
        push_event(n, sh.FALLBACK_EVENT, n.behind, 0.0)


# --------------------------------------------------------------------------------------------- step


@loop_function
def step_blocks(n: Any, steps: Any) -> None:
    """Step every block at time k T; after a stall the emulator makes up the owed periods."""
    dt = n.period_ns * 1e-9
    owed = n.behind if n.is_plant != 0 else 0
    v = n.v
    for k in range(n.k - owed, n.k + 1):
        v[T_S] = k * dt
        for b in range(n.n_blocks):
            if b == (n.controller_block if v[FALLBACK] > 0.0 else n.fallback_block):
                continue
            copy_inputs(n, b)
            at = n.views[b]
            n.control[sh.STEPPING] = b + 1
            p, x, u, y = part(v, at[0]), part(v, at[2]), part(v, at[4]), part(v, at[6])
            call(steps[b], v[T_S], dt, p, x, u, y)
    n.control[sh.STEPPING] = 0
    for i in range(n.n_noted):
        value = v[n.noted_index[i]]
        if value != n.noted[i]:
            push_event(n, sh.CHANGE_EVENT, n.noted_index[i], value)
            n.noted[i] = value
    n.stepped = now(n)


@loop_function
def limit(n: Any) -> None:
    """Carry the outputs into what is sent; clamp them, limit their rate, ramp them to safe."""
    copy_inputs(n, sh.MAX_BLOCKS)
    limit_commands(n)


# ----------------------------------------------------------------------------------------- transmit


@loop_function
def transmit(n: Any) -> None:
    """Send what is due: slow frames, frames of every cycle, SYNC last (the rows' order)."""
    for row in range(n.n_tx):
        every = n.tx[row, dbc.EVERY_N]
        if n.passes % every == 0:
            send_frame(n, row, n.passes // every + n.tx_role[row, sh.IS_SYNC])
    n.sent = now(n)


# ----------------------------------------------------------------------------------------- the loop


@loop_function
def one_pass(n: Any, steps: Any) -> Any:
    """Run one cycle; return False when the node is to stop."""
    if n.virtual_time != 0:
        n.virtual_now = n.k * n.period_ns
    if n.trigger == CLOCKED and n.passes > n.arm_pass:
        wait(n)
        receive(n)
    else:
        receive(n)
        if refused(n):
            return False
        if n.trigger == CLOCKED and n.passes == n.arm_pass:
            arm(n)
            wait(n)
        else:
            n.deadline = n.wake = n.received
        n.received = n.wake
    judge_overrun(n)
    supervise(n)
    if n.v[STATE] == sv.STOP or n.faulted == sv.PEER_SILENT:
        return False
    tune(n)
    step_blocks(n, steps)
    limit(n)
    transmit(n)
    timing.note(n)
    publish(n)
    push_record(n)
    n.control[sh.PASSES] = n.passes + 1
    n.control[sh.CYCLE] = n.k
    n.done = now(n)
    n.publish_ns = n.done - n.sent
    if n.wire.kind != MEMORY:
        timing.count(n)
    next_cycle(n)
    return n.k < n.cycles or not settled(n)


@loop_function
def finish(n: Any) -> None:
    """Send the last frames, with state STOP and a safe command, and mark the node as done.

    A node that was refused says nothing: its frames are those of another one.
    """
    if n.virtual_time != 0:
        n.virtual_now = n.k * n.period_ns
    if n.v[STATE] != sv.STOP:
        push_event(n, sh.STATE_EVENT, sv.STOP, 0.0)
    n.v[STATE] = sv.STOP
    n.v[NMT] = sv.NMT[sv.STOP]
    n.gain = 0.0
    n.control[sh.STATE] = sv.STOP
    if refused(n):
        n.control[sh.FAULT] = n.faulted
    elif n.is_plant == 0:
        limit(n)
        transmit(n)
    else:
        announce(n)
    if n.faulted != sv.NO_FAULT and n.control[sh.FAULT] == sv.NO_FAULT:  # in the last cycle
        n.control[sh.FAULT] = n.faulted
        push_event(n, sh.FAULT_EVENT, n.faulted, 0.0)
    publish(n)
    libc.store_release(n.control, sh.DONE, 1)


@loop_function
def pass_or_finish(n: Any, steps: Any) -> None:
    """Run one cycle of a node that has not ended, and its end when that comes."""
    if n.control[sh.DONE] == 0 and not one_pass(n, steps):
        finish(n)


@loop_function
def wait_for_peer(n: Any) -> Any:
    """Block until the node below is heard, and answer; return False when the host stops us.

    Without a clock a local node turns to the node above only then.
    """
    n.wire.muted = n.virtual_time
    while not stopping(n) and n.faulted == sv.NO_FAULT:
        result = get_frame(n.wire, True)
        if result == FRAME:
            row = take_frame(n)
            if row >= 0 and n.rx_role[row, sh.PEER] != 0:
                n.wire.muted = 0
                announce(n)
                return True
        if result == NOTHING and (n.virtual_time == 0 or n.wire.n_second == 0):
            announce_again(n)
        if result == FAILED:
            n.control[sh.BUS_ERRNO] = n.wire.errno
            n.faulted = sv.BUS_FAILED
            return False
    return False


@loop(i8(N, STEPS))
def run(n: Any, steps: Any) -> Any:
    """Run the node on its bus to the end; return the number of cycles done."""
    listen(n)
    if n.is_plant != 0 and n.virtual_time != 0 and not refused(n):
        announce(n)
    if n.is_plant == 0 and wait_for_peer(n):
        request_first_sample(n)
    while not refused(n) and one_pass(n, steps):
        pass
    finish(n)
    return n.passes
