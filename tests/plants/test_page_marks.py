"""What a run's page shows of violations, of fast references and of what never came."""

import math

import numpy as np
import pytest
from matplotlib.figure import Figure

from pcpc.plants import pages
from pcpc.plants.evaluation import Evaluation, Figures


@pytest.mark.parametrize("count", [1, 2, 5])
def test_names_of_violations_stand_above_the_curves_and_below_the_title(count: int) -> None:
    page, axes = pages.new_page([5.0, 3.0], "a title", "two\nlines")
    axes[0].plot([0.0, 1.0], [0.0, 1.0], label="a line")
    pages.dress(axes[0], (0.0, 1.0))
    pages.mark_violations(axes, [(0.1 * i, f"number {i}") for i in range(count)], 1.0)
    page.draw_without_rendering()
    boxes = [text.get_window_extent() for text in axes[0].texts]
    legend = axes[0].get_legend().get_window_extent()
    above = max(axes[0].get_window_extent().y1, legend.y1)
    below = min(text.get_window_extent().y0 for text in page.texts)
    assert len(boxes) == count and all(above <= box.y0 < box.y1 <= below for box in boxes), boxes
    assert not any(one.overlaps(other) for one in boxes for other in boxes if one is not other)


@pytest.mark.parametrize(("turns", "style"), [(20, "--"), (600, "-")])
def test_a_fast_dashed_line_makes_no_block(turns: int, style: str) -> None:
    ax = Figure().subplots()
    t = np.linspace(0.0, 1.0, 20_000)
    pages.draw_line(ax, t, np.sin(math.pi * turns * t), "desired", "k", linestyle="--")
    (line,) = ax.lines
    assert line.get_linestyle() == style and (line.get_alpha() or 1.0) == (0.4, 1.0)[style == "--"]


@pytest.mark.parametrize(
    ("value", "told"),
    [(0.25, "within 30 mrad after 0.25 s"), (math.inf, "settled_s is infinite")],
)
def test_what_never_came_has_no_time(value: float, told: str) -> None:
    note = "within 30 mrad after {settled_s:g} s"
    found = Evaluation(merits={"settled_s": lambda judged: value}, notes=((note,), ()))
    metrics: Figures = {"settled_s": value}
    assert found._told(note, metrics) == told
    assert found._told(note, {}) == ""
