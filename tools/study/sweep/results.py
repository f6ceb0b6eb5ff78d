"""The table of a campaign by column: failures, pairs, worst cases, and how to run one again."""

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pcpc.tools.study.arrays import Flags, Rows, Vector
from pcpc.tools.study.binomial import clopper_pearson
from pcpc.tools.study.engine import FAULT, NOTHING, RAN, REFUSED

if TYPE_CHECKING:
    from numpy.typing import NDArray

VARY, METRIC, MARGIN, HELD, LEFT = "vary:", "metric:", "margin:", "held:", "unjudged:"
COLUMNS = {  # of a table in their order, or the kinds of those that have a name behind it
    "draw": "int64", "controller": "string", "seed": "int64",
    VARY: "double", METRIC: "double", MARGIN: "double", HELD: "bool", LEFT: "string",
    "ok": "bool", "why": "string", "outcome": "string", "alone": "string",
}  # fmt: skip


def kind_of(column: str) -> str:
    """Return a column's key in COLUMNS."""
    kind, colon, _ = column.partition(":")
    return kind + colon


class Counts(NamedTuple):
    """Runs that failed, that were judged, and that ran but could not be judged: no pass."""

    failures: int = 0
    runs: int = 0
    unjudged: int = 0

    def interval(self, confidence: float) -> tuple[float, float]:
        """Return the interval of p_fail that holds whatever those that were not judged are."""
        low, _ = clopper_pearson(self.failures, self.runs + self.unjudged, confidence)
        most = self.failures + self.unjudged
        return low, clopper_pearson(most, self.runs + self.unjudged, confidence)[1]

    def plus(self, more: "Counts") -> "Counts":
        """Return the sum of both."""
        return Counts(*(a + b for a, b in zip(self, more, strict=True)))


def counts(outcomes: Iterable[str], judged: Iterable[bool | None]) -> Counts:
    """Return the counts; `judged`: of each run the verdict, or whether a requirement held.

    A fault is a failure; a refused run is none of them.
    """
    pairs = list(zip(outcomes, judged, strict=True))
    failed = [outcome == FAULT or (outcome == RAN and held is False) for outcome, held in pairs]
    unjudged = sum(outcome == RAN and held is None for outcome, held in pairs)
    done = sum(outcome != REFUSED for outcome, _ in pairs)
    return Counts(sum(failed), done - unjudged, unjudged)


