"""What judges and draws a run of the arm with a payload: errors, torques, norms of the networks.

    e_j = q_d,j - q_j, from the true angles                                                  (1)
    error_rms_j, error_max_j       of the window, NAME_...: of the further window NAME       (2)
    torque_peak                    largest |tau| of both joints, whole run                   (3)
    critic_max, w1_max, w2_max, rho_max    largest |R|, |W1|, |W2|, |rho|, whole run         (4)

tau is the torque that acts, rounded and limited. rad, N m. The definitions are this project's.
Contract: plants/evaluation.py.
"""

import numpy as np

from pcpc.plants.evaluation import *
from pcpc.plants.families.two_link.joints import (
    COLOURS,
    JOINTS,
    angles,
    each,
    error,
    lines,
    torque_size,
)

WEIGHTS = ("w1", "w2", "rho")


def critic_size(run: Run) -> Vector:
    """Return |R|; NaN for a law without it. Shape (n,)."""
    return np.hypot(*(run.get(f"executive:controller.critic_{j}") for j in JOINTS))


def lines_up_to(size: float, name: str, label: str) -> list[Line]:
    """Return lines of both joints without the larger values of a start from 1 rad away."""

    def small_values(run: Run, joint: int) -> Vector:
        values = run[name.format(joint)]
        return np.where(np.abs(values) <= size, values, np.nan)

    return [Line(each(small_values, j), label.format(j), COLOURS[j]) for j in JOINTS]


def learns(run: Run) -> bool:
    """Return whether the controller has an action network."""
    return run.has("executive:controller.norm_w2")


EVALUATION = Evaluation(
    signals={**{f"error_{j}_rad": each(error, j) for j in JOINTS}, "critic": critic_size},
    merits={
        "critic_max": Peak("critic", RUN),
        **{f"error_rms_{j}_rad": Rms(f"error_{j}_rad", EACH) for j in JOINTS},
        **{f"error_max_{j}_rad": Peak(f"error_{j}_rad", EACH) for j in JOINTS},
        **{f"{name}_max": Peak(f"executive:controller.norm_{name}", RUN) for name in WEIGHTS},
        "torque_peak_Nm": Peak(torque_size, RUN),
    },
    panels=(
        angles(1.0),
        Panel("error, to 0.2 rad", lines_up_to(0.2, "error_{}_rad", "error {}"), 6.0),
        Panel("torque, to 100 N m", lines_up_to(100.0, "plant:arm.acting_{}_Nm", "torque {}")),
        Panel("m2 [kg]", (Line("plant:arm.outer_mass_kg", "mass at the end", GREY),), 2.0),
        Panel(
            "acceleration\n[rad/s2]",
            (
                *lines("executive:controller.learned_{}_rad_s2", "action network {}", 1.0),
                *(
                    Line(f"executive:controller.robust_{j}_rad_s2", f"robust term {j}", colour, 0.8)
                    for j, colour in ((1, GREEN), (2, ORANGE))
                ),
            ),
            when=learns,
        ),
        Panel(
            "critic",
            (
                Line("critic", "|R|", PURPLE),
                Line("executive:controller.norm_w1", "|W1|", GREEN),
                Line("executive:controller.norm_rho", "|rho|", ORANGE),
            ),
            when=learns,
        ),
    ),
    notes=(
        (
            "rms error {error_rms_1_rad:.4f} / {error_rms_2_rad:.4f} rad",
            "largest {error_max_1_rad:.4f} / {error_max_2_rad:.4f}",
        ),
        (
            "with the payload {payload_error_rms_1_rad:.4f} / {payload_error_rms_2_rad:.4f} rad",
            "torque peak {torque_peak_Nm:.0f} N m",
        ),
    ),
)
