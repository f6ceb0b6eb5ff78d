"""The tables of the studies: what a row, a column and a cell are, and that none is lost."""

import csv
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from pcpc.plants.book import tables
from pcpc.plants.book.tables import (
    Column,
    RunsTable,
    Sentence,
    across,
    at,
    joined,
    label_of,
    page,
    part,
)
from pcpc.plants.study import Case, CaseResult
from pcpc.tools.study.experiment.cli import studies

LAWS = {"pd": 1.0, "nn": 5.0}


def results() -> list[CaseResult]:
    """Return two laws of two labels each, three runs of the first; the last of them diverged."""
    return [
        CaseResult(
            Case("g", f"rigs/{rig}.yaml", law, f"{label} {law}"),
            {
                "e": base + i + 0.25 * (rig == "two"),
                "q_1": base,
                "q_2": 10.0 * base,
                "off": float(i > 0),
            },
            diverged=(law, label, i) == ("nn", "b", 2),
        )
        for rig in ("one", "two")
        for law, base in LAWS.items()
        for label, runs in (("b", 3), ("a", 1))
        for i in range(runs if rig == "one" else 0 if label == "a" else 1)
    ]


BY_LAW: dict[str, Callable[[CaseResult], str]] = {"law": tables.controller_of}


@pytest.mark.parametrize(
    ("column", "pd", "nn"),
    [
        (Column("", "e"), "1.0000", "5.0000"),
        (Column("", "e", np.median, "{:.2f}"), "1.25", "5.25"),
        (Column("", "e", max, "{:.1f}"), "3.0", "inf"),
        (Column("", "e", min, lambda v: f"{1e3 * v:.0f}"), "1000", "5000"),
        (Column("", "e", tables.span, "{:.1f}"), "1.0-3.0", "5.0-inf"),
        (Column("", "q_1", tables.span, "{:.1f}"), "1.0", "5.0-inf"),
        (Column("", "off", tables.share), "2 of 5", "2 of 5"),
        (Column("", "off", tables.true_count), "2", "2"),
        (Column("", "off", tables.run_count), "5", "5"),
        (Column("", "q_{}", text="{:.0f}"), "1 / 10", "5 / 50"),
        (Column("", "q_{}", text="{:.0f}", between=", "), "1, 10", "5, 50"),
        (Column("", lambda r: 2.0 * r.metric("e"), text="{:.0f}"), "2", "10"),
        (Column("", label_of), "b pd", "b nn"),
        (Column("", "none"), "nan", "nan"),
        (Column("", tables.recorded("e"), max, "{:.1f}"), "3.0", "7.0"),
        (Column("", tables.recorded("none")), "nan", "nan"),
        (at(part(0), "a", Column("", "e", max, "{:.1f}"))[0], "1.0", "5.0"),
        (at(tables.rig_name, "two", Column("", "e", tables.run_count))[0], "1", "1"),
        (at(part(0), "a", *at(tables.rig_name, "two", Column("", "e", tables.run_count)))[0],
         "", ""),
        (at(part(0), "c", Column("", "e", absent="-"))[0], "-", "-"),
    ],
)  # fmt: skip
def test_a_cell_is_a_statistic_of_the_runs_of_its_row(column: Column, pd: str, nn: str) -> None:
    text = RunsTable("g", [column], rows=BY_LAW).markdown(results(), tables.nothing)
    assert text == f"| law |  |\n|---|---|\n| pd | {pd} |\n| nn | {nn} |\n"


def rows_of(table: RunsTable) -> list[str]:
    """Return the rows of a table without its head."""
    return table.markdown(results(), tables.nothing).splitlines()[2:]


