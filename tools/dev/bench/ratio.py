"""A ratio of ours to a yardstick: measured in turn, told in two lines.

A ratio is taken within a round, in which product and yardstick follow each other, and its spread is
the quartiles over rounds: on a machine that others use too, times mean little and ratios stay.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import ArrayLike, NDArray

from pcpc.tools.terminal.answer import Number
from pcpc.tools.terminal.progress import Progress

Measurement = Callable[[], float]


@dataclass(frozen=True)
class Ratio:
    """A ratio to a yardstick."""

    suite: str
    what: str
    "was measured"
    against: str
    "the yardstick"
    own: Number
    "median, in unit"
    base: Number
    "median of the yardstick, in unit"
    unit: str
    ratio: tuple[Number, Number, Number]
    "own over base: quartile, median, quartile"

    @classmethod
    def from_rounds(
        cls, suite: str, what: str, against: str, own: ArrayLike, base: ArrayLike, unit: str
    ) -> "Ratio":
        """Return the ratio of `own` to `base`, both (rounds,) and measured in turn."""
        low, median, high = np.percentile(np.divide(own, base), (25.0, 50.0, 75.0)).tolist()
        ours, theirs = (float(np.median(np.asarray(a))) for a in (own, base))
        return cls(suite, what, against, ours, theirs, unit, (low, median, high))

    def __str__(self) -> str:
        low, median, high = self.ratio
        own = f"{self.what:16} {self.own:10.4g} {self.unit:5}"
        return (
            f"{own} {self.against:32} {self.base:.4g} {self.unit}\n"
            f"{'':16} ratio {median:.3f} ({low:.3f} to {high:.3f})"
        )


Ratios = Annotated[
    list[Ratio],
    Meta(description="Written to the file of --json; empty where a yardstick is missing."),
]


def interleave(
    progress: Progress, what: str, rounds: int, sides: Sequence[Measurement]
) -> NDArray[np.float64]:
    """Return the results of `sides` called in turn, (sides, rounds), after one call to warm up."""
    values = np.empty((len(sides), rounds))
    for side in sides:
        side()
    for i in range(rounds):
        progress.show(f"{what}: round {i + 1} of {rounds}")
        values[:, i] = [side() for side in sides]
    return values


def processor_time(work: Callable[[], object], count: float = 1) -> Measurement:
    """Return a measurement of `work`: processor time of the thread, ns, over `count`."""

    def side() -> float:
        start = time.thread_time_ns()
        work()
        return (time.thread_time_ns() - start) / count

    return side
