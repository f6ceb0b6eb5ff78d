"""What judges and draws a run of the map: its error against the reference, the widths learned.

    e(k) = x2(k) - xd(k)                          true, not as measured                      (1)

Windows, and which record of the plant belongs to a cycle: plants/judging.py. Without units; s.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from executive.logs import Log
from plants.judging import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    PURPLE,
    VERMILION,
    Line,
    Panel,
    Run,
    Vector,
    draw_page,
    known,
    over_finite,
    peak,
    rms,
)  # fmt: skip


def error(run: Run) -> Vector:
    """Return (1) by executive cycle, NaN without the plant's record."""
    return run.plant("map.true_x2") - run.executive("reference.now")


def metrics(
    log: Log, window_s: tuple[float, float], numbers: Mapping[str, float], period_s: float
) -> dict[str, float]:
    """Return what the log tells about a run; {} without a cycle in the window."""
    if "executive" not in log.node:
        return {}
    run = Run(log, period_s)
    window = run.between(*window_s)
    if not window.any():
        return {}
    e, u = error(run)[window], run.executive("controller.u")
    return known(
        {
            "e_rms": rms(e),
            "e_max": peak(e),
            "d_plus": float(run.executive("controller.d_plus")[-1]),
            "d_minus": float(run.executive("controller.d_minus")[-1]),
            "u_rms": rms(u[window]),
            "u_step_rms": rms(np.diff(u)[window[1:]]),
            "r_max": peak(run.executive("controller.r")),
            "ended": over_finite(run.executive("controller.diverged"), np.max),
        }
    )


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
    learned = run.executive("controller.d_plus")
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
