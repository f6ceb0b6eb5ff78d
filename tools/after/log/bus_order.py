"""The order of frames in a recording, which is the order of the bus, against that of their stamps.

    one id behind the other, or     each in order by itself: merged by their stamps
    one channel
    a few frames out of place       sorted by their stamps
    a clock that was set back       the order of the file stays; all that follows is shifted, so
                                    that it comes a usual distance behind the frame before

A clock was set back if more than `_FEW` frames pass until the stamps are again where they were, or
they never get there.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]  # (n,)
_FEW = 8  # frames
_LATEST_NS = 2**62 - 2**60  # with the span of what follows it fits an int64
_FALLING = 0.05  # of the pairs of stamps: they are distances


@dataclass(frozen=True)
class ClockStep:
    """A place where the stamps go back: `frame`, counted from 1, by how much, shifted by what."""

    frame: int
    back_ns: int
    shift_ns: int


@dataclass(frozen=True)
class BusOrder:
    """`stamp_ns` (n,) in the order of the file; `order` (n,) sorts what was out of place."""

    stamp_ns: Ints
    order: Ints
    moved: int  # frames stamped before one ahead of them
    steps: list[ClockStep]


def bus_order(stamp_ns: Ints, source: Ints) -> BusOrder:
    """Return stamps that never fall in the order that is returned with them; both (n,).

    `source` is a number for each channel and id.
    """
    steps: list[ClockStep] = []
    if not _each_in_order(stamp_ns, source):
        stamp_ns, steps = _without_steps(stamp_ns)
    order = np.argsort(stamp_ns, kind="stable")
    highest = np.maximum.accumulate(stamp_ns)
    return BusOrder(stamp_ns, order, int((stamp_ns < highest).sum()), steps)


def are_distances(stamp_ns: Ints) -> bool:
    """Return whether stamps that begin at 0 are each counted from the one before; (n,)."""
    gaps = np.diff(stamp_ns)
    if len(gaps) < 2 or stamp_ns[0]:
        return False
    return bool((gaps < 0).mean() >= _FALLING or (not gaps[1:].any() and gaps[0] > 0))


def _each_in_order(stamp_ns: Ints, source: Ints) -> bool:
    """Return whether the stamps of no source fall."""
    by_source = np.argsort(source, kind="stable")
    same = np.diff(source[by_source]) == 0
    return not (np.diff(stamp_ns[by_source])[same] < 0).any()


def _without_steps(stamp_ns: Ints) -> tuple[Ints, list[ClockStep]]:
    """Return the stamps shifted where the clock was set back, and those places."""
    gaps = np.diff(stamp_ns)
    rising = gaps[gaps > 0]
    usual_ns = int(np.median(rising)) if len(rising) else 0
    shift_ns, steps = np.zeros(len(stamp_ns), np.int64), list[ClockStep]()
    highest, seen = int(stamp_ns[0]), 0  # of the stamps as recorded since the last step
    for place in (np.flatnonzero(gaps < 0) + 1).tolist():
        highest, seen = max(highest, int(stamp_ns[seen:place].max())), place
        at_ns = int(stamp_ns[place])
        if at_ns >= highest or (stamp_ns[place : place + _FEW + 1] >= highest).any():
            continue
        early = stamp_ns[max(0, place - _FEW - 1) : place] <= at_ns
        if early.any():  # the few frames since then are ahead of their time
            highest = at_ns
            continue
        before = steps[-1].shift_ns if steps else 0
        shift_ns[place] = highest + usual_ns - at_ns
        steps.append(ClockStep(place + 1, int(-gaps[place - 1]), before + int(shift_ns[place])))
        highest = at_ns
        if steps[-1].shift_ns + highest > _LATEST_NS:  # stamps that make no sense
            return stamp_ns, []
    return stamp_ns + np.cumsum(shift_ns), steps
