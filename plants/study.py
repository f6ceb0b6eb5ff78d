"""What a plant's study.py is made of: runs to make, tables and figures of what came out.

A plant folder may hold a `study.py` with

    CHAPTER                  int, of the book: `pcpc experiment chapter5` runs all studies of it
    TITLE                    str, heading of its part of results.md
    cases() -> [Case]        the runs; all are virtual
    report(results) -> str   Markdown: the tables
    draw(results, folder)    PNG files into the folder; matplotlib is imported in here
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Case:
    """One run: a rig file, a controller, settings as for `--set`, and where its result belongs."""

    group: str
    rig: str
    controller: str
    label: str
    settings: tuple[str, ...] = ()
    window_s: tuple[float, float] | None = None  # instead of the rig's
    traces: tuple[str, ...] = ()  # to keep: variables `NODE:NAME`, signals of the evaluation


@dataclass(frozen=True)
class CaseResult:
    """What a case came to; `failed`: why there are no metrics; `diverged`: it ended early.

    `settings`: all of the run's blocks, as `arm.stop_m`, so that no figure repeats a number.
    """

    case: Case
    metrics: Mapping[str, float] = field(default_factory=dict)
    traces: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    settings: Mapping[str, float] = field(default_factory=dict)
    diverged: bool = False
    failed: str = ""

    def metric(self, name: str) -> float:
        """Return a metric; infinite where the run diverged, NaN where there is none."""
        return float("inf") if self.diverged else self.metrics.get(name, float("nan"))


def of_group(results: Iterable[CaseResult], group: str) -> list[CaseResult]:
    """Return the results of a group, in the order of the cases."""
    return [result for result in results if result.case.group == group]


def statistic(
    results: Iterable[CaseResult], name: str, of: Callable[[NDArray[np.float64]], float]
) -> float:
    """Return a statistic, `numpy.median` for one, of a metric over runs that differ by a draw.

    `of` takes them as (n,).
    """
    return float(of(np.array([result.metric(name) for result in results])))


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines) + "\n"
