"""What judges and draws a run of the arm: errors of both joints against the plant's true angles.

    e_i = q_d,i - q_i                             true, not as measured                      (1)
    error_bias_i: mean of e_i over the window                                                (2)
    settle_i_s: time until |e_i| <= SETTLED_RAD to the end, inf: never                       (3)
    overshoot_i: largest q_i - q_d,i of the run, past a step to a positive angle             (4)

(3) and (4) where the rig gives `step_rad`, the size of a step. Contract: plants/evaluation.py.
rad, N m, s.
"""

import math

import numpy as np

from pcpc.plants.evaluation import *
from pcpc.plants.families.two_link.joints import JOINTS, each

SETTLED_RAD = 0.02
STEP = "step_rad"  # a number of the rig
COMMAND = "executive:controller.torque_{}_Nm"


def error(run: Run, joint: int) -> Vector:
    """Return (1) by executive cycle, NaN without the plant's record. Shape (n,)."""
    q = run[f"plant:arm.q_{joint}_rad"]
    return run[f"executive:reference_{joint}.q_d_rad"] - q


def excess(run: Run, joint: int) -> Vector:
    """Return q_i - q_d,i. Shape (n,)."""
    return -error(run, joint)


def command_step(run: Run, joint: int) -> Vector:
    """Return the change of a joint's command. Shape (n,)."""
    return run.step(run.get(COMMAND.format(joint)))


def size(run: Run, *names: str) -> Vector:
    """Return the norm of two variables of the controller. Shape (n,)."""
    return np.hypot(*(run.get(f"executive:controller.{name}") for name in names))


def settling_text(metrics: Figures, joint: int) -> str:
    """Return what the title says of a joint's settling."""
    after_s = metrics.get(f"settle_{joint}_s", math.nan)
    if math.isnan(after_s):
        return ""
    within = f"within {SETTLED_RAD:g} rad after {after_s:.3g} s"
    return f"joint {joint} {within if after_s < math.inf else 'not settled'}"


def torques(joint: int) -> Panel:
    """Return what a joint's command is made of, and what of it arrives."""
    return Panel(
        f"joint {joint} [N m]",
        (
            Line(COMMAND.format(joint), "command", GREY, 0.7),
            Line(f"executive:controller.y_{joint}_Nm", "of it the compensator", GREEN, 0.7),
            Line(f"plant:arm.acting_{joint}_Nm", "torque behind the deadzone", BLACK, 0.9),
        ),
    )


EVALUATION = Evaluation(
    signals={f"error_{j}_rad": each(error, j) for j in JOINTS},
    merits={
        **{f"error_rms_{j}_rad": Rms(f"error_{j}_rad", EACH) for j in JOINTS},
        **{f"error_max_{j}_rad": Peak(f"error_{j}_rad") for j in JOINTS},
        **{f"error_bias_{j}_rad": Mean(f"error_{j}_rad") for j in JOINTS},
        **{f"command_rms_{j}_Nm": Rms(COMMAND.format(j)) for j in JOINTS},
        **{f"command_step_rms_{j}_Nm": Rms(each(command_step, j)) for j in JOINTS},
        **{f"settle_{j}_s": settling(f"error_{j}_rad", SETTLED_RAD, needs=STEP) for j in JOINTS},
        **{f"overshoot_{j}_rad": Highest(each(excess, j), RUN, needs=STEP) for j in JOINTS},
        "r_max_rad_s": Peak(lambda run: size(run, "r_1_rad_s", "r_2_rad_s"), RUN),
        "norm_max": Peak(lambda run: size(run, "norm_wi", "norm_w"), RUN),
        "diverged": Highest("executive:controller.diverged", RUN),
    },
    numbers=(STEP,),
    panels=(
        Panel(
            "angle [rad]",
            (
                Line("plant:arm.q_1_rad", "joint 1", BLUE),
                Line("plant:arm.q_2_rad", "joint 2", VERMILION),
                Line("executive:reference_1.q_d_rad", "reference of both", BLACK, 0.9, "--"),
            ),
        ),
        Panel(
            "error [rad]",
            (Line("error_1_rad", "joint 1", BLUE), Line("error_2_rad", "joint 2", VERMILION)),
            6.0,
        ),
        *map(torques, JOINTS),
    ),
    notes=(
        [f"joint {j}: {{error_rms_{j}_rad:.2g}} rad rms" for j in JOINTS],
        [
            lambda metrics: settling_text(metrics, 1),
            lambda metrics: settling_text(metrics, 2),
            diverged,
        ],
    ),
)
