"""The clock of a node: what time it is, when a cycle begins, which periods are over.

    REAL       the machine's monotonic clock
    LOCKSTEP   the machine's too, for what is measured; frames and events are stamped with k T
    VIRTUAL    k T: no time passes while a cycle is worked on
    GIVEN      what somebody else sets: a replay, a test

What starts a cycle is the `trigger`: a CLOCKED node sleeps until an absolute deadline, once it has
met the other node (`arm_pass`); ON_FRAMES, and before, the frames awaited do.
"""

from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.executive.loop.layout import Clock, Loop


class Time(NumberedEnum):
    """What time it is, see above."""

    REAL, LOCKSTEP, VIRTUAL, GIVEN = range(4)


class Trigger(NumberedEnum):
    """What starts a cycle."""

    CLOCKED, ON_FRAMES = range(2)


@loop_inline
def runs(clock: Clock) -> bool:
    """Return True if time goes on by itself."""
    return clock.kind == Time.REAL or clock.kind == Time.LOCKSTEP


@loop_inline
def machine_ns(clock: Clock) -> int:
    """Return the time of this machine's monotonic clock, ns."""
    libc.clock_gettime(libc.CLOCK_MONOTONIC, libc.address(clock.timespec))
    return clock.timespec[0] * 1_000_000_000 + clock.timespec[1]


@loop_inline
def now(clock: Clock) -> int:
    """Return the time, ns."""
    return machine_ns(clock) if runs(clock) else clock.now_ns


@loop_inline
def stamp(clock: Clock) -> int:
    """Return what frames and events are stamped with, ns."""
    return clock.now_ns if clock.kind == Time.LOCKSTEP else now(clock)


@loop_inline
def stopping(n: Loop) -> bool:
    """Return True once the host asked this node to stop."""
    return libc.load_acquire(n.control, "stop") != 0


@loop_inline
def paced(n: Loop) -> bool:
    """Return True if this cycle begins at a deadline, not with frames."""
    return n.clock.trigger == Trigger.CLOCKED and n.passes > n.clock.arm_pass


@loop_inline
def set_time(n: Loop) -> None:
    """Let it be k T, where that is the time."""
    if n.clock.kind == Time.LOCKSTEP or n.clock.kind == Time.VIRTUAL:
        n.clock.now_ns = n.k * n.clock.period_ns


@loop_inline
def wait(n: Loop) -> None:
    """Sleep until this cycle's deadline, if it has one."""
    if paced(n):
        _sleep(n)


@loop_function
def start(n: Loop) -> None:
    """Begin a cycle whose frames are here; the clock runs from the arming pass on."""
    clock = n.clock
    if clock.trigger == Trigger.CLOCKED and n.passes == clock.arm_pass:
        arm(clock)
        _sleep(n)
    else:
        clock.deadline = clock.wake = now(clock)


@loop_function
def arm(clock: Clock) -> None:
    """Put the first deadline on the common grid of whole periods, plus this node's phase."""
    soonest = now(clock) + clock.period_ns // 8 - clock.phase_ns
    clock.deadline = (soonest // clock.period_ns + 1) * clock.period_ns + clock.phase_ns


@loop_function
def _sleep(n: Loop) -> None:
    """Sleep until the deadline (no other clock is waited for); note how late the wake-up was."""
    clock = n.clock
    clock.timespec[0] = clock.deadline // 1_000_000_000
    clock.timespec[1] = clock.deadline % 1_000_000_000
    until = libc.address(clock.timespec)
    monotonic, absolute = libc.CLOCK_MONOTONIC, libc.TIMER_ABSTIME
    if runs(clock):
        while libc.clock_nanosleep(monotonic, absolute, until, 0) == libc.EINTR and not stopping(n):
            pass
    clock.wake = now(clock)
    late = clock.wake - clock.deadline
    if late > clock.late_ns:
        n.control.late += 1
    n.control.wake_max_ns = max(n.control.wake_max_ns, late)


@loop_inline
def next_period(n: Loop) -> None:
    """Advance by one period, and by every period that is over already."""
    clock = n.clock
    n.passes += 1
    n.k += 1
    clock.deadline += clock.period_ns
    clock.behind = 0
    if paced(n) and n.timing.done > clock.deadline:
        clock.behind = (n.timing.done - clock.deadline) // clock.period_ns + 1
        n.k += clock.behind
        clock.deadline += clock.behind * clock.period_ns
        n.control.skipped += clock.behind