class Results:
    """A table with one row a run, as `pcpc sweep` writes it, and the campaign's `spec`.

    Columns: draw, controller, seed, outcome (ran, fault, refused), ok, why; `vary:NAME`,
    `metric:NAME` and `margin:NAME` (float, NaN where not told), `held:NAME` (null: not judged),
    `unjudged:NAME` (why it was not; null: it was).
    """

    def __init__(self, table: Any, spec: Mapping[str, Any]) -> None:
        """Take a pyarrow.Table in any order of rows."""
        self._table = table.sort_by([("draw", "ascending"), ("controller", "ascending")])
        self.spec = spec
        self._columns: dict[str, NDArray[Any]] = {}
        there = self.column("controller").tolist()
        named = [name for name in spec.get("controllers", ()) if name in there]
        self.controllers: list[str] = list(dict.fromkeys([*named, *there]))
        self.variations, self.metrics, self.requirements, self._left = (
            [name.removeprefix(kind) for name in table.column_names if name.startswith(kind)]
            for kind in (VARY, METRIC, MARGIN, LEFT)
        )

    @property
    def measures(self) -> list[str]:
        """The columns of metrics and margins."""
        margins = (MARGIN + name for name in self.requirements)
        return [*(METRIC + name for name in self.metrics), *margins]

    def column(self, name: str) -> "NDArray[Any]":
        """Return a column, by draw and controller; null is NaN in numbers, None elsewhere."""
        if name not in self._columns:
            self._columns[name] = np.asarray(self._table[name].to_numpy())
        return self._columns[name]

    @cached_property
    def refused(self) -> Flags:
        """Which runs had a value outside its range and count neither way."""
        return self.column("outcome") == REFUSED

    def rows_of(self, controller: str) -> Flags:
        """Which rows are a controller's runs, without the refused."""
        return (self.column("controller") == controller) & ~self.refused

    def failures(self, controller: str, requirement: str | None = None) -> tuple[int, int]:
        """Return failures and runs, of a requirement or of the verdict."""
        return self.counts(controller, requirement)[:2]

    def counts(self, controller: str, requirement: str | None = None) -> Counts:
        """Return the counts of a controller; none of a requirement that is not the controller's."""
        own = self.rows_of(controller)
        outcomes, ok = (self.column(name)[own].tolist() for name in ("outcome", "ok"))
        judged = ok if requirement is None else self.column(HELD + requirement)[own].tolist()
        if all(one is None for one in judged) and True in ok:  # all of its own were judged
            return Counts()
        return counts(outcomes, judged)

    def never_judged(self) -> Iterator[str]:
        """Yield a line for what no run was judged by, or no run of its controller."""
        for name in self.requirements:
            found = {one: self.counts(one, name) for one in self.controllers}
            silent = [one for one, n in found.items() if n.unjudged and not n.runs]
            whys = {one: self._whys_unjudged(one, name) for one in silent}
            line = f"{name} was judged in no run"
            if any(n.runs for n in found.values()):
                yield from (f"{line} of {one}: {why[0]}" for one, why in whys.items() if why)
            elif silent:
                yield ": ".join([line, *next(filter(None, whys.values()), [])[:1]])
        for one in self.controllers:
            own = self.rows_of(one)
            columns = (self.column(c)[own] for c in ("ok", *(HELD + r for r in self.requirements)))
            if any(held is not None for column in columns for held in column):
                continue
            left = {name: self._whys_unjudged(one, name) for name in self._left}
            name = max(left, key=lambda name: len(left[name]), default="")
            if name not in ("", *self.requirements) and left[name]:
                yield f"{name} was judged in no run of {one}: {left[name][0]}"
            elif not self._left:  # an earlier version told it in words alone
                first = [why for why in self.column("why")[own][:1] if why not in ("", NOTHING)]
                yield from (f"{one}: {why}" for why in first)

    def _whys_unjudged(self, controller: str, name: str) -> list[str]:
        """Return why a controller's runs were not judged by a requirement or limit."""
        own = self.rows_of(controller)
        found = self.column(LEFT + name)[own].tolist() if name in self._left else []
        return [why for why in found if why]

    def values(self, name: str, controller: str) -> Vector:
        """Return a column of numbers of a controller's runs, NaN where not told or at a fault."""
        own = self.rows_of(controller)
        fault = self.column("outcome")[own] == FAULT
        found = np.where(fault, np.nan, self.column(name)[own].astype(np.float64))
        return np.where(np.isfinite(found), found, np.nan)

    def varied_values(self, controller: str) -> Vector:
        """Return the varied values of a controller's runs, (n, d)."""
        own = self.rows_of(controller)
        columns = [self.column(VARY + name)[own].astype(np.float64) for name in self.variations]
        return np.column_stack(columns) if columns else np.empty((int(own.sum()), 0))

    def pairs(self, name: str, base: str, other: str) -> tuple[Vector, Vector]:
        """Return the values of both controllers on the draws that told both."""
        draws = self.column("draw")
        _, left, right = np.intersect1d(
            draws[self.rows_of(base)], draws[self.rows_of(other)], return_indices=True
        )
        x, y = self.values(name, base)[left], self.values(name, other)[right]
        told = np.isfinite(x) & np.isfinite(y)
        return x[told], y[told]

    def worst(self, name: str, most: int, largest: bool = False) -> Rows:
        """Return the rows with the smallest (or largest) values of a column, those first."""
        values = self.column(name).astype(np.float64)
        counted = np.flatnonzero(np.isfinite(values) & ~self.refused)
        order = np.argsort(-values[counted] if largest else values[counted], kind="stable")
        return counted[order[:most]]

    def worst_first(self) -> Rows:
        """Return the rows by verdict: faults, smallest margins, else largest first metric.

        Without the refused.
        """

        def least(names: list[str]) -> Vector:
            columns = (self.column(name).astype(np.float64) for name in names)
            return np.fmin.reduce([np.full(len(self.refused), np.nan), *columns])

        margin = least([MARGIN + name for name in self.requirements])
        metric = least([METRIC + name for name in self.metrics[:1]])
        badness = np.where(np.isnan(margin), metric, -margin)
        badness = np.where(np.isnan(badness), -np.inf, badness)
        order = np.lexsort((-badness, self.column("outcome") != FAULT))
        return order[~self.refused[order]]

    def faults(self, most: int) -> Rows:
        """Return the first rows that ended in a fault."""
        return np.flatnonzero(self.column("outcome") == FAULT)[:most]

    def run_words(self, row: int) -> list[str]:
        """Return what follows `pcpc simulate` to run a row again, bit for bit."""
        words = [str(self.spec["rig"])]
        if controller := self.column("controller")[row]:
            words += ["--controller", controller]
        settings = [str(one) for one in self.spec.get("settings", ())]
        settings += [f"{n}={_number_text(self.column(VARY + n)[row])}" for n in self.variations]
        settings.append(f"seed={self.column('seed')[row]}")
        return [*words, *(word for one in settings for word in ("--set", one))]

    def command(self, row: int) -> str:
        """Return the command that runs a row again, bit for bit, with its full log."""
        return shlex.join(["pcpc", "simulate", *self.run_words(row)])


def _number_text(value: float) -> str:
    """Return a number with all its bits, a whole one without a dot as whole settings need it."""
    value = float(value)
    return str(int(value)) if value.is_integer() and abs(value) < 2**53 else repr(value)


def comparisons(
    results: Results, name: str, ratios: Sequence[float]
) -> Iterator[tuple[str, int, list[int], float]]:
    """Yield of every controller but the first: pairs, in how many the first is r times larger.

    And the median of first/other, NaN where a value is not above 0: then a ratio says nothing.
    """
    base, *others = results.controllers
    for other in others:
        x, y = results.pairs(name, base, other)
        positive = len(x) > 0 and min(x.min(), y.min()) > 0.0
        counts = [int(np.count_nonzero(x > y if r == 1.0 else x >= r * y)) for r in ratios]
        yield other, len(x), counts, float(np.median(x / y)) if positive else float("nan")
