"""A fault on purpose as a node has it: where it acts there, and when.

`nodes.planned_faults` makes them of what the rig says.
"""

import random
from collections.abc import Iterator
from dataclasses import dataclass

from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.executive.durations import duration_ns
from pcpc.executive.loop.fault_kinds import FaultKind
from pcpc.executive.loop.injection import FOR_EVER
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import PLANTS, Role
from pcpc.executive.rig.schema import Fault


class Seam(NumberedEnum):
    """Where a fault on purpose acts."""

    VALUES, FRAMES, FLOODS, OWN_STALL, PEER_STALL = range(5)


@dataclass(frozen=True)
class ActingFault:
    """A fault as a node has it: the place of `fault.NAME.left`, and what it acts on there."""

    name: str
    fault: Fault
    kind: FaultKind
    group: Seam
    seam: int = 0
    target: int = 0
    other: int = -1
    place: int = -1

    @property
    def acts_later(self) -> bool:
        """Whether it acts from the cycle after the one in which it is set."""
        return self.group not in (Seam.VALUES, Seam.FLOODS)

    def moments(self, rig: Rig, role: Role) -> Iterator[tuple[int, int, float]]:
        """Yield cycle, place and value of the tunings by which a fault begins.

        What acts on frames, or instead of a cycle, is set in the cycle before; of a stall of the
        node above the plant misses the frames one cycle later.
        """
        fault, rate_hz = self.fault, rig.config.rate_hz
        if fault.from_ is None and fault.every is None and fault.times is None:
            return
        end = round(rig.config.duration_s * rate_hz)
        first = cycles_in(fault.from_, rate_hz) or 0
        cycles = FOR_EVER if fault.for_ is None else float(cycles_in(fault.for_, rate_hz) or 0)
        if fault.times is not None:
            draw = random.Random(f"{rig.config.seed} {self.name}")
            starts = sorted(draw.randrange(first, max(end, first + 1)) for _ in range(fault.times))
        elif fault.every is not None:
            starts = list(range(first, end, max(cycles_in(fault.every, rate_hz) or 1, 1)))
        else:
            starts = [first]
        early = int(self.acts_later)
        if self.group == Seam.PEER_STALL and role in PLANTS:
            early = 0
        stalls = self.group in (Seam.OWN_STALL, Seam.PEER_STALL)  # none outlasts the run
        for start in starts:
            most = float(max(end - start, 0)) if stalls else FOR_EVER
            yield max(start - early, 0), self.place, min(cycles, most)


def cycles_in(duration: str | None, rate_hz: float) -> int | None:
    """Return the cycles of a duration of a rig file; None for none."""
    return None if duration is None else round(1e-9 * duration_ns(duration, zero=True) * rate_hz)
