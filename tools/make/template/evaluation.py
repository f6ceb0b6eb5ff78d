"""What judges and draws a run of the motor.

    e = q_d - q          reference minus the motor's true angle                               (1)
    overshoot            how far q went beyond q_d                                            (2)
    settled_s            time from the window's begin until |e| stays within 30 mrad          (3)
    rest_error_max_mrad  largest |e| from `rest_from_s` on                                    (4)

What else may stand here: docs/reference/rig-python.md of pcpc. mrad, V, A, s.
"""

from collections.abc import Mapping

import numpy as np

from pcpc.plants.evaluation import (
    BLACK,
    BLUE,
    ORANGE,
    PURPLE,
    RUN,
    VERMILION,
    WINDOW,
    Evaluation,
    Highest,
    Line,
    Panel,
    Peak,
    Rms,
    Run,
    Vector,
    settling,
)

ANGLE, ANGLE_D = "plant:motor.angle_rad", "executive:reference.q_d_rad"
SETTLED_MRAD = 30.0  # 1 % of the step in rig.yaml


def near(run: Run) -> Vector:
    """Return e where it is small, NaN elsewhere: of a step one wants to see the end.

    All of it where it is seldom small, as on a fast sine.
    """
    is_small = np.abs(run["error_mrad"]) <= SETTLED_MRAD
    return np.where(is_small | (np.mean(is_small) < 0.5), run["error_mrad"], np.nan)


def settled(figures: Mapping[str, float]) -> str:
    """Return when the error had become small."""
    after_s = figures.get("settled_s", np.inf)
    if after_s < np.inf:
        return f"within {SETTLED_MRAD:g} mrad after {after_s:.3f} s"
    return f"beyond {SETTLED_MRAD:g} mrad at the end"


EVALUATION = Evaluation(
    signals={
        "error_mrad": lambda run: 1e3 * (run[ANGLE_D] - run[ANGLE]),  # (1)
        "beyond_mrad": lambda run: -run["error_mrad"],
        "near_mrad": near,
    },
    merits={
        "error_rms_mrad": Rms("error_mrad"),
        "overshoot_mrad": Highest("beyond_mrad"),  # (2)
        "settled_s": settling("error_mrad", SETTLED_MRAD, WINDOW),  # (3)
        "rest_error_max_mrad": Peak("error_mrad", "rest"),  # (4)
        "voltage_max_V": Peak("plant:motor.held_V", RUN),
        "current_max_A": Peak("plant:motor.current_A", RUN),
    },
    panels=(
        Panel(
            "angle [rad]",
            (Line(ANGLE_D, "desired", BLACK, 1.6, "--"), Line(ANGLE, "true", BLUE)),
        ),
        Panel("error [mrad]", (Line("near_mrad", "q_d - q, of a step within 30 mrad", VERMILION),)),
        Panel(
            "voltage [V]",
            (Line("plant:motor.held_V", "of the driver", ORANGE),),
        ),
        Panel("current [A]", (Line("plant:motor.current_A", "of the winding", PURPLE),)),
    ),
    notes=(
        ("overshoot {overshoot_mrad:.1f} mrad", settled),
        ("at rest within {rest_error_max_mrad:.2f} mrad", "peak {current_max_A:.1f} A"),
    ),
)
