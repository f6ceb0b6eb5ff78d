"""A node that stands still on purpose: its periods pass, nothing of a cycle is done.

On a clock the bus keeps what comes meanwhile; without one it is taken frame by frame, so that the
other node, which does not wait, and this one stay in step. Afterwards the node has skipped the
periods, as after a stall of the machine.
"""

from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.executive.loop.clock import Time, paced, stopping
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.injection import any_on
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.reception import receive
from pcpc.executive.loop.rings import push_event
from pcpc.executive.loop.tuning import tune


@loop_inline
def stalled(n: Loop) -> bool:
    """Return whether this node stands still now; in a replay the record says when it did.

    One that is to end goes on: its commands have to become safe.
    """
    if n.faults.n_own_stalls == 0 or n.clock.kind == Time.GIVEN:
        return False
    if n.k >= n.guard.cycles or stopping(n):
        return False
    return any_on(n, n.faults.own_stall, n.faults.n_own_stalls)


@loop_function
def pass_stalled_period(n: Loop) -> None:
    """Let a period pass in a stall on purpose: what comes is not worked on, nothing is sent."""
    if not paced(n):
        receive(n)
        forget(n)
    stalled, n.faults.stalled = n.faults.stalled, 0
    tune(n)
    n.faults.stalled = stalled + 1 + n.clock.behind
    n.clock.behind = 0
    n.k += 1
    n.clock.deadline += n.clock.period_ns
    n.control.skipped += 1


@loop_inline
def forget(n: Loop) -> None:
    """Take nothing that came in this period for new in the next."""
    n.rx.started = n.rx.fresh = 0
    for row in range(n.rx.n):
        n.rx.state[row].fresh = n.faults.on_wire[row].fresh = 0


@loop_inline
def skip_stalled_periods(n: Loop) -> None:
    """After a stall on purpose, have skipped its periods."""
    if n.faults.stalled > 0:
        n.clock.behind = n.faults.stalled
        push_event(n, Event.SKIP, n.faults.stalled, 0.0)
