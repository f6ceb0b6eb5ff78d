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

from pcpc.executive.log.reader import Log
from pcpc.plants.judging import Measure, Run, Signal, Vector, known, measured, reaches
from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, VERMILION, Line, Panel, draw_page
from pcpc.plants.statistics import HIGH, MEAN, PEAK, RMS

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
    if not reaches(log, period_s, window_s, "executive"):
        return {}
    names = [key.removesuffix("_from_s") for key in numbers if key.endswith("_from_s")]
    measures: dict[str, Measure] = {}
    for j in JOINTS:
        e, u = _error(j), _variable(f"controller.u{j}_Nm")
        measures[f"e{j}_rms_rad"] = Measure(e, RMS, window_s)
        measures[f"e{j}_max_rad"] = Measure(e, PEAK, window_s)
        measures[f"e{j}_mean_rad"] = Measure(e, MEAN, window_s)
        for name in names:
            part = numbers[f"{name}_from_s"], numbers[f"{name}_to_s"]
            measures[f"e{j}_{name}_rms_rad"] = Measure(e, RMS, part)
        measures[f"u{j}_rms_Nm"] = Measure(u, RMS, window_s)
        measures[f"u{j}_step_rms_Nm"] = Measure(_steps(u), RMS, window_s)
        if "step_rad" in numbers:
            measures[f"settle{j}_s"] = Measure(_seen_s(e, 0.0), HIGH)
            measures[f"outside{j}_s"] = Measure(_seen_s(e, SETTLED_RAD), HIGH)
            measures[f"overshoot{j}_rad"] = Measure(_negative(e), HIGH)
    measures["r_max_rad_s"] = Measure(_size("controller.r1_rad_s", "controller.r2_rad_s"), PEAK)
    measures["norm_max"] = Measure(_size("controller.norm_wi", "controller.norm_w"), PEAK)
    measures["ended"] = Measure(_variable("controller.diverged"), HIGH)
    found = measured(log, period_s, measures)
    if "step_rad" in numbers:
        for j in JOINTS:
            outside_s = found.pop(f"outside{j}_s")
            found[f"settle{j}_s"] = settling(found[f"settle{j}_s"], outside_s, period_s)
    return known(found)


def settling(seen_s: float, outside_s: float, period_s: float) -> float:
    """Return the time from which on (2) holds, s; inf if not at the end, NaN without truth.

    `seen_s`: when the error was seen last; `outside_s`: when it was last outside, NaN for never.
    """
    if math.isnan(seen_s):
        return math.nan
    if outside_s == seen_s:
        return math.inf
    return 0.0 if math.isnan(outside_s) else outside_s + period_s


def _error(joint: int) -> Signal:
    return lambda run: error(run, joint)


def _variable(name: str) -> Signal:
    return lambda run: run.executive(name, or_nan=True)


def _steps(signal: Signal) -> Signal:
    return lambda run: run.step(signal(run))


def _negative(signal: Signal) -> Signal:
    return lambda run: -signal(run)


def _size(first: str, second: str) -> Signal:
    return lambda run: np.hypot(_variable(first)(run), _variable(second)(run))


def _seen_s(signal: Signal, beyond: float) -> Signal:
    """Return the times at which a signal is finite and, if `beyond` is above 0, beyond that."""

    def times(run: Run) -> Vector:
        values = signal(run)
        seen = np.isfinite(values) & ((np.abs(values) > beyond) | (beyond == 0.0))
        return np.where(seen, run.t_s, math.nan)

    return times


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
