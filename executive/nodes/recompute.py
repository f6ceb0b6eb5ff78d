"""Recorded cycles done again by the compiled loop, from what the node took in them.

stand still    periods that a fault on purpose held the node: frames and tunings of each
take input     frames, tunings and clocks of the cycle, and whether its end was asked for
pass           the same cycle as that of the run
"""

from typing import Any, NamedTuple

from pcpc.drivers.can.wire_layout import STRANGER
from pcpc.drivers.compiled.jit import f8, i8, loop, loop_function, u1
from pcpc.drivers.compiled.kinds import tuple_with
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.compiled.structures import copy
from pcpc.drivers.line import error_frames
from pcpc.executive.loop.bus_state import note_bus_error
from pcpc.executive.loop.clock import paced
from pcpc.executive.loop.cycle import STEPS, N, one_pass
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.injection import any_on, count_down, peer_stalled
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.reception import take_one
from pcpc.executive.loop.rings import push_event
from pcpc.executive.loop.sending import request_first_sample
from pcpc.executive.loop.stalls import forget
from pcpc.executive.loop.states import State
from pcpc.executive.loop.supervisor import over
from pcpc.executive.loop.variables import STATE
from pcpc.executive.nodes.slices import HEAD, PASSES, STAMP, K

BUS_FAILED, FRAMES_END, TUNINGS_END, ENDS = range(HEAD, HEAD + 4)  # behind the columns of a Slice
COLUMNS = HEAD + 4


class Recording(NamedTuple):
    """What a node took in consecutive cycles, for the compiled loop.

    rows      cycle, passes, stamp ns, whether its bus failed, how many frames and tunings came up
              to it, whether a ramp to the end began: (cycles, 7)
    frames    as the bus brought them, in the cycles `heard`: (k, bytes); byte 6, of no use on a
              bus, says that one was foreign
    tuned     places of tunings, taken in the cycles `times`, and their `values`
    clocks    places, and in `clocked` (cycles, clocks) what was measured in the cycle before or
              written from outside
    done      how many of the frames and tunings were taken
    """

    rows: Any
    frames: Any
    heard: Any
    times: Any
    tuned: Any
    values: Any
    clocks: Any
    clocked: Any
    done: Any


_FRAMES, _TUNINGS = range(2)  # places in `done`
_RECORDING = tuple_with(
    i8[:, ::1], u1[:, ::1], i8[::1], i8[::1], i8[::1], f8[::1], i8[::1], f8[:, ::1], i8[::1]
)


@loop_function
def hear_next(n: Loop, recorded: Recording) -> None:
    """Take the next frame as the bus brought it; byte 6 says that it was foreign."""
    frame = recorded.frames[recorded.done[_FRAMES]]
    recorded.done[_FRAMES] += 1
    copy(n.wire.rx, frame)
    n.wire.source = STRANGER if frame[6] != 0 else 0
    n.wire.rx[6] = 0
    if frame[3] & error_frames.FLAG != 0:
        note_bus_error(n)
    else:
        take_one(n)


@loop_function
def tune_next(n: Loop, recorded: Recording) -> None:
    """Take the next tuning, and note it again."""
    row = recorded.done[_TUNINGS]
    recorded.done[_TUNINGS] += 1
    n.v[recorded.tuned[row]] = recorded.values[row]
    push_event(n, Event.TUNING, recorded.tuned[row], recorded.values[row])


@loop_function
def schedule_next(n: Loop, recorded: Recording) -> None:
    """Let the cycle take the next tuning where it does, behind what the supervisor writes."""
    row, place = recorded.done[_TUNINGS], n.tuning.n
    recorded.done[_TUNINGS] += 1
    n.tuning.schedule[place].cycle = recorded.times[row]
    n.tuning.schedule[place].place = recorded.tuned[row]
    n.tuning.value[place] = recorded.values[row]
    n.tuning.n += 1


@loop_function
def stand_still(n: Loop, recorded: Recording, i: int) -> int:
    """Begin the next cycle, behind those in which a fault held the node; return the first left."""
    row, done, k = recorded.rows[i], recorded.done, n.k
    stood_still = any_on(n, n.faults.own_stall, n.faults.n_own_stalls)
    behind = row[K] - k
    n.k = row[K]
    n.passes = row[PASSES]
    n.clock.now_ns = n.clock.deadline = row[STAMP]
    n.wire.outbox_put = 0
    if n.passes == 0 and n.meeting.seeks_below != 0:
        request_first_sample(n)
    n.clock.behind = 0  # as long as a fault holds it
    while stood_still and k < row[K]:
        n.k, n.clock.now_ns = k, row[STAMP] - (row[K] - k) * n.clock.period_ns
        while done[_FRAMES] < row[FRAMES_END] and recorded.heard[done[_FRAMES]] <= k:
            hear_next(n, recorded)
        if not paced(n):
            forget(n)
        count_down(n, 1)
        while done[_TUNINGS] < row[TUNINGS_END] and recorded.times[done[_TUNINGS]] <= k:
            tune_next(n, recorded)
        k += 1
    n.k, n.clock.now_ns, n.clock.behind = row[K], row[STAMP], behind
    if behind > 0:
        push_event(n, Event.SKIP, behind, 0.0)
    return k


@loop_function
def take_input(n: Loop, recorded: Recording, i: int, k: int) -> None:
    """Take what came up to a cycle, of which the periods from `k` on have not passed yet."""
    row, done = recorded.rows[i], recorded.done
    while done[_FRAMES] < row[FRAMES_END]:
        hear_next(n, recorded)
    n.faults.peer_stood = int64(peer_stalled(n))
    n.rx.started += n.rx.starters * n.faults.peer_stood
    n.tuning.n = n.tuning.done = 0
    while done[_TUNINGS] < row[TUNINGS_END]:
        time = recorded.times[done[_TUNINGS]]
        periods = max(time + 1 - k, 0)
        count_down(n, periods)
        k += periods
        if time < row[K] or n.tuning.n == len(n.tuning.schedule):
            tune_next(n, recorded)
        else:
            schedule_next(n, recorded)
    count_down(n, row[K] + 1 - k)
    for j in range(recorded.clocks.shape[0]):
        n.v[recorded.clocks[j]] = recorded.clocked[i, j]
    if row[BUS_FAILED] != 0:
        n.guard.faulted = Fault.BUS_FAILED
    waits = n.guard.disarmed != 0 and n.v[STATE] == State.READY  # else its end was asked for
    if row[ENDS] != 0 and not (waits or over(n)):  # which a host's request explains alone
        n.control.stop = 1


@loop(i8(N, STEPS, _RECORDING))
def recompute(n: Loop, steps: Any, recording: Any) -> Any:
    """Run the cycles of a Recording; return how many were done before the node stopped of itself.

    Periods that the node stood still on purpose are over before the next frames; those of the
    machine pass behind them. The last cycle's frames stay in the outbox.
    """
    recorded = Recording(*recording)
    for i in range(recorded.rows.shape[0]):
        k = stand_still(n, recorded, i)
        take_input(n, recorded, i, k)
        one_pass(n, steps)
        if n.passes == recorded.rows[i, PASSES]:
            return i
    return recorded.rows.shape[0]
