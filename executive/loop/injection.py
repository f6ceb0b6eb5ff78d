"""Faults on purpose: which are on, and whether one acts now. What they do: see `injected_*`.

Each fault of the rig has four variables, side by side in the table of the node where it acts:

    fault.NAME.left    cycles for which it still is on; the rig's timeline and clients set it
    fault.NAME.value   how large it is, in the unit of what it disturbs
    fault.NAME.share   of all chances, in how many it acts
    fault.NAME.burst   how many in a row, on average

So a fault begins by a tuning, which the log holds and a replay takes from it. Whether it acts is
drawn from a generator of its own (two states, as in `executive.loop.losses`), so that the same rig
and seed give the same faults whatever the pacing and the bus.
"""

from pcpc.drivers.compiled.jit import loop_function, loop_inline
from pcpc.drivers.compiled.records import Cells
from pcpc.executive.loop.draws import FACTOR, PRIME
from pcpc.executive.loop.layout import Loop

LEFT, VALUE, SHARE, BURST = range(4)  # places from that of `fault.NAME.left` on
FOR_EVER = 1e15  # cycles


@loop_inline
def is_on(n: Loop, f: int) -> bool:
    """Return whether fault `f` is on."""
    return n.v[n.faults.place[f] + LEFT] > 0.0


@loop_inline
def size(n: Loop, f: int) -> float:
    """Return how large fault `f` is."""
    return n.v[n.faults.place[f] + VALUE]


@loop_function
def uniform(n: Loop, f: int) -> float:
    """Draw a number between 0 and 1 from the generator of fault `f`."""
    s = n.faults.seed[f] * FACTOR % PRIME
    n.faults.seed[f] = s
    return s / PRIME


@loop_function
def acts(n: Loop, f: int) -> int:
    """Draw whether fault `f`, which is on, acts this time: always, singly, or in bursts."""
    place = n.faults.place[f]
    share = n.v[place + SHARE]
    if share >= 1.0:
        return True
    leave = 1.0 / n.v[place + BURST]
    turn = leave if n.faults.acting[f] != 0 else min(leave * share / (1.0 - share), 1.0)
    if uniform(n, f) < turn:
        n.faults.acting[f] = 1 - n.faults.acting[f]
    return n.faults.acting[f] != 0


@loop_function
def count_down(n: Loop, periods: int) -> None:
    """Let periods pass for all faults that are on."""
    for i in range(n.faults.n_places):
        at = n.faults.every_place[i]
        n.v[at] = max(n.v[at] - periods, 0.0)


@loop_function
def any_on(n: Loop, places: Cells[int], count: int) -> bool:
    """Return whether one of `count` faults, by the places of `left`, is on."""
    on = False
    for i in range(count):
        on |= n.v[places[i]] > 0.0
    return on


@loop_inline
def peer_stalled(n: Loop) -> bool:
    """Return whether the other node stands still now, so that nobody waits for it."""
    return any_on(n, n.faults.peer_stall, n.faults.n_peer_stalls)
