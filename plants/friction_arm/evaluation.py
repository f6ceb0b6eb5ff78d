"""What judges and draws a run of the two-link arm: errors, torques and their variation.

    e_j = q_d,j - q_j, from the true angles                                                  (1)
    error_abs_mean_j     time mean of |e_j| over the window; `early_...`: over the early window  (2)
    error_rms_j      root mean square;   error_max_j   largest |e_j|, of the window          (3)
    overshoot_j      largest q_j - q_d,j of the whole run                                    (4)
    torque_peak      largest |tau| of both joints, whole run                                 (5)
    torque_variation sum over both joints and the run of |tau_k - tau_k-1|, per second,
                     from tau = 0 on: what chatter costs                                     (6)

tau is the torque that acts, rounded and limited. rad, N m, N m/s. (2) is for constant references,
(3) for moving ones; both are always given. The definitions are this project's. Contract:
plants/evaluation.py.
"""

import numpy as np

from pcpc.plants.evaluation import *
from pcpc.plants.families.two_link.joints import JOINTS, angles, each, error, lines, torque_size

GAIN = "executive:controller.tuning_gain_Nms_rad"
TORQUE = "plant:arm.acting_{}_Nm"


def size(run: Run, joint: int) -> Vector:
    """Return |e_j|. Shape (n,)."""
    return np.abs(error(run, joint))


def excess(run: Run, joint: int) -> Vector:
    """Return q_j - q_d,j. Shape (n,)."""
    return -error(run, joint)


def change(run: Run, joint: int) -> Vector:
    """Return |tau_k - tau_k-1|. Shape (n,)."""
    return np.abs(run.step(run[TORQUE.format(joint)]))


def torque_variation(judged: Judged) -> float:
    """Return (6)."""
    asked = {f"joint_{j}": Total(each(change, j), RUN) for j in JOINTS}
    found = judged.measured({"cycles": Count(lambda run: run.t_s, RUN), **asked})
    return sum(found[name] for name in asked) / (found["cycles"] * judged.period_s)


EVALUATION = Evaluation(
    signals={f"error_{j}_rad": each(error, j) for j in JOINTS},
    merits={
        "tuning_gain_median_Nms_rad": Median(GAIN, RUN),
        "tuning_gain_max_Nms_rad": Peak(GAIN, RUN),
        **{f"error_abs_mean_{j}_rad": Mean(each(size, j)) for j in JOINTS},
        **{f"early_error_abs_mean_{j}_rad": Mean(each(size, j), "early") for j in JOINTS},
        **{f"error_rms_{j}_rad": Rms(f"error_{j}_rad") for j in JOINTS},
        **{f"error_max_{j}_rad": Peak(f"error_{j}_rad") for j in JOINTS},
        **{f"overshoot_{j}_rad": Highest(each(excess, j), RUN) for j in JOINTS},
        "torque_peak_Nm": Peak(torque_size, RUN),
        "torque_variation_Nm_s": torque_variation,
    },
    panels=(
        angles(),
        Panel("error [rad]", lines("error_{}_rad", "error {}", 1.1), 6.0),
        Panel("torque [N m]", lines(TORQUE, "torque {}"), 6.0),
        Panel("friction [N m]", lines("plant:arm.friction_{}_Nm", "friction {}")),
        Panel(
            "network [N m]",
            lines("executive:controller.network_{}_Nm", "network {}"),
            when=lambda run: run.has("executive:controller.norm_z"),
        ),
        Panel(
            "norm",
            (Line("executive:controller.norm_z", "norm of all weights", GREEN),),
            3.0,
            when=lambda run: run.has("executive:controller.norm_z"),
        ),
    ),
    notes=(
        (
            "mean |error| {error_abs_mean_1_rad:.4f} / {error_abs_mean_2_rad:.4f} rad",
            "rms {error_rms_1_rad:.4f} / {error_rms_2_rad:.4f}",
            "largest {error_max_1_rad:.4f} / {error_max_2_rad:.4f}",
        ),
        (
            "overshoot {overshoot_1_rad:.4f} / {overshoot_2_rad:.4f}",
            "torque peak {torque_peak_Nm:.0f} N m, variation {torque_variation_Nm_s:.0f} N m/s",
        ),
    ),
)
