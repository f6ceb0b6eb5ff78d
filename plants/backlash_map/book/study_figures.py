"""The figures of the map's study: laws side by side, and the command from step to step."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.plants.book.figures import (
    Traces,
    columns,
    dress,
    legends,
    name_rows,
    reference,
    save,
)
from pcpc.plants.book.tables import label_of
from pcpc.plants.pages import BLUE, GREEN, GREY, ORANGE, VERMILION, Line, Panel
from pcpc.plants.study import CaseResult

NAMES = {
    "pd without gap": "PD, no gap",
    "pd": "PD",
    "nn_sigmoid": "network, smooth nodes only",
    "nn": "network with jump nodes",
}
COLOURS = {"pd without gap": GREEN, "pd": VERMILION, "nn_sigmoid": ORANGE, "nn": BLUE}
STATE = (
    reference("executive:reference.now", "$x_d$", 1.4), Line("plant:map.x2", "$x_2$", "", 1.0)
)  # fmt: skip


ENDS_MS = {
    "the start, from 1 away": (0.0, 100.0),
    "900 ms later: u jumps across the gap, tau does not see it": (900.0, 940.0),
}


def error_from_half_a_second(traces: Traces) -> Any:
    """Return the error, which is nan before."""
    error = traces["plant:map.x2"] - traces["executive:reference.now"]
    return np.where(traces["t"] < 0.5, np.nan, error)


PANELS = (
    Panel("state (no unit)", STATE),
    Panel("error $x_2 - x_d$ from 0.5 s on", (Line(error_from_half_a_second, "", "", 0.8),)),
    Panel(
        "tau (no unit)",
        (
            reference("executive:controller.tau_d", "desired", 1.4),
            Line("plant:map.tau", "behind the gap", "", 0.8),
        ),
    ),
)
STEPS = (
    Panel("state (no unit)", (reference("executive:reference.now", "$x_d$", 1.5), STATE[1])),
    Panel(
        "u and tau (no unit)",
        (
            Line("plant:map.acting", "command u", GREY, 0.6, "o-"),
            Line("plant:map.tau", "tau", BLUE, 0.6, "o-"),
        ),
    ),
)


def title(result: CaseResult) -> str:
    """Return the name of a law, and its errors."""
    rms, largest = result.metric("error_rms"), result.metric("error_max")
    return f"{NAMES[result.case.label]}\n10 to 20 s: rms {rms:.4f}, max {largest:.3f}"


def draw_laws(results: Sequence[CaseResult], path: Path) -> None:
    """Draw state, error and tau, a column a law; the errors' scales differ."""
    limits = ((-1.2, 1.9), None, (-0.15, 0.22))
    made, axes = columns(results, PANELS, limits, (13.0, 7.2), title, COLOURS, until_s=20.0)
    legends(axes.flat, ncols=2)
    dress(axes.flat, 8)
    save(made, path)


def draw_steps(result: CaseResult, path: Path) -> None:
    """Draw the violent start, and 40 steps of the command long after it, each step a mark."""
    t_ms, runs = 1e3 * result.traces["t"], []
    for text, (begin, end) in ENDS_MS.items():
        near = (t_ms >= begin) & (t_ms <= end)
        traces = {name: values[near] for name, values in {**result.traces, "t": t_ms}.items()}
        runs.append(replace(result, traces=traces, case=replace(result.case, label=text)))
    made, axes = columns(
        runs, STEPS, (None, None), (10.0, 6.4), label_of, COLOURS, sharex="col",
        markersize=2.5,
    )  # fmt: skip
    legends(axes.flat, ncols=2)
    axes[0, 1].set_ylim(-0.2, 1.4)
    axes[1, 1].set_ylim(-0.1, 0.55)
    name_rows(axes, [panel.label for panel in STEPS], "time [ms]; a step is 1 ms")
    dress(axes.flat, 8)
    save(made, path)
