"""Campaigns whose next runs depend on the last: the worst case, the probability of a rare failure.

A run is judged by a margin: the smallest of its requirements, or how far a metric is below a limit.
A fault, and a run that could not tell it, is -inf; below 0 is a failure. Where no requirement
failed, but one was not judged, nobody knows: no probability is told with such a run. All runs have
noise of one seed, so that the margin is a function of what varies. The same campaign asks for the
same points, so that one that goes on is answered by the rows that are there.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from pcpc.executive.errors import RigError, did_you_mean
from pcpc.tools.study.arrays import Vector
from pcpc.tools.study.engine import FAULT, RAN, REFUSED, Pieces, RunVerdict, pieces
from pcpc.tools.study.sweep import rare, statements, worst
from pcpc.tools.study.sweep.campaign import Campaign
from pcpc.tools.study.sweep.store import Store
from pcpc.tools.study.sweep.vary import points_of_normal

Rows = Callable[[Pieces], Iterator[list[RunVerdict]]]
CASES = 5  # of a controller that are told
APART = 12  # numbers of draws are this times the runs apart between controllers: more than asked


@dataclass(frozen=True)
class Search:
    """What a search looks at: the smallest margin of the requirements, or the metric `of`.

    The metric is made as large as possible, or its failure is to be above `limit`.
    """

    campaign: Campaign
    of: str | None = None
    limit: float | None = None

    def __post_init__(self) -> None:
        """Raise RigError for what cannot be searched."""
        kind, runs = self.campaign.sampling, self.campaign.draws
        if not self.campaign.variations:
            raise RigError(f"--{kind}: nothing is varied; give --vary NAME=SPEC")
        if kind == "rare" and (runs < 20 or runs % 10):
            raise RigError(f"--rare {runs}: expected a multiple of 10, 20 or more; 1000 is usual")
        if self.of == "":
            raise RigError("--of '': expected a metric of the rig's evaluation")
        if self.limit is not None and not math.isfinite(self.limit):
            raise RigError(f"--limit {self.limit}: expected a number")
        if (self.limit is not None) != (kind == "rare" and self.of is not None):
            raise RigError("--limit X is only for --rare with --of METRIC")
        for name, known in self.campaign.requirements().items():
            if self.of is None and not known:
                cure = "name a metric of its evaluation with --of"
                raise RigError(f"{self.campaign.rig}: {name} has no requirement; {cure}")

    def spec(self) -> dict[str, object]:
        """Return what another search would have otherwise."""
        return {"of": self.of, "limit": self.limit}

    def outcome(self, rows_of: Rows, store: Store, shown: Callable[[], None]) -> str:
        """Do the runs; return what came out, in lines. RigError: no such metric, refused values."""
        found = []
        for i, name in enumerate(self.campaign.controllers):
            runs = _ControllerRuns(
                self, name, rows_of, store, shown, i * APART * self.campaign.draws
            )
            found += self._worst(runs) if self.campaign.sampling == "worst" else _rare(runs)
        again = f"again, with a log: pcpc sweep rerun {store.folder} DRAW CONTROLLER"
        return "\n".join([*found, again])

    def _worst(self, runs: "_ControllerRuns") -> list[str]:
        campaign = self.campaign
        about = campaign.variations, campaign.draws, campaign.seed, CASES
        points, margins = worst.worst(runs.margins, *about)
        if not len(margins) or margins[0] == math.inf:
            what = "no run could be judged; vary within the ranges, or name a metric with --of"
            raise statements.NothingToTellError(f"--worst: {runs.controller}: {what}")
        head = f"{runs.controller}: the worst of {statements.count_text(runs.count, 'run')}"
        head += f", {runs.unjudged:,} of which were not judged" if runs.unjudged else ""
        return [head, *(runs.line(runs.numbers[point.tobytes()]) for point in points)]

    def margin(self, row: RunVerdict) -> float:
        """Return a row's margin; inf where nothing was to be judged, or nothing could be run."""
        if row.outcome == REFUSED:
            return math.inf
        if row.outcome == FAULT:
            return -math.inf
        if self.of is not None:
            value = row.metrics.get(self.of, math.nan)
            return (self.limit or 0.0) - value if math.isfinite(value) else -math.inf
        told = [one for one in row.margins.values() if one is not None and not math.isnan(one)]
        least = min(told, default=math.inf)
        failed = False in row.held.values() or (row.ok is False and not (row.metrics and told))
        return -math.inf if failed and least >= 0.0 else least

    def is_unjudged(self, row: RunVerdict) -> bool:
        """Return whether nobody knows if a run failed: not all was judged, nothing failed."""
        whole = bool(row.held) and None not in row.held.values()
        return self.of is None and row.outcome == RAN and not whole and self.margin(row) >= 0.0


