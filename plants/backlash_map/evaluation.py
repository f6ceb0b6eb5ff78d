"""What judges and draws a run of the map behind backlash.

    e  = x2 - x_d                       from the plant's true state                          (1)
    tt = tau_d - tau                    desired torque against the true one of the same step (2)
    du = |u(k+1) - u(k)|                jumps of the command                                 (3)
    settled_s     last time with |e| > 0.05, of the run; settled_early_s: of it before the
                  early window's end                                                         (4)
    error_half_max   largest |e| from 0.5 s to the early window's end                        (5)

Contract: plants/evaluation.py. Without units, but s. With `ahead` 0 the plant's record of cycle k+1
holds the tau that answers the tau_d of cycle k.
"""

import numpy as np

from pcpc.plants.evaluation import *

SETTLED = 0.05
JUMP = 0.3
HALF_S = 0.5


def tau_error(run: Run) -> Vector:
    """Return tt of (2). Shape (n,)."""
    tau, ahead = run["plant:map.tau"], run["executive:controller.ahead"]
    return run["executive:controller.tau_d"] - np.where(ahead > 0.5, tau, run.after(tau))


def is_jump(run: Run) -> Vector:
    """Return 1 where the command jumps by more than `JUMP`, else 0; NaN where nothing is known.

    Shape (n,).
    """
    return np.where(np.isfinite(run["jump"]), run["jump"] > JUMP, np.nan)


def unsettled_s(run: Run) -> Vector:
    """Return the times with |e| beyond 0.05, NaN else. Shape (n,)."""
    return np.where(np.abs(run["error"]) > SETTLED, run.t_s, np.nan)


def early(run: Run, source: str, from_s: float) -> Vector:
    """Return a source from `from_s` to the end of the early window, NaN else. Its values: (n,)."""
    inside = (run.t_s >= from_s) & (run.t_s < run.windows["early"][1])
    return np.where(inside, run[source], np.nan)


EVALUATION = Evaluation(
    signals={
        "error": lambda run: run["plant:map.x2"] - run["executive:reference.now"],  # (1)
        "tau_error": tau_error,
        "jump": lambda run: np.abs(run.step(run["executive:controller.command"])),  # (3)
        "unsettled_s": unsettled_s,
    },
    merits={
        "error_rms": Rms("error", EACH),
        "error_max": Peak("error", EACH),
        "tau_error_rms": Rms("tau_error"),
        "x2_max": Peak("plant:map.x2", RUN),
        "command_max": Peak("executive:controller.command", RUN),
        "command_jump_median": Median("jump", RUN),
        "command_jumps_share": Mean(is_jump, RUN),
        "settled_s": Highest("unsettled_s", RUN),
        "diverged": Peak("executive:controller.diverged", RUN),
        "error_half_max": Peak(lambda run: early(run, "error", HALF_S), RUN, needs="early"),
        "settled_early_s": Highest(lambda run: early(run, "unsettled_s", 0.0), RUN, needs="early"),
    },
    panels=(
        Panel(
            "state",
            (
                Line("executive:reference.now", "x_d", BLACK, 1.6, "--"),
                Line("plant:map.x2", "x2", BLUE),
            ),
            6.0,
        ),
        Panel("error x2 - x_d", (Line(started("error"), "from 0.5 s on", VERMILION),)),
        Panel("command u", (Line("plant:map.acting", "before the gap", GREY, 0.7),)),
        Panel(
            "tau",
            (
                Line("plant:map.tau", "behind the gap", BLUE),
                Line("executive:controller.tau_d", "desired", BLACK, 1.2, "--"),
            ),
            6.0,
        ),
        Panel(
            "tau error",
            (Line(started("tau_error"), "desired - true from 0.5 s on", VERMILION, 0.7),),
        ),
        Panel("weights", (Line("executive:controller.norm_w", "|W|", GREEN),), 4.0),
    ),
    notes=(
        (
            "error rms {error_rms:.4f}, largest {error_max:.4f}",
            "|e| above 0.05 for the last time at {settled_s:.2f} s",
        ),
        (
            "jumps of u: median {command_jump_median:.2f}",
            f"beyond {JUMP:g} in {{command_jumps_share:.0%}} of the steps",
        ),
    ),
)
