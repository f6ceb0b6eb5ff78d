"""What `pcpc margin --limit-cycle` finds: the branch, its least gain, predictions beside runs."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pcpc.tools.study.margin.facts import LimitCycleFacts, Point, StepAtFactor
from pcpc.tools.study.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class LimitCycle(Result):
    """The branch from large to small amplitudes, and runs; `grown`: what is not linear in it."""

    name = "limit_cycle"

    rig: str
    controller: str
    gain: str
    grown: dict[str, float]
    linear_factor: float
    linear_hz: float
    branch: list[Point]
    rows: list[StepAtFactor]
    signal: str
    unit: str

    @property
    def onset(self) -> Point:
        """The cycle of the least gain."""
        return self.branch[onset_index(self.branch)]

    def facts(self) -> LimitCycleFacts:
        """Return all."""
        return LimitCycleFacts(**vars(self), onset=self.onset)

    def pictures(self) -> Mapping[str, "Figure"]:
        """Return the branch's."""
        from pcpc.tools.study.margin import drawing  # time

        return {"limit_cycle": drawing.limit_cycle(self)}

    def lines(self) -> Iterator[str]:
        """Yield where cycles begin, and the table."""
        onset, unit = self.onset, f" [{self.unit}]" if self.unit else ""
        yield f"{self.rig}, {self.controller}: limit cycles as {self.gain} grows"
        yield from (f"with      {name} = {value:g}" for name, value in self.grown.items())
        yield f"linear    unstable from factor {self.linear_factor:.4g}, {self.linear_hz:.4g} Hz"
        yield f"cycles    predicted from factor {onset.factor:.4g}, {onset.f_hz:.4g} Hz"
        yield from ("", f"step of {self.signal}, rms{unit}")
        yield "  factor         predicted   amplitude          Hz       alone     the rig"
        for row in self.rows:
            cells = ["no cycle", "", ""]
            if one := row.predicted:
                cells = [f"{value:.4g}" for value in (one.step_rms, one.amplitude, one.f_hz)]
            cells += [f"{row.alone:.3g}", f"{row.run:.3g}" if math.isfinite(row.run) else "fault"]
            yield f"{row.factor:8.4g}      " + "".join(f"{cell:>12}" for cell in cells)


def onset_index(points: Sequence[Point]) -> int:
    """Return the place of the least gain: before it, at larger amplitudes, cycles are stable."""
    return min(range(len(points)), key=lambda i: points[i].factor)