def _rare(runs: "_ControllerRuns") -> list[str]:
    campaign = runs.search.campaign
    about = len(campaign.variations), campaign.draws, campaign.seed
    found = rare.subset(lambda z: runs.margins(points_of_normal(z)), *about)
    low, high = (statements.bound_text(float(f"{p:.2g}")) for p in found.interval())
    count = statements.count_text(runs.count, "run")
    if found.p == 0.0:
        said = f"no failure in {count}: p_fail is below {high}"
    else:
        p = statements.bound_text(float(f"{found.p:.2g}"))
        said = f"p_fail = {p}, between {low} and {high} at 95 %, by {count}"
    failed = [runs.numbers[points_of_normal(z).tobytes()] for z in found.failing[:CASES]]
    return [f"{runs.controller}: {said}", *(runs.line(i) for i in dict.fromkeys(failed))]


@dataclass
class _ControllerRuns:
    """The runs of one controller, numbered from `first` in the order of asking."""

    search: Search
    controller: str
    rows_of: Rows
    store: Store
    shown: Callable[[], None]
    first: int

    def __post_init__(self) -> None:
        self.count = self.unjudged = 0
        self.numbers: dict[bytes, int] = {}

    def margins(self, points: Vector) -> Vector:
        """Return the margins of points (n, d)."""
        campaign, rows, name = self.search.campaign, self.store, self.controller
        numbered = list(enumerate(points, self.first + self.count))
        self.count += len(points)
        left = []
        for number, point in numbered:
            self.numbers.setdefault(point.tobytes(), number)
            row = rows.get((number, name))
            if row is None:
                left.append((number, point))
            elif row.values != campaign.draw(name, number, point).values:
                what = f"{self.store.folder}: draw {number} had other values than now"
                raise RigError(f"{what}, by other versions of numpy or cma; begin with another -o")
        for done in self.rows_of(pieces(left, [name], campaign.draw)):
            self.store.add(done)
            self.shown()
        found = [rows[number, name] for number, _ in numbered]
        self._check(found)
        return np.array([self.search.margin(row) for row in found])

    def _check(self, rows: list[RunVerdict]) -> None:
        for row in rows:
            unjudged = self.search.is_unjudged(row)
            self.unjudged += unjudged
            if self.search.campaign.sampling == "rare" and (unjudged or row.outcome == REFUSED):
                cure = "draw values that a run can have, as normal(m,s,lo,hi)"
                if unjudged:
                    cure = "a run that is not judged is no good one; vary less, or give --of METRIC"
                what = f"--rare: draw {row.draw}: {row.why}; {cure}"
                raise statements.NothingToTellError(what)
        of, known = self.search.of, {name: None for row in rows for name in row.metrics}
        if of is not None and of not in known and any(row.outcome == RAN for row in rows):
            what = f"{self.controller} has no metric {of}"
            raise statements.NothingToTellError(f"--of {of}: {what}{did_you_mean(of, known)}")

    def line(self, number: int) -> str:
        """Return a run in a line."""
        row = self.store[number, self.controller]
        value = row.metrics.get(self.search.of or "", math.nan)
        said = f"margin {self.search.margin(row):.4g}" if self.search.of is None else f"{value:.4g}"
        values = ", ".join(f"{name} = {value:.6g}" for name, value in row.values.items())
        return f"  draw {number}: {row.why if row.outcome == FAULT else said}: {values}"
