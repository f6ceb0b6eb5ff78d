"""What judges and draws a run of the arm with a payload: errors, torques, norms of the networks.

    e_j = q_d,j - q_j, from the true angles                                                  (1)
    error_rms_j, error_max_j       of the window                                             (2)
    NAME_rms_j, NAME_max_j         of the further window NAME_from_s to NAME_to_s            (3)
    torque_peak                    largest |tau| of both joints, whole run                   (4)
    critic_max, w1_max, w2_max, rho_max    largest |R|, |W1|, |W2|, |rho|, whole run         (5)

tau is the torque that acts, rounded and limited. rad, N m. The definitions are this project's.
"""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pcpc.executive.log.reader import Log
from pcpc.plants.judging import Measure, Run, Signal, Vector, known, measured, reaches
from pcpc.plants.pages import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILION,
    Line,
    Panel,
    draw_page,
)
from pcpc.plants.statistics import PEAK, RMS, peak

JOINTS = (1, 2)
COLOURS = {1: BLUE, 2: VERMILION}
WEIGHTS = ("w1", "w2", "rho")


def error(run: Run, joint: int) -> Vector:
    """Return e_j (1), the measured one if the log has no plant, rad."""
    if not run.plant_tells:
        return run.executive(f"controller.e_{joint}_rad")
    return run.executive(f"reference_{joint}.q_d_rad") - run.plant(f"arm.q_{joint}_rad")


def critic_size(run: Run) -> Vector:
    """Return |R|; NaN for a law without it."""
    return np.hypot(*(_variable(f"controller.critic_{j}")(run) for j in JOINTS))


def metrics(
    log: Log, window_s: tuple[float, float], numbers: Mapping[str, float], period_s: float
) -> dict[str, float]:
    """Return (2) to (5); {} without a cycle in the window.

    `numbers`: NAME_from_s with NAME_to_s asks for a further window (3).
    """
    if not reaches(log, period_s, window_s, "executive"):
        return {}
    names = [key.removesuffix("_from_s") for key in numbers if key.endswith("_from_s")]
    windows = {name: (numbers[f"{name}_from_s"], numbers[f"{name}_to_s"]) for name in names}
    windows["error"] = window_s
    measures = {"critic_max": Measure(critic_size, PEAK)}
    for j in JOINTS:
        for name, window in windows.items():
            measures[f"{name}_rms_{j}_rad"] = Measure(_error(j), RMS, window)
            measures[f"{name}_max_{j}_rad"] = Measure(_error(j), PEAK, window)
        measures[f"peak_{j}"] = Measure(_torque(j), PEAK)
    for name in WEIGHTS:
        measures[f"{name}_max"] = Measure(_variable(f"controller.norm_{name}"), PEAK)
    found = measured(log, period_s, measures)
    found["torque_peak_Nm"] = peak(np.array([found.pop(f"peak_{j}") for j in JOINTS]))
    return known(found)


def _variable(name: str) -> Signal:
    return lambda run: run.executive(name, or_nan=True)


def _error(joint: int) -> Signal:
    return lambda run: error(run, joint)


def _torque(joint: int) -> Signal:
    return lambda run: run.plant(f"arm.acting_{joint}_Nm")


def figure(
    log: Log, path: Path, title: str, metrics: Mapping[str, float], window_s: tuple[float, float]
) -> None:
    """Write one PNG: angles, errors, torques, mass, network, norms, wake-up.

    Raises ImportError, with the cure, where matplotlib is not installed.
    """
    angles = [
        Line("executive:reference_1.q_d_rad", "reference 1", BLACK, 0.9, "--"),
        Line("executive:reference_2.q_d_rad", "reference 2", BLACK, 0.9, ":"),
        *_each("plant:arm.q_{}_rad", "joint {}"),
    ]
    panels = [
        Panel("angle [rad]", angles),
        Panel("error, to 0.2 rad", [_error_line(joint) for joint in JOINTS], 6.0),
        Panel("torque, to 100 N m", [_torque_line(joint) for joint in JOINTS]),
        Panel("m2 [kg]", [Line("plant:arm.outer_mass_kg", "mass at the end", GREY)], 2.0),
    ]
    if "executive" in log.node and "controller.norm_w2" in log.node["executive"].columns:
        learned = _each("executive:controller.learned_{}_rad_s2", "action network {}")
        robust = [
            Line(f"executive:controller.robust_{j}_rad_s2", f"robust term {j}", colour, 0.8)
            for j, colour in ((1, GREEN), (2, ORANGE))
        ]
        norms = [
            Line(critic_size, "|R|", PURPLE),
            Line("executive:controller.norm_w1", "|W1|", GREEN),
            Line("executive:controller.norm_rho", "|rho|", ORANGE),
        ]
        panels += [Panel("acceleration\n[rad/s2]", [*learned, *robust]), Panel("critic", norms)]
    draw_page(log, path, title, _summary(metrics, window_s), window_s, panels)


def _error_line(joint: int) -> Line:
    return Line(lambda run: _cut(error(run, joint), 0.2), f"error {joint}", COLOURS[joint])


def _torque_line(joint: int) -> Line:
    name = f"arm.acting_{joint}_Nm"
    return Line(lambda run: _cut(run.plant(name), 100.0), f"torque {joint}", COLOURS[joint])


def _cut(values: Vector, size: float) -> Vector:
    """Return the values without the larger ones of a start from 1 rad away."""
    return np.where(np.abs(values) <= size, values, math.nan)


def _each(name: str, label: str) -> list[Line]:
    return [Line(name.format(j), label.format(j), COLOURS[j], 1.0) for j in JOINTS]


def _summary(metrics: Mapping[str, float], window_s: tuple[float, float]) -> str:
    def pair(name: str) -> str:
        values = [metrics.get(f"{name}_{joint}_rad", math.nan) for joint in JOINTS]
        return " / ".join(f"{value:.4f}" for value in values)

    first = [
        f"rms error, shaded {window_s[0]:g} to {window_s[1]:g} s, {pair('error_rms')} rad",
        f"largest {pair('error_max')}",
    ]
    second = [f"torque peak {metrics.get('torque_peak_Nm', math.nan):.0f} N m"]
    if "payload_rms_1_rad" in metrics:
        second.insert(0, f"5 to 7 s: rms error {pair('payload_rms')} rad")
    return "   ·   ".join(first) + "\n" + "   ·   ".join(second)
