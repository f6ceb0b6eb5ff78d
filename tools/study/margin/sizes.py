"""The size of a multisine at which a loop answers as a linear one: half of it gives the same.

The margins of a rig that is not linear are those of its answer to what is small: of the limit of L
as the amplitude a goes to 0. Near it L moves by a power of a, of which a/2 leaves half at most.
Hence sizes down to where noise or quanta hide the lines, of which the one with the least error
counts, then a second measurement with a/2, and the numbers of both: where they differ, a/2 takes
the place of a. Numbers that still differ are not measured: so are many of play and friction, whose
loop is another one at every size.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from pcpc.drivers.errors import UserError
from pcpc.executive.rig.reading import Rig
from pcpc.tools.study.margin.loops import CutLoop
from pcpc.tools.study.margin.margins import Margins
from pcpc.tools.study.margin.measured import (
    ENOUGH,
    MeasuredLoop,
    best_measurement,
    measure,
    multisine,
)
from pcpc.tools.study.margin.visible import (
    Unsure,
    differences,
    is_empty,
    visible_margins,
    without_unsure,
)

_Smaller = Callable[[float], MeasuredLoop | None]
_SAME = 0.025  # of a number: what half the size may move
_HALVES = 8
_FALL, _FALLS = 16.0, 5  # from one smaller size to the next; how many
_LEAST = 0.01  # size, of what the rig commands by itself: a smaller one is lost in that
HALF = "half of what was injected gives another number"


@dataclass(frozen=True)
class MeasuredMargins:
    """A measured loop, its margins with nan for those that are not known, and why they are not."""

    loop: MeasuredLoop
    margins: Margins
    unsure: list[Unsure]

    def checked(self, half: "MeasuredMargins") -> tuple[float, "MeasuredMargins"]:
        """Return how far the numbers of half the size differ at most, and those that do not."""
        every = differences(self.margins, half.margins).items()
        apart = {name: share for name, share in every if not math.isnan(share)}
        other = {name: HALF for name, share in apart.items() if share > _SAME}
        kept, unsure = without_unsure(self.margins, other)
        worst = max(apart.values(), default=0.0)
        return worst, replace(self, margins=kept, unsure=[*self.unsure, *unsure])


def measured_margins(
    rig: Rig,
    cut: CutLoop,
    held: Mapping[str, float],
    about: tuple[float, float, int],
    sizes: Sequence[float],
    settle_s: float,
) -> MeasuredMargins:
    """Return the margins of the size, of those and smaller ones, that is nearest to a linear loop.

    A single size is checked by its half, and stays.

    about   the rate, the lowest line and the seed

    Raises UserError where the first ends in a fault.
    """
    rate, lowest, seed = about
    own = best_measurement(rig, cut, held, about, sizes, settle_s)

    def smaller(size: float) -> MeasuredLoop | None:
        """Return what the rig answers to that size; None: it ends in a fault."""
        try:
            return measure(rig, cut, held, multisine(rate, lowest, size, seed), settle_s, own.quiet)
        except UserError:
            return None

    if own.lasting_motion() is not None:
        return _margins_of(own, rate)
    if len(sizes) == 1:
        return _nearest_to_linear(own, smaller, rate, 1)
    return _nearest_to_linear(_clearest(own, smaller), smaller, rate, _HALVES)


def _clearest(own: MeasuredLoop, smaller: _Smaller) -> MeasuredLoop:
    """Return the measurement of the least error, of one and of much smaller ones."""
    if own.error.max() < ENOUGH:
        return own
    first = own.amplitude
    for k in range(1, _FALLS + 1):
        size = first / _FALL**k
        new = smaller(size) if size > _LEAST * own.alone.rms else None
        if new is None or not new.answers:
            break
        own = new if new.left < own.left else own
        if own.error.max() < ENOUGH:
            break
    return own


def _nearest_to_linear(
    own: MeasuredLoop, smaller: _Smaller, rate: float, halves: int
) -> MeasuredMargins:
    """Return the first of falling halves whose half has its numbers, or that of most such."""
    now = best = _margins_of(own, rate)
    most = (0, -math.inf)
    for _ in range(halves):
        loop = smaller(0.5 * now.loop.amplitude)
        if loop is None or is_empty(now.margins):
            break
        half = _margins_of(loop, rate)
        if is_empty(half.margins):
            break
        apart, seen = now.checked(half)
        known = sum(not math.isnan(value) for value in vars(seen.margins).values())
        if (known, -apart) >= most:
            most, best = (known, -apart), seen
        if apart <= _SAME:
            break
        now = half
    return best


def _margins_of(own: MeasuredLoop, rate_hz: float) -> MeasuredMargins:
    return MeasuredMargins(own, *visible_margins(own.f_hz, own.response, own.noise, rate_hz))
