"""What the loop counts about its own time: histograms, extremes, its latest cycles whole.

    stages     wake_late, receive, step, send, publish, work (all but the first), ns
    bucket     of `executive.loop.buckets`, eight to an octave: a percentile is known to 1/8, and
               never taken as less
    latest     the LATEST cycles that woke latest, each with all its stages and with what the kernel
               counted for this thread since the cycle before: page faults, context switches

Counting costs a system call and some hundred additions a cycle, after the cycle's work. Nothing is
counted in virtual time. `reset` starts anew.
"""

import numpy as np

from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import loop_function, loop_inline, loop_part
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.compiled.structures import words
from pcpc.executive.loop import buckets, control
from pcpc.executive.loop.buckets import OF_STAGES
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.rings import push_event
from pcpc.executive.loop.timing_layout import BUCKETS, LATEST, STAGES, USAGE, Stage
from pcpc.executive.loop.variables import (
    COUNTERS_AT,
    REFUSED,
    RESET,
    STATISTICS_AT,
    TIMING_AT,
    WALL,
)

UPDATE_PASSES = 128  # the table's percentiles are renewed this often
RUSAGE_THREAD = 1
SHOWN = np.array([Stage.WAKE_LATE, Stage.WORK])
POINTS = np.array([0.5, 0.99, 0.999])
_USAGE = np.array([*USAGE.values()])
place_of, end_of = loop_function(buckets.place_of), loop_function(buckets.end_of)
COUNTER_WORDS = np.array([control.place(word) for word, *_ in control.COUNTERS])


@loop_inline
def note(n: Loop) -> None:
    """Write the stage times and the counters of this cycle into the table."""
    v, clock, timing = n.v, n.clock, n.timing
    v[TIMING_AT + Stage.WAKE_LATE] = 0.001 * (clock.wake - clock.deadline)
    v[TIMING_AT + Stage.RECEIVE] = 0.001 * (timing.received - clock.wake)
    v[TIMING_AT + Stage.STEP] = 0.001 * (timing.stepped - timing.received)
    v[TIMING_AT + Stage.SEND] = 0.001 * (timing.sent - timing.stepped)
    v[TIMING_AT + Stage.PUBLISH] = 0.001 * timing.publish_ns
    counts = words(n.control)
    for i in range(COUNTER_WORDS.shape[0]):
        v[COUNTERS_AT + i] = counts[COUNTER_WORDS[i]]
    v[REFUSED] = n.control.refused
    v[WALL] = 1e-9 * (n.clock.wake + n.clock.wall_offset_ns)


@loop_function
def reset(n: Loop) -> None:
    """Forget all that was counted."""
    for s in range(STAGES):
        stage = n.stages[s]
        stage.count, stage.total, stage.least, stage.most = 0, 0, 2**62, 0
        for i in range(BUCKETS):
            n.histogram[s, i] = 0
    for row in range(LATEST):
        latest = words(n.latest[row])
        for i in range(len(latest)):
            latest[i] = 0


@loop_part
def count(n: Loop) -> None:
    """Count the cycle that has just been done; renew the table's statistics now and then."""
    if n.v[RESET] >= 0.5:
        n.v[RESET] = 0.0
        reset(n)
    clock, timing, times = n.clock, n.timing, n.timing.stage_ns
    times[Stage.WAKE_LATE] = clock.wake - clock.deadline
    times[Stage.RECEIVE] = timing.received - clock.wake
    times[Stage.STEP] = timing.stepped - timing.received
    times[Stage.SEND] = timing.sent - timing.stepped
    times[Stage.PUBLISH] = timing.done - timing.sent
    times[Stage.WORK] = timing.done - clock.wake
    for s in range(STAGES):
        t, stage = times[s], n.stages[s]
        stage.count += 1
        stage.total += t
        stage.least = min(stage.least, t)
        stage.most = max(stage.most, t)
        n.histogram[s, place_of(max(t, 0), *OF_STAGES)] += 1
    libc.getrusage(RUSAGE_THREAD, libc.address(timing.usage))
    _note_latest(n)
    for i in range(_USAGE.shape[0]):
        timing.usage_before[i] = timing.usage[_USAGE[i]]
    if n.passes % UPDATE_PASSES == 0:
        show(n)


@loop_function
def _note_latest(n: Loop) -> None:
    """Keep this cycle if it is among those that woke latest; the first is not comparable."""
    timing, late = n.timing, n.timing.stage_ns[Stage.WAKE_LATE]
    least = n.latest[0]
    for i in range(1, LATEST):
        if n.latest[i].stage_ns[Stage.WAKE_LATE] < least.stage_ns[Stage.WAKE_LATE]:
            least = n.latest[i]
    if late <= n.clock.late_ns or late <= least.stage_ns[Stage.WAKE_LATE]:
        return
    least.cycle = n.k
    for s in range(STAGES):
        least.stage_ns[s] = timing.stage_ns[s]
    for i in range(_USAGE.shape[0]):
        least.usage[i] = timing.usage[_USAGE[i]] - timing.usage_before[i]
    push_event(n, Event.LATE, late, 0.0)


@loop_function
def percentile(n: Loop, stage: int, share: float) -> int:
    """Return the end of the bucket below which `share` of the times lie, ns."""
    wanted, seen = share * n.stages[stage].count, int64(0)
    for i in range(BUCKETS):
        seen += n.histogram[stage, i]
        if seen >= wanted:
            return min(end_of(i, OF_STAGES[0]), n.stages[stage].most)
    return n.stages[stage].most


@loop_function
def show(n: Loop) -> None:
    """Write least, mean, most and percentiles of lateness and work to the table, us."""
    place = STATISTICS_AT
    for j in range(SHOWN.shape[0]):
        s = SHOWN[j]
        stage = n.stages[s]
        n.v[place] = 0.001 * stage.least
        n.v[place + 1] = 0.001 * stage.total / max(stage.count, int64(1))
        n.v[place + 2] = 0.001 * stage.most
        place += 3
        for k in range(POINTS.shape[0]):
            n.v[place] = 0.001 * percentile(n, s, POINTS[k])
            place += 1
