"""What judges and draws a run of the telerobot: errors against the reference of T ago, torques.

    e_i = q_d,i(t - T) - q_i(t), from the true angles                                        (1)
    error_rms_i     root mean square over the window; `before_rms_i`, `load_rms_i`: over
                    those of `numbers`; `late_rms_i`: from the window's end on               (2)
    error_max_i     largest |e_i| of the window                                              (3)
    torque_peak     largest |tau| of both joints, whole run                                  (4)
    norm_w_low/high least and largest |W| of the identifier; `late_...` as in (2)            (5)
    held_u, held_x  ticks of the run in which no u, no x was there at its play-out           (6)
    tripped_s       when a joint was too fast; absent where none was                         (7)

rad, N m, s. The definitions are this project's.
"""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pcpc.executive.log.reader import Log
from pcpc.plants.judging import Measure, Run, Signal, Vector, known, measured, reaches
from pcpc.plants.pages import BLACK, BLUE, GREEN, VERMILION, Line, Panel, draw_page
from pcpc.plants.statistics import HIGH, LOW, PEAK, RMS, peak

JOINTS = (1, 2)
COLOURS = {1: BLUE, 2: VERMILION}
PARTS = ("before", "load", "late")


def error(run: Run, joint: int) -> Vector:
    """Return e_i (1), rad."""
    return run.executive(f"controller.aim_{joint}_rad") - run.plant(f"arm.q_{joint}_rad")


def metrics(
    log: Log, window_s: tuple[float, float], numbers: Mapping[str, float], period_s: float
) -> dict[str, float]:
    """Return (2) to (7); {} without a cycle in the window.

    `numbers`: `before_from_s`, `before_to_s`, `load_from_s`, `load_to_s` ask for more of (2).
    """
    if not reaches(log, period_s, window_s, "executive"):
        return {}
    edges = {**numbers, "late_from_s": window_s[1], "late_to_s": math.inf}
    parts = {
        part: (edges.get(f"{part}_from_s", 0.0), edges.get(f"{part}_to_s", 0.0)) for part in PARTS
    }
    measures: dict[str, Measure] = {}
    for j in JOINTS:
        for part, own in parts.items():
            measures[f"{part}_rms_{j}_rad"] = Measure(_error(j), RMS, own)
        measures[f"error_rms_{j}_rad"] = Measure(_error(j), RMS, window_s)
        measures[f"error_max_{j}_rad"] = Measure(_error(j), PEAK, window_s)
        measures[f"peak_{j}"] = Measure(_torque(j), PEAK)
    norm = _local("servo.norm_w")
    for name, own in (("norm_w", window_s), ("late_norm_w", parts["late"])):
        measures[f"{name}_low"] = Measure(norm, LOW, own)
        measures[f"{name}_high"] = Measure(norm, HIGH, own)
    measures["held_u"] = Measure(_local("servo.held_u"), HIGH)
    measures["held_x"] = Measure(lambda run: run.executive("controller.held_x", or_nan=True), HIGH)
    measures["tripped_s"] = Measure(_tripped_s, LOW)
    found = measured(log, period_s, measures)
    found["torque_peak_Nm"] = peak(np.array([found.pop(f"peak_{j}") for j in JOINTS]))
    return known(found)


def _error(joint: int) -> Signal:
    return lambda run: error(run, joint)


def _torque(joint: int) -> Signal:
    return lambda run: run.plant(f"arm.acting_{joint}_Nm")


def _local(name: str) -> Signal:
    return lambda run: run.of("local", name, or_nan=True)


def _tripped_s(run: Run) -> Vector:
    return np.where(run.named("local:servo.tripped") > 0.5, run.t_s, math.nan)


def figure(
    log: Log, path: Path, title: str, metrics: Mapping[str, float], window_s: tuple[float, float]
) -> None:
    """Write one PNG: angles, errors, what the predictor corrects, torques, network, held ticks.

    Raises ImportError, with the cure, where matplotlib is not installed.
    """
    angles = [
        Line("executive:controller.aim_1_rad", "wanted 1, T ago", BLACK, 0.9, "--"),
        Line("executive:controller.aim_2_rad", "wanted 2, T ago", BLACK, 0.9, ":"),
        *(Line(f"plant:arm.q_{j}_rad", f"joint {j}", COLOURS[j]) for j in JOINTS),
    ]
    held = [
        Line("local:servo.held_u", "u not there in time", GREEN),
        Line("executive:controller.held_x", "x not there in time", VERMILION),
    ]
    panels = [
        Panel("angle [rad]", angles),
        Panel("error [rad]", [_error_line(j) for j in JOINTS], 6.0),
        Panel("x(t-T) - z(t-2T) [rad]", _each("executive:controller.off_{}_rad", "joint {}", 0.8)),
        Panel("torque [N m]", _each("plant:arm.acting_{}_Nm", "torque {}", 0.7)),
        Panel("network [rad/s2]", _each("local:servo.network_{}_rad_s2", "network {}", 0.8)),
        Panel("held ticks", held, 3.0),
    ]
    draw_page(log, path, title, _summary(metrics, window_s), window_s, panels)


def _error_line(joint: int) -> Line:
    return Line(lambda run: error(run, joint), f"error {joint}", COLOURS[joint])


def _each(name: str, label: str, width: float) -> list[Line]:
    return [Line(name.format(j), label.format(j), COLOURS[j], width) for j in JOINTS]


def _summary(metrics: Mapping[str, float], window_s: tuple[float, float]) -> str:
    def pair(name: str) -> str:
        values = [metrics.get(f"{name}_{j}_rad", math.nan) for j in JOINTS]
        return " / ".join(f"{value:.4f}" for value in values)

    trip = metrics.get("tripped_s")
    first = [f"rms error {pair('error_rms')} rad", f"largest {pair('error_max')}"]
    first += [] if trip is None else [f"tripped at {trip:.2f} s"]
    second = [
        f"shaded {window_s[0]:g} to {window_s[1]:g} s",
        f"torque peak {metrics.get('torque_peak_Nm', math.nan):.0f} N m",
        f"held: u {metrics.get('held_u', 0.0):.0f}, x {metrics.get('held_x', 0.0):.0f} ticks",
    ]
    return "   ·   ".join(first) + "\n" + "   ·   ".join(second)
