"""Received values that cannot be true: not taken, counted, and too many in a row a fault.

For each signal that its receiver limits, in each frame that the check of counter and CRC let
pass, with x the value that came, y the one taken last, and m the periods since then:

    no number  no finite number
    outside    not low <= x <= high
    too fast   |x - y| > rate_per_s T max(m, 1)
    still      x has been the same for more than still_cycles periods

Then y stays in the table (0 before the first). `fault_after` such values in a row are a fault.
Until each of its limited signals has been taken once, a frame is not the input that starts a node.
"""

from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.numbered import WordedEnum
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.limits import FINITE
from pcpc.executive.loop.rings import bits_of, push_event

EVENT_CYCLES = 100  # a signal is told at most this often


class Implausibility(WordedEnum):
    """What is wrong with a value."""

    GOOD = ""
    NO_NUMBER = "no finite number"
    OUTSIDE = "outside of its bounds"
    TOO_FAST = "too fast"
    STILL = "standing still"


WHYS = [why.says for why in Implausibility]


@loop_function
def take_plausible(n: Loop, row: int) -> bool:
    """Put back what of the frame just decoded is not plausible; return whether all is known."""
    these, known = n.plausible, True
    for i in range(these.n):
        if these.row[i] == row:
            j = these.place[i]
            x = n.v[j]
            why = judged(n, i, x)
            if why == Implausibility.GOOD:
                these.taken[i], these.taken_at[i], these.in_a_row[i] = x, n.k, 0
            else:
                n.v[j] = these.taken[i]
                note_implausible(n, i, x, why)
            known = known and these.taken_at[i] >= 0
    return known


@loop_function
def is_limited(n: Loop, row: int) -> bool:
    """Return whether a frame has limited signals."""
    limited = False
    for i in range(n.plausible.n):
        limited |= n.plausible.row[i] == row
    return limited


@loop_function
def take_again(n: Loop, row: int, back: bool) -> None:
    """Take the values in the table as those taken last, if a frame was taken back."""
    for i in range(n.plausible.n):
        if back and n.plausible.row[i] == row:
            n.plausible.taken[i] = n.v[n.plausible.place[i]]


@loop_function
def judged(n: Loop, i: int, x: float) -> int:
    """Return what is wrong with a value of limited signal `i`."""
    these, bounds = n.plausible, n.plausible.bounds[i]
    if x != these.came[i]:
        these.came[i], these.came_at[i] = x, n.k
    if not abs(x) < FINITE:
        return Implausibility.NO_NUMBER
    if x < bounds.low or x > bounds.high:
        return Implausibility.OUTSIDE
    periods = max(n.k - these.taken_at[i], 1)
    if these.taken_at[i] >= 0 and abs(x - these.taken[i]) > bounds.rate * periods:
        return Implausibility.TOO_FAST
    return (
        Implausibility.STILL
        if n.k - these.came_at[i] > these.still_cycles[i]
        else Implausibility.GOOD
    )


@loop_function
def note_implausible(n: Loop, i: int, x: float, why: int) -> None:
    """Count a value that was not taken, tell it, and be a fault in the end."""
    these, place = n.plausible, n.plausible.place[i]
    n.control.implausible += 1
    n.v[these.count_place[i]] += 1.0
    these.in_a_row[i] += 1
    if n.k >= these.told_until[i]:
        these.told_until[i] = n.k + EVENT_CYCLES
        push_event(n, Event.IMPLAUSIBLE, place, x)
    if these.in_a_row[i] >= these.fault_after[i] and n.guard.faulted == Fault.NONE:
        n.guard.faulted = Fault.NOT_PLAUSIBLE
        n.control.culprit = why
        n.control.odd_place, n.control.odd_cycle = place + 1, n.k
        n.control.odd_bits = bits_of(x)
