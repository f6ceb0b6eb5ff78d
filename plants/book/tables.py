"""Cases beside a study; the tables of a study, declared: what names a row, what its columns hold.

    Table("seeds", (Column("median rms e1", "error_rms_rad", np.median, MRAD),
                    Column("worst", "error_rms_rad", max, MRAD)), "nn over 10 seeds of V.",
          {"samples late": label_of})

has a row for each label of the group `seeds`, and takes each figure over all runs of a row. What
`expected.csv` beside a study holds stands in brackets, or in columns of its own: the figures of an
independent implementation of the same equations, each as it is printed. A line is the group, the
words of a row, and a cell for each column ("" where there is none).
"""

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

from pcpc.plants.study import Case, CaseResult, markdown, of_group

Words = tuple[str, ...]
Key = Callable[[CaseResult], object]
Runs = Sequence[CaseResult]
Text = str | Callable[[Any], str]
Expected = Callable[..., Words]
JOINTS = (1, 2)


def case_maker(study: str, prefix: str = "") -> Callable[..., Case]:
    """Return what makes the cases of a study, `__file__`, of the rigs `prefix`... of its system."""
    rigs = Path(study).resolve().parents[1] / "rigs"

    def case(
        group: str,
        rig: str,
        controller: str,
        label: str,
        *settings: str,
        traces: Words = (),
        window_s: tuple[float, float] | None = None,
    ) -> Case:
        file = str(rigs / f"{prefix}{rig}.yaml")
        return Case(group, file, controller, label, settings, window_s, traces)

    return case


def expected_figures(study: str) -> Expected:
    """Return what gives the cells of a group and row of the expected.csv beside a study; () : none.

    A row is named by words that are joined by spaces.
    """
    with Path(study).with_name("expected.csv").open(encoding="utf-8", newline="") as file:
        known = {(table, row): tuple(cells) for table, row, *cells in csv.reader(file)}
    return lambda table, *row: known.get((table, " ".join(map(str, row))), ())


def nothing(*_row: object) -> Words:
    """Return no figures: of a study without an expected.csv."""
    return ()


def bracketed_cells(found: Sequence[str], expected: Sequence[str]) -> list[str]:
    """Return cells, in brackets what was expected where anything was."""
    pairs = zip_longest(found, expected[: len(found)], fillvalue="")
    return [f"{cell} ({other})" if other else cell for cell, other in pairs]


def rig_name(result: CaseResult) -> str:
    """Return the name of a result's rig."""
    return Path(result.case.rig).stem


def controller_of(result: CaseResult) -> str:
    """Return the name of a result's controller."""
    return result.case.controller


def label_of(result: CaseResult) -> str:
    """Return the label of a result."""
    return result.case.label


def group_of(result: CaseResult) -> str:
    """Return the group of a result."""
    return result.case.group


def part(place: int, between: str = " ", splits: int = 1) -> Key:
    """Return what gives a part of a label, which is split so often from its end."""
    return lambda result: result.case.label.rsplit(between, splits)[place]


def joined(*keys: Key) -> Key:
    """Return what names a row by several keys."""
    return lambda result: ", ".join(str(key(result)) for key in keys)


def grouped(results: Iterable[CaseResult], *keys: Key) -> dict[Words, list[CaseResult]]:
    """Return results by their keys, in the order of the cases."""
    groups: dict[Words, list[CaseResult]] = {}
    for result in results:
        groups.setdefault(tuple(str(key(result)) for key in keys), []).append(result)
    return groups


def by_case(results: Iterable[CaseResult], of: str) -> dict[Words, CaseResult]:
    """Return the first results of a group by (rig, controller, label)."""
    found = grouped(of_group(results, of), rig_name, controller_of, label_of)
    return {names: runs[0] for names, runs in found.items()}


def by_label(results: Iterable[CaseResult], of: str) -> dict[str, CaseResult]:
    """Return the first results of a group by label."""
    return {name: runs[0] for (name,), runs in grouped(of_group(results, of), label_of).items()}


def recorded(name: str) -> Callable[[CaseResult], float]:
    """Return what gives a metric as it came, of a run that ended early too."""
    return lambda result: result.metrics.get(name, float("nan"))


def first(values: Sequence[Any]) -> Any:
    """Return the value of a row's only run, or of its first."""
    return values[0]


def span(values: Sequence[float]) -> tuple[float, float]:
    """Return the least and the largest, which are printed as one where they print alike."""
    return min(values), max(values)


def share(values: Sequence[float]) -> str:
    """Return how many are true, of all."""
    return f"{true_count(values)} of {len(values)}"


def true_count(values: Sequence[float]) -> str:
    """Return how many are true."""
    return str(sum(value > 0.5 for value in values))


def run_count(values: Sequence[float]) -> str:
    """Return how many there are."""
    return str(len(values))


