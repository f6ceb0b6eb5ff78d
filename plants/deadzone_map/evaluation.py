"""What judges and draws a run of the map: its error against the reference, the widths learned.

    e(k) = x2(k) - xd(k)                          true, not as measured                      (1)

Contract: plants/evaluation.py. Without units; s.
"""

import numpy as np

from pcpc.plants.evaluation import *


def true_width(run: Run) -> Vector:
    """Return the deadzone's width where a law learns it, NaN else. Shape (n,)."""
    learned = run.get("executive:controller.d_plus")
    return np.where(np.isfinite(learned), run.setting("d"), learned)


U, D_PLUS, D_MINUS = (f"executive:controller.{name}" for name in ("command", "d_plus", "d_minus"))
EVALUATION = Evaluation(
    signals={
        "error": lambda run: run["plant:map.x2"] - run["executive:reference.now"],  # (1)
        "command_step": lambda run: run.step(run[U]),
        "true_width": true_width,
    },
    merits={
        "error_rms": Rms("error"),
        "error_max": Peak("error"),
        "d_plus": Last(D_PLUS, RUN),
        "d_minus": Last(D_MINUS, RUN),
        "command_rms": Rms(U),
        "command_step_rms": Rms("command_step"),
        "r_max": Peak("executive:controller.r", RUN),
        "diverged": Highest("executive:controller.diverged", RUN),
    },
    panels=(
        Panel(
            "x2",
            (
                Line("plant:map.x2", "x2", BLUE),
                Line("executive:reference.now", "reference", BLACK, 0.9, "--"),
            ),
        ),
        Panel("error", (Line("error", "x2 - reference", VERMILION),), 6.0),
        Panel(
            "input",
            (Line(U, "command", GREY), Line("plant:map.tau", "behind the deadzone", BLACK, 0.9)),
        ),
        Panel(
            "width",
            (
                Line(D_PLUS, "learned, positive side", GREEN),
                Line(D_MINUS, "learned, negative side", PURPLE),
                Line("true_width", "true", BLACK, 0.9, "--"),
            ),
            4.0,
        ),
    ),
    notes=(
        ("error {error_rms:.4f} rms, {error_max:.4f} max",),
        ("widths at the end {d_plus:.3f}, {d_minus:.3f}", diverged),
    ),
)
