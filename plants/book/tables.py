"""Cases beside a study, results by what they are of, and cells with what was expected of them.

`expected.csv` beside a study holds the figures of an independent implementation of the same
equations, each as it is printed: table, row, and a cell for each column ("" where there is none).
"""

import csv
from collections.abc import Callable, Iterable, Sequence
from itertools import zip_longest
from pathlib import Path

from pcpc.plants.study import Case, Result, of_group

Key = tuple[str, ...]
Expected = Callable[..., Key]


def case_maker(study: str, prefix: str = "") -> Callable[..., Case]:
    """Return what makes the cases of a study, `__file__`, of the rigs `prefix`... of its system."""
    rigs = Path(study).resolve().parents[1] / "rigs"

    def case(
        group: str,
        rig: str,
        controller: str,
        label: str,
        *settings: str,
        traces: Key = (),
        window_s: tuple[float, float] | None = None,
    ) -> Case:
        file = str(rigs / f"{prefix}{rig}.yaml")
        return Case(group, file, controller, label, settings, window_s, traces)

    return case


def expected_figures(study: str) -> Expected:
    """Return what gives the cells of a table and row of the expected.csv beside a study; () : none.

    A row is named by words that are joined by spaces.
    """
    with Path(study).with_name("expected.csv").open(encoding="utf-8", newline="") as file:
        known = {(table, row): tuple(cells) for table, row, *cells in csv.reader(file)}
    return lambda table, *row: known.get((table, " ".join(map(str, row))), ())


def bracketed_cells(found: Sequence[str], expected: Sequence[str]) -> list[str]:
    """Return cells, in brackets what was expected where anything was."""
    pairs = zip_longest(found, expected[: len(found)], fillvalue="")
    return [f"{cell} ({other})" if other else cell for cell, other in pairs]


def rig_name(result: Result) -> str:
    """Return the name of a result's rig."""
    return Path(result.case.rig).stem


def by_case(results: Iterable[Result], group: str) -> dict[tuple[str, str, str], Result]:
    """Return the results of a group by (rig, controller, label)."""
    own = of_group(results, group)
    return {(rig_name(r), r.case.controller, r.case.label): r for r in own}


def results_by_run(results: Iterable[Result], group: str) -> dict[tuple[str, str], Result]:
    """Return the results of a group by (controller, label)."""
    return {(r.case.controller, r.case.label): r for r in of_group(results, group)}


def results_of_label(results: Iterable[Result], group: str, label: str) -> list[Result]:
    """Return the results of a group that have this label."""
    return [result for result in of_group(results, group) if result.case.label == label]


def labels(results: Iterable[Result], group: str) -> list[str]:
    """Return the labels of a group, in the order of the cases."""
    return list(dict.fromkeys(result.case.label for result in of_group(results, group)))


def least_to_largest(
    results: Iterable[Result], number: Callable[[Result], float], text: Callable[[float], str]
) -> str:
    """Return `least-largest` of a number of each, or one text where both print alike."""
    values = [number(result) for result in results]
    low, high = text(min(values)), text(max(values))
    return low if low == high else f"{low}-{high}"