@pytest.mark.parametrize(
    ("table", "rows"),
    [
        (RunsTable("g", [], rows={"law": part(1), "label": part(0)}),
         ["pd | b", "pd | a", "nn | b", "nn | a"]),
        (RunsTable("g", [], rows={"label": part(0), "law": part(1)}),
         ["b | pd", "a | pd", "b | nn", "a | nn"]),
        (RunsTable("g", [], rows={"label": part(0), "law": part(1)}, nested=True),
         ["b | pd", "b | nn", "a | pd", "a | nn"]),
        (RunsTable("g", [], rows={"": joined(part(1), part(0))}),
         ["pd, b", "pd, a", "nn, b", "nn, a"]),
        (RunsTable(("g", "h"), [], rows={"group": tables.group_of}), ["g"]),
        (RunsTable("h", []), []),
        (RunsTable("g", across(part(1), LAWS, Column("{}", "e", text="{:.0f}")), rows={}),
         ["1 | 5"]),
        (RunsTable("g", [Column("", "", max, "{:.0f}")], metrics={"first": "q_1", "second": "off"}),
         ["first | inf", "second | inf"]),
    ],
)  # fmt: skip
def test_a_row_is_what_its_keys_give_alike(table: RunsTable, rows: list[str]) -> None:
    assert rows_of(table) == [f"| {row} |" for row in rows]


def test_a_head_names_every_key_then_every_column() -> None:
    table = RunsTable("g", [Column("e", "e")], rows={"label": part(0), "law": part(1)})
    assert table.markdown(results(), tables.nothing).startswith(
        "| label | law | e |\n|---|---|---|"
    )


def test_heads_name_the_values_of_a_key_or_what_they_are_called() -> None:
    heads = [across(part(0), values, Column("x {}", "e")) for values in ((1, 2), {1: "one"})]
    assert [[column.head for column in columns] for columns in heads] == [["x 1", "x 2"], ["x one"]]


def test_expected_figures_stand_in_brackets_or_in_columns_of_their_own() -> None:
    figures = {("g", "pd"): ("0.9",), ("g", "nn"): ("", "7"), ("g",): ("8",)}

    def known(*row: str) -> tuple[str, ...]:
        return figures[row]

    e, off = Column("e", "e", text="{:.0f}"), Column("off", "off", text="{:.0f}")
    beside = RunsTable(("g", "h"), (e, Column("there", 1), off), "Title", BY_LAW)
    sentence = Sentence("g", [off, e], "{}, {} at most\n")
    parts = ("Text", RunsTable("g", (e, off), rows=BY_LAW), beside, sentence, len_text)
    assert page(results(), parts, known) == (
        "Text\n| law | e | off |\n|---|---|---|\n| pd | 1 (0.9) | 0 |\n| nn | 5 | 0 (7) |\n"
        "\nTitle\n\n| law | e | there | off |\n|---|---|---|---|\n| pd | 1 |  | 0 |\n"
        "| nn | 5 | 7 | 0 |\n\n0 (8), 1 at most\n\n10"
    )


def len_text(results: object) -> str:
    """Return how many results there are."""
    assert isinstance(results, list)
    return str(len(results))


@pytest.mark.parametrize("study", studies(), ids=lambda study: study.__name__.split(".")[-3])
def test_every_figure_of_an_independent_implementation_stands_in_a_table(
    study: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = Path(str(study.__file__)).with_name("expected.csv")
    if not file.exists():
        assert not hasattr(study, "known"), "nothing is expected of it"
        return
    asked: set[tuple[str, str]] = set()
    read = study.known

    def known(group: str, *row: object) -> tuple[str, ...]:
        asked.add((group, " ".join(map(str, row))))
        return tuple(read(group, *row))

    ones = defaultdict[str, float](lambda: 1.0)  # a rig's numbers take seconds to read
    monkeypatch.setattr(study, "nominal", lambda: (ones, ones), raising=False)
    monkeypatch.setattr(study, "known", known)
    text = study.report([CaseResult(case, defaultdict(float)) for case in study.cases()])
    with file.open(encoding="utf-8", newline="") as lines:
        for group, row, *cells in csv.reader(lines):
            assert (group, row) in asked, f"{group}, {row}: no table has this row"
            missing = [cell for cell in cells if cell and cell not in text]
            assert not missing, f"{group}, {row}: no table shows {missing}"
