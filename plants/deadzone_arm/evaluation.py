"""What judges and draws a run of the arm: errors of both joints against the plant's true angles.

    e_i = q_d,i - q_i                             true, not as measured                      (1)
    settled: from there to the end |e_i| <= SETTLED_RAD                                      (2)
    overshoot: largest q_i - q_d,i of the run, past a step to a positive angle               (3)

Windows, and which record of the plant belongs to a cycle: plants/judging.py. rad, N m, s.
"""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from executive.logs import Log
from plants.judging import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
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

SETTLED_RAD = 0.02
JOINTS = (1, 2)


def error(run: Run, joint: int) -> Vector:
    """Return (1) by executive cycle, NaN without the plant's record."""
    return run.executive(f"reference_{joint}.q_d_rad") - run.plant(f"arm.true_q{joint}_rad")


def metrics(
    log: Log, window_s: tuple[float, float], numbers: Mapping[str, float], period_s: float
) -> dict[str, float]:
    """Return what the log tells about a run; {} without a cycle in the window.

    `numbers`: NAME_from_s with NAME_to_s asks for the rms errors of a further window; `step_rad`,
    the size of a step, for settling (inf: never) and overshoot.
    """
    if "executive" not in log.node:
        return {}
    run = Run(log, period_s)
    window = run.between(*window_s)
    if not window.any():
        return {}
    names = [key.removesuffix("_from_s") for key in numbers if key.endswith("_from_s")]
    found: dict[str, float] = {}
    for joint in JOINTS:
        e, u = error(run, joint), run.executive(f"controller.u{joint}_Nm")
        found[f"e{joint}_rms_rad"] = rms(e[window])
        found[f"e{joint}_max_rad"] = peak(e[window])
        found[f"e{joint}_mean_rad"] = over_finite(e[window], np.mean)
        for name in names:
            part = run.between(numbers[f"{name}_from_s"], numbers[f"{name}_to_s"])
            found[f"e{joint}_{name}_rms_rad"] = rms(e[part])
        found[f"u{joint}_rms_Nm"] = rms(u[window])
        found[f"u{joint}_step_rms_Nm"] = rms(np.diff(u)[window[1:]])
        if "step_rad" in numbers:
            found[f"settle{joint}_s"] = settling(run, e)
            found[f"overshoot{joint}_rad"] = over_finite(-e, np.max)
    found["r_max_rad_s"] = peak(
        np.hypot(run.executive("controller.r1_rad_s"), run.executive("controller.r2_rad_s"))
    )
    found["norm_max"] = peak(
        np.hypot(run.executive("controller.norm_wi"), run.executive("controller.norm_w"))
    )
    found["ended"] = over_finite(run.executive("controller.diverged"), np.max)
    return known(found)


def settling(run: Run, e: Vector) -> float:
    """Return the time from which on (2) holds, s; inf if not at the end, NaN without truth."""
    seen = np.isfinite(e)
    if not seen.any():
        return math.nan
    outside = np.abs(e[seen]) > SETTLED_RAD
    if outside[-1]:
        return math.inf
    return float(run.t_s[seen][outside][-1]) + run.period_s if outside.any() else 0.0


def figure(
    log: Log, path: Path, title: str, metrics: Mapping[str, float], window_s: tuple[float, float]
) -> None:
    """Write one PNG: angles, errors, commands, compensators; ImportError without matplotlib."""
    panels = (
        Panel(
            "angle [rad]",
            (
                Line("plant:arm.true_q1_rad", "joint 1", BLUE),
                Line("plant:arm.true_q2_rad", "joint 2", VERMILION),
                Line("executive:reference_1.q_d_rad", "reference of both", BLACK, 0.9, "--"),
            ),
        ),
        Panel(
            "error [rad]",
            (
                Line(lambda run: error(run, 1), "joint 1", BLUE),
                Line(lambda run: error(run, 2), "joint 2", VERMILION),
            ),
            6.0,
        ),
        Panel(
            "joint 1 [N m]",
            (
                Line("executive:controller.u1_Nm", "command", GREY, 0.7),
                Line("executive:controller.y1_Nm", "of it the compensator", GREEN, 0.7),
                Line("plant:arm.tau1_Nm", "torque behind the deadzone", BLACK, 0.9),
            ),
        ),
        Panel(
            "joint 2 [N m]",
            (
                Line("executive:controller.u2_Nm", "command", GREY, 0.7),
                Line("executive:controller.y2_Nm", "of it the compensator", GREEN, 0.7),
                Line("plant:arm.tau2_Nm", "torque behind the deadzone", BLACK, 0.9),
            ),
        ),
    )
    draw_page(log, path, title, summary(metrics, window_s), window_s, panels)


def summary(metrics: Mapping[str, float], window_s: tuple[float, float]) -> str:
    """Return the two lines under the title; what is not known is left out."""
    first, second = [], [f"shaded {window_s[0]:g} to {window_s[1]:g} s"]
    for joint in JOINTS:
        if (value := metrics.get(f"e{joint}_rms_rad")) is not None:
            first.append(f"joint {joint}: {value:.2g} rad rms")
        if (value := metrics.get(f"settle{joint}_s")) is not None:
            after = f"within 0.02 rad after {value:.3g} s"
            within = after if math.isfinite(value) else "not settled to 0.02 rad"
            second.append(f"joint {joint} {within}")
    if metrics.get("ended"):
        second.append("DIVERGED: control ended")
    return "   ·   ".join(first) + "\n" + "   ·   ".join(second)
