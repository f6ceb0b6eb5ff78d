"""What judges and draws a run of the map: its error against the reference, the widths learned.

    e(k) = x2(k) - xd(k)                          true, not as measured                      (1)

Windows, and which record of the plant belongs to a cycle: plants/judging.py. Without units; s.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pcpc.executive.log.reader import Log
from pcpc.plants.judging import Measure, Run, Signal, Vector, known, measured, reaches
from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, PURPLE, VERMILION, Line, Panel, draw_page
from pcpc.plants.statistics import HIGH, LAST, PEAK, RMS


def error(run: Run) -> Vector:
    """Return (1) by executive cycle, NaN without the plant's record."""
    return run.plant("map.true_x2") - run.executive("reference.now")


def metrics(
    log: Log, window_s: tuple[float, float], numbers: Mapping[str, float], period_s: float
) -> dict[str, float]:
    """Return what the log tells about a run; {} without a cycle in the window."""
    if not reaches(log, period_s, window_s, "executive"):
        return {}
    measures = {
        "e_rms": Measure(error, RMS, window_s),
        "e_max": Measure(error, PEAK, window_s),
        "d_plus": Measure(_variable("controller.d_plus"), LAST),
        "d_minus": Measure(_variable("controller.d_minus"), LAST),
        "u_rms": Measure(_variable("controller.u"), RMS, window_s),
        "u_step_rms": Measure(lambda run: run.step(run.executive("controller.u")), RMS, window_s),
        "r_max": Measure(_variable("controller.r"), PEAK),
        "ended": Measure(_variable("controller.diverged"), HIGH),
    }
    return known(measured(log, period_s, measures))


def _variable(name: str) -> Signal:
    return lambda run: run.executive(name, or_nan=True)


def figure(
    log: Log, path: Path, title: str, metrics: Mapping[str, float], window_s: tuple[float, float]
) -> None:
    """Write one PNG: state, error, command, widths; ImportError without matplotlib."""
    panels = (
        Panel(
            "x2",
            (
                Line("plant:map.true_x2", "x2", BLUE),
                Line("executive:reference.now", "reference", BLACK, 0.9, "--"),
            ),
        ),
        Panel("error", (Line(error, "x2 - reference", VERMILION),), 6.0),
        Panel(
            "input",
            (
                Line("executive:controller.u", "command", GREY),
                Line("plant:map.tau", "behind the deadzone", BLACK, 0.9),
            ),
        ),
        Panel(
            "width",
            (
                Line("executive:controller.d_plus", "learned, positive side", GREEN),
                Line("executive:controller.d_minus", "learned, negative side", PURPLE),
                Line(_true_width, "true", BLACK, 0.9, "--"),
            ),
            4.0,
        ),
    )
    draw_page(log, path, title, summary(metrics, window_s), window_s, panels)


def _true_width(run: Run) -> Vector:
    learned = run.executive("controller.d_plus", or_nan=True)
    return np.where(np.isfinite(learned), run.setting("d"), learned)


def summary(metrics: Mapping[str, float], window_s: tuple[float, float]) -> str:
    """Return the two lines under the title; what is not known is left out."""
    first, second = [], [f"shaded {window_s[0]:g} to {window_s[1]:g} s"]
    if "e_rms" in metrics:
        first.append(f"error {metrics['e_rms']:.4f} rms, {metrics['e_max']:.4f} max")
    if "d_plus" in metrics:
        second.append(f"widths at the end {metrics['d_plus']:.3f}, {metrics['d_minus']:.3f}")
    if metrics.get("ended"):
        second.append("DIVERGED: control ended")
    return "   ·   ".join(first) + "\n" + "   ·   ".join(second)
