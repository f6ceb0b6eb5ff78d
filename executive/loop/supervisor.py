"""The supervisor of a node: counts what is missing, advances its state, sets the pace of ramps.

The states and the table between them stand in `executive.loop.states`, the faults in
`executive.loop.faults`. What they mean for what is sent: `executive.loop.limits`.

A run is over when its duration is, when the host asks, or when a frame of the node above says STOP.
While a command with a rate limit is then farther from its safe value than one cycle may move it,
the node goes on in its state (so that its peer still takes the command), `supervisor.gain` falls
from 1 as in FAULT, no missing input is a fault, and STOP comes with the frame that is safe. A ramp
is as fast as `supervisor.ramp_s` says, or as slow as the slowest command's rate limit.

FAULT is latched. Its ramp ends in STOP, or, where the rig says `on_fault: wait`, it lasts until a
reset that was asked for: in a cycle with valid input, commands safe, and no detector having seen a
fault since the cycle before. The laws went on all the while and keep their states; `gain` rises
from 0 to 1 as fast as it fell, so that commands begin where they are.

An executive that is disarmed, by its operator or from its start (`arm: manual`, where a fault
disarms, too), is in READY at most: commands go the way of FAULT to their safe values and stay
there, without a fault. Time, references and laws go on, with the measured feedback. Armed, it is in
RUN with the next complete input, and `gain` rises as after a reset.
"""

from pcpc.drivers.can import e2e
from pcpc.drivers.compiled.jit import loop_function, loop_inline, loop_part
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import int64
from pcpc.executive.loop import on_wire
from pcpc.executive.loop.clock import Trigger, stopping
from pcpc.executive.loop.drive import tell_drive
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.limits import Quick, begin_ramp, quick_stop, settled
from pcpc.executive.loop.rings import push_event
from pcpc.executive.loop.states import EXPECTS, HEARTBEATS, RAMPS, RUNS, SENDS, State, next_state
from pcpc.executive.loop.variables import (
    DISARMED,
    FALLBACK,
    FAULT,
    GAIN,
    MISSING,
    NMT,
    RESET_ASKED,
    STATE,
    STOP_ASKED,
)


class Overrun(NumberedEnum):
    """What follows from cycles that ran past their end."""

    SKIP, FAULT_AFTER, FALL_BACK = range(3)


@loop_function
def judge_overrun(n: Loop) -> None:
    """Count cycles in a row that ran past their end; do what the rig says about too many."""
    guard, behind = n.guard, n.clock.behind
    guard.overruns = guard.overruns + 1 if behind > 0 and n.passes > guard.grace_passes else 0
    if guard.overrun_policy == Overrun.SKIP or guard.overruns < guard.overrun_after:
        return
    if guard.overrun_policy == Overrun.FAULT_AFTER:
        if guard.faulted == Fault.NONE:
            guard.faulted = Fault.OVERRUN
    elif n.v[FALLBACK] == 0.0:
        n.v[FALLBACK] = 1.0
        push_event(n, Event.FALLBACK, behind, 0.0)


@loop_function
def over(n: Loop) -> bool:
    """Return True once the run is over, by its duration, its host or the node above."""
    guard = n.guard
    told = guard.mode_index >= 0 and n.v[guard.mode_index] == State.STOP
    return n.k >= guard.cycles or stopping(n) or told or guard.stop != 0


@loop_inline
def count_missing(n: Loop, running: int) -> None:
    """Count cycles without complete valid input; turn to the input of the next one."""
    guard, rx = n.guard, n.rx
    if rx.fresh >= rx.awaited:
        guard.missing = n.faults.missed = 0
    else:
        guard.missing += 1
        n.faults.missed = 0 if on_wire.taken_on_purpose(n) else n.faults.missed + 1
        n.control.held += running
        n.control.stale += running if guard.missing > guard.hold_cycles else 0
        n.control.starved += running if n.faults.missed > guard.hold_cycles else 0
    rx.started = 0
    rx.fresh = 0
    n.wire.muted = 0
    e2e.begin_cycle(rx.state, rx.n)
    on_wire.age_frames(n)


