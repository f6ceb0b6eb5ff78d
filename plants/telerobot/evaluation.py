"""What judges and draws a run of the telerobot: errors against the reference of T ago, torques.

    e_i = q_d,i(t - T) - q_i(t), from the true angles                                        (1)
    error_rms_i     root mean square over the window; NAME_...: over the further window NAME,
                    `late_...`: from the window's end on                                     (2)
    error_max_i     largest |e_i| of the window                                              (3)
    torque_peak     largest |tau| of both joints, whole run                                  (4)
    norm_w_low/high least and largest |W| of the identifier; `late_...` as in (2)            (5)
    held_u, held_x  ticks of the run in which no u, no x was there at its play-out           (6)
    tripped_s       when a joint was too fast; absent where none was                         (7)

rad, N m, s. The definitions are this project's. Contract: plants/evaluation.py.
"""

import numpy as np

from pcpc.plants.evaluation import *
from pcpc.plants.families.two_link.joints import JOINTS, each, lines, torque_size


def error(run: Run, joint: int) -> Vector:
    """Return e_i (1), rad. Shape (n,)."""
    return run[f"executive:controller.aim_{joint}_rad"] - run[f"plant:arm.q_{joint}_rad"]


def tripped_s(run: Run) -> Vector:
    """Return the times after a joint was too fast, NaN else. Shape (n,)."""
    return np.where(run["local:servo.tripped"] > 0.5, run.t_s, np.nan)


NORM_W, HELD_U, HELD_X = "local:servo.norm_w", "local:servo.held_u", "executive:controller.held_x"
AIMS = [
    Line(f"executive:controller.aim_{j}_rad", f"wanted {j}, T ago", BLACK, 0.9, style)
    for j, style in ((1, "--"), (2, ":"))
]
EVALUATION = Evaluation(
    signals={f"error_{j}_rad": each(error, j) for j in JOINTS},
    merits={
        **{f"error_rms_{j}_rad": Rms(f"error_{j}_rad", EACH) for j in JOINTS},
        **{f"late_error_rms_{j}_rad": Rms(f"error_{j}_rad", LATE) for j in JOINTS},
        **{f"error_max_{j}_rad": Peak(f"error_{j}_rad") for j in JOINTS},
        "norm_w_low": Lowest(NORM_W),
        "norm_w_high": Highest(NORM_W),
        "late_norm_w_low": Lowest(NORM_W, LATE),
        "late_norm_w_high": Highest(NORM_W, LATE),
        "held_u": Highest(HELD_U, RUN),
        "held_x": Highest(HELD_X, RUN),
        "tripped_s": Lowest(tripped_s, RUN),
        "torque_peak_Nm": Peak(torque_size, RUN),
    },
    panels=(
        Panel("angle [rad]", (*AIMS, *lines("plant:arm.q_{}_rad", "joint {}", 1.1))),
        Panel("error [rad]", lines("error_{}_rad", "error {}", 1.1), 6.0),
        Panel("x(t-T) - z(t-2T) [rad]", lines("executive:controller.off_{}_rad", "joint {}", 0.8)),
        Panel("torque [N m]", lines("plant:arm.acting_{}_Nm", "torque {}")),
        Panel("network [rad/s2]", lines("local:servo.network_{}_rad_s2", "network {}", 0.8)),
        Panel(
            "held ticks",
            (
                Line(HELD_U, "u not there in time", GREEN),
                Line(HELD_X, "x not there in time", VERMILION),
            ),
            3.0,
        ),
    ),
    notes=(
        (
            "rms error {error_rms_1_rad:.4f} / {error_rms_2_rad:.4f} rad",
            "largest {error_max_1_rad:.4f} / {error_max_2_rad:.4f}",
            "tripped at {tripped_s:.2f} s",
        ),
        (
            "torque peak {torque_peak_Nm:.0f} N m",
            "held: u {held_u:.0f}, x {held_x:.0f} ticks",
        ),
    ),
)
