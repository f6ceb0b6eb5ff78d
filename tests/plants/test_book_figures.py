"""The figures of the studies: columns of runs, rows of panels, lines as they are declared."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.text import Text

from pcpc.plants.book.figures import columns, draw_lines, legends, overlay, reference, save, times
from pcpc.plants.pages import Line, Panel, sheet
from pcpc.plants.study import Case, CaseResult

T_S = np.linspace(0.0, 2.0, 5)


def result(law: str, label: str = "") -> CaseResult:
    """Return a run with two traces."""
    case = Case("g", f"rigs/{law}.yaml", law, label)
    return CaseResult(case, {}, {"t": T_S, "a": T_S + 1.0, "b": -T_S})


def lines_of(ax: Any) -> list[tuple[str, str, str, str, float, str, list[float]]]:
    """Return what is drawn into axes."""
    return [
        (one.get_label().removeprefix("_child0"), one.get_color(), one.get_linestyle(),
         one.get_drawstyle(), one.get_linewidth(), one.get_marker(), list(one.get_ydata()))
        for one in ax.lines
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("line", "drawn"),
    [
        (Line("a", "name", "red", 0.7), ("name", "red", "-", "default", 0.7, "None", T_S + 1)),
        (Line("a", "name", "", 0.7), ("name", "blue", "-", "default", 0.7, "None", T_S + 1)),
        (Line(times(1e3, "b"), "", "red"), ("", "red", "-", "default", 1.1, "None", -1e3 * T_S)),
        (reference("b"), ("reference", "#000000", "--", "default", 0.9, "None", -T_S)),
        (reference("b", "x", 2.0), ("x", "#000000", "--", "default", 2.0, "None", -T_S)),
        (Line("a", "u", "red", 1.0, "steps-post"),
         ("u", "red", "-", "steps-post", 1.0, "None", T_S + 1)),
        (Line("a", "u", "red", 1.0, "o-"), ("u", "red", "-", "default", 1.0, "o", T_S + 1)),
    ],
)  # fmt: skip
def test_a_line_is_drawn_as_it_is_declared(line: Line, drawn: tuple[Any, ...]) -> None:
    _, ax = sheet((2.0, 2.0), 50)
    draw_lines(ax, [line, Line("none", "not of this run")], result("pd").traces, color="blue")
    *look, values = drawn
    assert lines_of(ax) == [(*look, list(values))]


def test_runs_over_each_other_have_their_controller_s_colour_and_name() -> None:
    _, ax = sheet((2.0, 2.0), 50)
    runs = [result("pd"), result("nn"), result("not drawn")]
    overlay(ax, runs, "a", {"pd": "red", "nn": "blue"}, 0.5)
    overlay(ax, runs, "b", {"nn": "blue"}, 0.5, {"nn": "network"})
    assert [line[:2] for line in lines_of(ax)] == [
        ("pd", "red"), ("nn", "blue"), ("network", "blue"),
    ]  # fmt: skip


def test_a_column_is_a_run_and_a_row_a_panel(tmp_path: Path) -> None:
    panels = (Panel("above", (Line("a", "a", ""),), 10.0), Panel("below", (Line("b", "", "k"),)))
    below: list[tuple[int, str]] = []
    figure, axes = columns(
        [result("pd"), result("nn", "own")],
        panels,
        (None, (-3.0, 4.0)),
        (4.0, 4.0),
        lambda run: f"title of {run.case.controller}",
        {"pd": "red", "nn": "blue", "own": "green"},
        lambda column, run: below.append((len(column[0].lines), run.case.controller)),
        until_s=2.0,
        left=9.0,
        dpi=50,
        markersize=3.0,
    )
    assert below == [(0, "pd"), (0, "nn")], "before the lines"
    assert [ax.get_title(loc="left") for ax in axes[0]] == ["title of pd", "title of nn"]
    assert [ax.lines[0].get_color() for ax in axes[0]] == ["red", "green"], "a label comes first"
    assert {ax.lines[0].get_markersize() for ax in axes.flat} == {3.0}
    assert [ax.get_ylabel() for ax in axes[:, 0]] == ["above", "below"]
    assert [ax.get_xlabel() for ax in axes.flat] == ["", "", "time [s]", "time [s]"]
    assert {ax.get_ylim() for ax in axes[1]} == {(-3.0, 4.0)} and axes[0, 0].get_ylim()[0] > 0.0
    assert {ax.get_xlim() for ax in axes.flat} == {(0.0, 2.0)}
    (title,) = axes[0, 0].findobj(lambda one: isinstance(one, Text) and "of pd" in one.get_text())
    assert title.get_fontsize() == 9.0
    legends(axes.flat, fontsize=6.0)
    assert axes[0, 0].get_legend().get_texts()[0].get_fontsize() == 6.0
    assert [ax.get_legend() is not None for ax in axes.flat] == [True, True, False, False]
    save(figure, tmp_path / "figure.png", "all", 13)
    assert (tmp_path / "figure.png").stat().st_size > 1000
    assert figure.get_suptitle() == "all"
    first, second = (axes[row, 0].get_position().height for row in (0, 1))
    assert first > 1.3 * second, f"{first:.2f}, {second:.2f}: heights of the panels"


def test_a_title_stands_in_the_middle_unless_it_is_put_left() -> None:
    _, axes = columns([result("pd")], [Panel("", ())], [None], (2.0, 2.0), lambda run: "middle")
    assert axes[0, 0].get_title() == "middle" and axes[0, 0].title.get_fontsize() == 10.0