@dataclass(frozen=True)
class Column:
    """A column: what is taken of each run of a row, then of all of them, and how it is printed.

    `source`: a metric, with `{}` for both joints, `between` them in a cell, or "" for that of the
    row; a function of a result; an int: which of the expected figures. `of`: of the row's values.
    `where`: only runs for which each key gives this; `absent`: the cell where there is none.
    """

    head: str
    source: str | int | Callable[[CaseResult], Any]
    of: Callable[[list[Any]], Any] = first
    text: Text = "{:.4f}"
    between: str = " / "
    absent: str = ""
    where: tuple[tuple[Key, str], ...] = ()

    def cell(self, runs: Runs, expected: Words, metric: str) -> str:
        """Return the cell of a row of runs, of which this is expected; `metric`: the row's."""
        matching = [run for run in runs if all(str(key(run)) == value for key, value in self.where)]
        source = metric if self.source == "" else self.source
        if isinstance(source, int):
            return "".join(expected[source : source + 1])
        if not matching:
            return self.absent
        if not isinstance(source, str):
            return self._printed([source(run) for run in matching])
        names = dict.fromkeys(source.format(joint) for joint in JOINTS)
        return self.between.join(
            self._printed([r.metric(name) for r in matching]) for name in names
        )

    def _printed(self, values: list[Any]) -> str:
        return printed(self.of(values), self.text)


def printed(value: Any, text: Text) -> str:
    """Return the text of a number, of the least and the largest of some, or of a text itself."""
    if isinstance(value, tuple):
        return "-".join(dict.fromkeys(printed(one, text) for one in value))
    if isinstance(value, str):
        return value
    return text.format(value) if isinstance(text, str) else text(value)


def at(key: Key, value: object, *columns: Column) -> tuple[Column, ...]:
    """Return columns of those runs of a row for which the key gives this."""
    return tuple(replace(c, where=(*c.where, (key, str(value)))) for c in columns)


def across(
    key: Key, values: Iterable[object] | Mapping[object, str], column: Column
) -> tuple[Column, ...]:
    """Return a column for each value of a key; it, or its text, stands for `{}` in the head."""
    heads = values if isinstance(values, Mapping) else {value: str(value) for value in values}
    return tuple(
        replace(c, head=c.head.format(text))
        for value, text in heads.items()
        for c in at(key, value, column)
    )


@dataclass(frozen=True)
class RunsTable:
    """A table of the runs of a group, or of several; the first is that of expected.csv.

    `rows`: heads, and what names a row; {}: one row of all runs. `nested`: rows of one first name
    stand together. `metrics`: a row for each instead, of all runs: its name, and the metric.
    """

    group: str | Words
    columns: Sequence[Column]
    title: str = ""
    rows: Mapping[str, Key] = field(default_factory=lambda: {"": label_of})
    nested: bool = False
    metrics: Mapping[str, str] = field(default_factory=dict)

    def markdown(self, results: Iterable[CaseResult], known: Expected) -> str:
        """Return title and table; `known`: what is expected of a group's row."""
        group_runs, of = _runs(results, self.group)
        rows = [
            [*names, *_cells(self.columns, runs, known(of, *names), metric)]
            for names, runs, metric in self._rows(group_runs)
        ]
        heads = (*self.rows, *(column.head for column in self.columns))
        return (f"{self.title}\n\n" if self.title else "") + markdown(heads, rows)

    def _rows(self, group_runs: Runs) -> Iterator[tuple[Words, Runs, str]]:
        for name, metric in self.metrics.items():
            yield (name,), group_runs, metric
        groups = {} if self.metrics else grouped(group_runs, *self.rows.values())
        firsts = [names[0] for names in groups] if self.nested else []
        for names in sorted(groups, key=lambda row: firsts.index(row[0]) if firsts else 0):
            yield names, groups[names], ""


@dataclass(frozen=True)
class Sentence:
    """A text with the cells of one row of all runs of a group, or of groups, each for a `{}`."""

    group: str | Words
    columns: Sequence[Column]
    text: str

    def markdown(self, results: Iterable[CaseResult], known: Expected) -> str:
        """Return the text."""
        own, of = _runs(results, self.group)
        return self.text.format(*_cells(self.columns, own, known(of)))


def _runs(results: Iterable[CaseResult], group: str | Words) -> tuple[list[CaseResult], str]:
    """Return the runs of a group, or of groups, and what expected.csv calls them."""
    of = (group,) if isinstance(group, str) else group
    return [result for result in results if result.case.group in of], of[0]


def _cells(
    columns: Sequence[Column], runs: Runs, expected: Words, metric: str = ""
) -> Sequence[str]:
    cells = [column.cell(runs, expected, metric) for column in columns]
    apart = any(isinstance(column.source, int) for column in columns)
    return cells if apart else bracketed_cells(cells, expected)


Part = RunsTable | Sentence | str | Callable[[Runs], str]


def page(results: Runs, parts: Iterable[Part], known: Expected = nothing) -> str:
    """Return tables, texts and what functions of the results return, one below the other."""
    return "\n".join(
        part if isinstance(part, str)
        else part(results) if callable(part)
        else part.markdown(results, known)
        for part in parts
    )  # fmt: skip
