"""Lines that fit, columns, and an answer as JSON or in lines."""

import json
import math
from collections.abc import Iterator

import pytest

from pcpc.tools.terminal import screen

LONG = "word " * 14 + "end"  # 73 letters


@pytest.fixture(autouse=True)
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")


@pytest.mark.parametrize(("ahead", "after"), [
    ("", 2), ("  ", 4), ("fit: ", 2), ("run  ", 5), ("bus queue     ", 14), ("  sent     ", 11),
    ("    5.69 %  ", 12), ("V          ", 11), (" " * 15 + "a  ", 18), (" " * 16 + "a  ", 17),
    ("x" * 22 + "  ", 24), ("x" * 23 + "  ", 2), ("gap" + " " * 12, 15), ("gap" + " " * 13, 2),
])  # fmt: skip
def test_a_long_line_goes_on_behind_its_label_or_further_in(ahead: str, after: int) -> None:
    first, *rest = screen.fitted([f"{ahead}{LONG}"])
    assert first.startswith(f"{ahead}word") and rest, first
    assert max(map(len, (first, *rest))) <= 60
    assert [len(line) - len(line.lstrip()) for line in rest] == [after] * len(rest), rest
    assert " ".join([first.removeprefix(ahead), *map(str.strip, rest)]).split() == LONG.split()


@pytest.mark.parametrize("line", ["", "a", "  a  b", "x" * 60, "a   b    c", " " * 30 + "a   b"])
def test_a_line_that_fits_stays_as_it_is(line: str) -> None:
    assert [*screen.fitted([line, line])] == [line, line]


def test_columns_of_numbers_end_below_each_other_also_the_last() -> None:
    rows = [("name", "n", "left"), ("a", "10", "9"), ("bcd ef", "9", "")]
    assert screen.table(rows, right=(1, 2)) == [
        "name     n  left",
        "a       10     9",
        "bcd ef   9",
    ]
    assert screen.table(rows) == ["name    n   left", "a       10  9", "bcd ef  9"]


def test_an_answer_is_json_for_which_no_line_is_made_or_lines(
    capsys: pytest.CaptureFixture[str],
) -> None:
    def lines() -> Iterator[str]:
        yield "made"
        yield f"run  {LONG}"

    def none() -> Iterator[str]:
        raise AssertionError
        yield ""

    screen.answer(True, {"a": [1.5, math.inf], "b": (math.nan, None)}, none())
    assert capsys.readouterr().out == '{"a": [1.5, "inf"], "b": ["nan", null]}\n'
    screen.answer(True, {"a": 1}, none(), 2)
    assert capsys.readouterr().out == json.dumps({"a": 1}, indent=2) + "\n"
    screen.answer(False, {}, lines())
    assert capsys.readouterr().out.splitlines() == ["made", *screen.fitted([f"run  {LONG}"])]


def test_a_list_that_is_cut_counts_what_is_left_out() -> None:
    assert screen.some(["a", "b"], 2) == ["a", "b"]
    assert screen.some(["a", "b", "c"], 2) == ["a", "b", "and 1 more, see --json"]


def test_a_command_goes_on_where_its_line_is_full() -> None:
    first, second = "x" * 28, "y" * 27  # with a blank 56, behind two more and before a mark
    assert screen.shell(f"{first} {second}") == [f"  {first} {second}"]
    assert screen.shell(f"{first} {second}y z") == [f"  {first} \\", f"    {second}y z"]
