"""What judges and draws a run of the pendulum behind backlash.

    e1 = q - q_d, e2 = q' - q_d'        from the plant's true state                          (1)
    tt = tau_d - tau                    desired against true torque behind the gap           (2)
    settled_s                           last time of the run with |e1| > 0.01 rad            (3)

Contract: plants/evaluation.py. rad, rad/s, N m, s.
"""

import numpy as np

from pcpc.plants.evaluation import *

SETTLED_RAD = 0.01


def rate_error(run: Run) -> Vector:
    """Return e2 of (1). Shape (n,)."""
    return run["plant:pendulum.rate_rad_s"] - run["executive:reference.q_d_rate_rad_s"]


def torque_error(run: Run) -> Vector:
    """Return tt of (2); NaN for a law without tau_d. Shape (n,)."""
    return run.get("executive:controller.tau_d_Nm") - run["plant:pendulum.torque_Nm"]


def unsettled_s(run: Run) -> Vector:
    """Return the times with |e1| > 0.01 rad, NaN else. Shape (n,)."""
    return np.where(np.abs(run["error_rad"]) > SETTLED_RAD, run.t_s, np.nan)


ANGLE, ANGLE_D = "plant:pendulum.q_rad", "executive:reference.q_d_rad"
NORM_W = "executive:controller.norm_w"
EVALUATION = Evaluation(
    signals={
        "error_rad": lambda run: run[ANGLE] - run[ANGLE_D],  # (1)
        "rate_error_rad_s": rate_error,
        "torque_error_Nm": torque_error,
    },
    merits={
        "error_rms_rad": Rms("error_rad", EACH),
        "error_max_rad": Peak("error_rad"),
        "rate_error_rms_rad_s": Rms("rate_error_rad_s"),
        "torque_error_rms_Nm": Rms("torque_error_Nm"),
        "command_max_Nm": Peak("executive:controller.command_Nm", RUN),
        "settled_s": Highest(unsettled_s, RUN),
        "norm_w_max": Peak(NORM_W, RUN),
        "norm_w_end": Last(NORM_W, RUN),
        "diverged": Peak("executive:controller.diverged", RUN),
    },
    panels=(
        Panel(
            "angle [rad]",
            (Line(ANGLE_D, "desired", BLACK, 1.6, "--"), Line(ANGLE, "true", BLUE)),
        ),
        Panel("error [rad]", (Line(started("error_rad"), "q - q_d from 0.5 s on", VERMILION),)),
        Panel(
            "torque [N m]",
            (
                Line("plant:pendulum.acting_Nm", "command before the gap", GREY),
                Line("executive:controller.tau_d_Nm", "desired", BLACK, 1.6, "--"),
                Line("plant:pendulum.torque_Nm", "behind the gap", BLUE),
            ),
            6.0,
        ),
        Panel(
            "torque error [N m]",
            (Line(started("torque_error_Nm"), "desired - true from 0.5 s on", VERMILION),),
        ),
        Panel(
            "terms of u' [N m/s]",
            tuple(
                Line(started(f"executive:controller.{n}_Nm_s"), f"{n} from 0.5 s on", colour)
                for n, colour in (("robust", ORANGE), ("network", GREEN))
            ),
        ),
        Panel(
            "weights",
            (Line(NORM_W, "|W|", GREEN), Line("executive:controller.norm_v", "|V|", PURPLE)),
            4.0,
        ),
    ),
    notes=(
        (
            "error rms {error_rms_rad:.5f} rad, largest {error_max_rad:.5f} rad",
            "torque error rms {torque_error_rms_Nm:.3f} N m",
        ),
        (
            "largest command {command_max_Nm:.1f} N m",
            "|e| above 0.01 rad for the last time at {settled_s:.2f} s",
        ),
    ),
)
