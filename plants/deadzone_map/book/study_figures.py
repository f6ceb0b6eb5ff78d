"""The figures of the study: PD beside the fuzzy precompensator."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pcpc.plants.book.figures import (
    REFERENCE,
    SHADE,
    Traces,
    columns,
    dress,
    legends,
    reference,
    save,
)
from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, PURPLE, VERMILION, Line, Panel
from pcpc.plants.study import CaseResult

NAMES = {"pd": "PD", "fuzzy": "PD and fuzzy precompensator"}


def error(traces: Traces) -> Any:
    """Return the tracking error."""
    return traces["plant:map.x2"] - traces["executive:reference.now"]


STATE = (Line("plant:map.x2", "x2", BLUE, 1.2), reference("executive:reference.now"))
INPUT = (Line("executive:controller.command", "command u", GREEN, 1.0, "steps-post"),)
WIDTHS = (
    Line("executive:controller.d_plus", "learned, positive", GREEN, 1.2),
    Line("executive:controller.d_minus", "learned, negative", PURPLE, 1.2),
)
PANELS = (
    Panel("x2", STATE, 4.0),
    Panel("x2 - reference", (Line(error, "", VERMILION),), 4.0),
    Panel("input", INPUT, 4.0),
    Panel("width", WIDTHS, 3.0),
)


def truth(column: Sequence[Any], result: CaseResult) -> None:
    """Draw the deadzone and its true width."""
    width = result.settings["map.d"]
    column[2].axhspan(-width, width, label="deadzone of u", **SHADE)
    column[3].axhline(width, linewidth=0.9, label="true, both sides", **REFERENCE)


def name(result: CaseResult) -> str:
    """Return the name of a law."""
    return NAMES[result.case.controller]


def draw_beside(pair: Sequence[CaseResult], path: Path) -> None:
    """Draw PD in the left column, the precompensator in the right."""
    width = pair[0].settings["map.d"]
    limits = ((-1.15, 1.6), (-0.55, 0.55), (-0.55, 0.9), (-0.02, 1.4 * width))  # error first -1
    figure, axes = columns(
        pair, PANELS, limits, (11.0, 9.5), name, below=truth, until_s=30.0, left=11.0, sharey="row"
    )
    for ax, result in zip(axes[2], pair, strict=True):
        t, tau = result.traces["t"], result.traces["plant:map.tau"]
        begin = t - (t[1] - t[0])  # the plant's sample of t tells the input of the step before it
        label = "behind the deadzone"
        ax.step(begin, tau, where="post", color=BLACK, linewidth=0.9, label=label)
    axes[3, 0].text(15.0, 0.5 * width, "PD learns no width", ha="center", color=GREY)
    dress(axes.flat)
    legends(axes[:3, 1])
    legends(axes[3:, 1], loc="lower right")
    save(figure, path, f"Second-order map behind a deadzone of half width {width:g}", 13)