@loop_part
def supervise(n: Loop) -> None:
    """Advance the state machine by what is missing; ramp the gain in FAULT and at the end."""
    guard, before, end_asked = n.guard, int64(n.v[STATE]), over(n)
    count_missing(n, RUNS[before])
    silent = EXPECTS[before] != 0 and guard.missing >= guard.fault_after
    if silent and guard.faulted == Fault.NONE and not end_asked:
        guard.faulted = Fault.INPUT_MISSING
    watch_estop(n)
    safe = settled(n.limits)
    listens = n.clock.trigger == Trigger.CLOCKED or not silent  # the node above, to what is sent
    leave = end_asked and (safe or not listens)
    fresh, ramped = guard.missing == 0, guard.gain <= 0.0 and safe
    if guard.reset != 0:
        judge_reset(n, fresh and ramped)
    disarmed = guard.disarmed != 0
    state = next_state(before, fresh, guard.faulted, leave, ramped and guard.waits == 0, disarmed)
    waits = disarmed and state == State.READY
    ramps = RAMPS[state] != 0 or end_asked or waits
    if before == State.READY and not ramps:
        guard.pace = 0.0
    if ramps and (guard.pace == 0.0 or guard.quick == Quick.ASKED):
        begin_ramp(n, end_asked)
    if RAMPS[before] != 0 or (end_asked and not leave) or (waits and before == state):
        guard.gain = max(guard.gain - guard.pace, 0.0)
    elif not ramps and SENDS[state] != 0:
        guard.gain = min(guard.gain + guard.ramp_step, 1.0)
    enter(n, before, state)
    watch_input(n, state)


@loop_inline
def watch_estop(n: Loop) -> None:
    """Let an emergency stop be a fault, whatever else is wrong, and the ramp a quick stop."""
    guard = n.guard
    if guard.estop_index >= 0 and n.v[guard.estop_index] != 0.0:
        quick_stop(n, Fault.EMERGENCY_STOP)


@loop_function
def hear_requests(n: Loop) -> None:
    """Note what was asked of the supervisor, for its next cycle; a request is heard once.

    Being disarmed is no request: it lasts.

    A reset forgets the fault, so that a detector that still sees one tells it until then.
    """
    guard, safe = n.guard, n.guard.gain <= 0.0 and settled(n.limits)
    guard.disarmed = int64(n.v[DISARMED] != 0.0)
    if n.v[RESET_ASKED] != 0.0:
        n.v[RESET_ASKED] = 0.0
        if n.v[STATE] == State.FAULT and guard.waits != 0 and safe:
            guard.reset, guard.faulted, guard.quick = 1, Fault.NONE, Quick.NONE
    if n.v[STOP_ASKED] != 0.0:
        guard.stop = 1
        if n.v[STOP_ASKED] > 1.0 and guard.quick == Quick.NONE:
            guard.quick = Quick.ASKED


@loop_inline
def judge_reset(n: Loop, possible: bool) -> None:
    """Leave no fault, if that is possible and none was seen since; else tell which one is there."""
    guard = n.guard
    guard.reset = 0
    if guard.faulted == Fault.NONE and possible:
        guard.pace = 0.0
        return
    if guard.faulted == Fault.NONE:
        guard.faulted = n.control.fault
    n.control.fault = guard.faulted
    push_event(n, Event.FAULT, guard.faulted, 0.0)


@loop_inline
def enter(n: Loop, before: int, state: int) -> None:
    """Tell the state, and the fault with which it was entered."""
    guard = n.guard
    if state != before:
        push_event(n, Event.STATE, state, 0.0)
        if state == State.FAULT:
            n.control.fault = guard.faulted
            push_event(n, Event.FAULT, guard.faulted, 0.0)
            if guard.manual != 0:
                n.v[DISARMED] = 1.0
    n.control.state = state
    n.v[STATE] = state
    n.v[FAULT] = guard.faulted
    n.v[GAIN] = guard.gain
    n.v[MISSING] = guard.missing
    n.v[NMT] = HEARTBEATS[state]
    tell_drive(n, state)


@loop_inline
def watch_input(n: Loop, state: int) -> None:
    """Be the watchdog: hold the input, in FAULT ramp it to the safe value, after a reset back."""
    guard, safe = n.guard, n.guard.safe
    ramps = RAMPS[state] != 0
    rises = not ramps and guard.gain < 1.0 and guard.pace == 0.0
    for i in range(guard.n_safe):
        j = guard.safe_index[i]
        if not ramps and (not rises or guard.missing == 0):
            safe[i].last = n.v[j]
        if ramps or rises:
            n.v[j] = safe[i].safe + guard.gain * (safe[i].last - safe[i].safe)
