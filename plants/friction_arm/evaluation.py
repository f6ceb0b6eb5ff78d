"""What judges and draws a run of the two-link arm: errors, torques and their variation.

    e_j = q_d,j - q_j, from the true angles                                                  (1)
    error_mean_j     time mean of |e_j| over the window; `early_...`: over that of `numbers` (2)
    error_rms_j      root mean square;   error_max_j   largest |e_j|, of the window          (3)
    overshoot_j      largest q_j - q_d,j of the whole run                                    (4)
    torque_peak      largest |tau| of both joints, whole run                                 (5)
    torque_variation sum over both joints and the run of |tau_k - tau_k-1|, per second,
                     from tau = 0 on: what chatter costs                                     (6)

tau is the torque that acts, rounded and limited. rad, N m, N m/s. (2) is for constant references,
(3) for moving ones; both are always given. The definitions are this project's.
"""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pcpc.executive.log.reader import Log
from pcpc.plants.judging import Measure, Run, Signal, Vector, known, measured, reaches
from pcpc.plants.pages import BLACK, BLUE, GREEN, VERMILION, Line, Panel, draw_page
from pcpc.plants.statistics import COUNT, HIGH, MEAN, MEDIAN, PEAK, RMS, SUM, peak

JOINTS = (1, 2)
COLOURS = {1: BLUE, 2: VERMILION}


def error(run: Run, joint: int) -> Vector:
    """Return e_j (1), the measured one if the log has no plant, rad."""
    if not run.plant_tells:
        return run.executive(f"controller.e_{joint}_rad")
    return run.executive(f"reference_{joint}.q_d_rad") - run.plant(f"arm.q_{joint}_rad")


def metrics(
    log: Log, window_s: tuple[float, float], numbers: Mapping[str, float], period_s: float
) -> dict[str, float]:
    """Return (2) to (6) and the tuning gain; {} without a cycle in the window.

    `numbers`: `early_from_s`, `early_to_s` ask for the early means (2).
    """
    if not reaches(log, period_s, window_s, "executive"):
        return {}
    early = numbers.get("early_from_s", 0.0), numbers.get("early_to_s", 0.0)
    gain = _variable("controller.tuning_gain_Nms_rad")
    measures = {
        "tuning_gain_median_Nms_rad": Measure(gain, MEDIAN),
        "tuning_gain_max_Nms_rad": Measure(gain, PEAK),
        "cycles": Measure(lambda run: run.t_s, COUNT),
    }
    for j in JOINTS:
        e, tau = _error(j), _torque(j)
        measures[f"error_mean_{j}_rad"] = Measure(_size(e), MEAN, window_s)
        measures[f"early_error_mean_{j}_rad"] = Measure(_size(e), MEAN, early)
        measures[f"error_rms_{j}_rad"] = Measure(e, RMS, window_s)
        measures[f"error_max_{j}_rad"] = Measure(e, PEAK, window_s)
        measures[f"overshoot_{j}_rad"] = Measure(_negative(e), HIGH)
        measures[f"peak_{j}"] = Measure(tau, PEAK)
        measures[f"steps_{j}"] = Measure(_steps(tau), SUM)
    found = measured(log, period_s, measures)
    peaks, steps = ([found.pop(f"{name}_{j}") for j in JOINTS] for name in ("peak", "steps"))
    found["torque_peak_Nm"] = peak(np.array(peaks))
    found["torque_variation_Nm_s"] = sum(steps) / (found.pop("cycles") * period_s)
    return known(found)


def _variable(name: str) -> Signal:
    return lambda run: run.executive(name, or_nan=True)


def _error(joint: int) -> Signal:
    return lambda run: error(run, joint)


def _torque(joint: int) -> Signal:
    return lambda run: run.plant(f"arm.acting_{joint}_Nm")


def _size(signal: Signal) -> Signal:
    return lambda run: np.abs(signal(run))


def _negative(signal: Signal) -> Signal:
    return lambda run: -signal(run)


def _steps(signal: Signal) -> Signal:
    return lambda run: np.abs(run.step(signal(run)))


def figure(
    log: Log, path: Path, title: str, metrics: Mapping[str, float], window_s: tuple[float, float]
) -> None:
    """Write one PNG: angles, errors, torques with friction, network, weights, wake-up.

    Raises ImportError, with the cure, where matplotlib is not installed.
    """
    angles = [
        Line("executive:reference_1.q_d_rad", "reference 1", BLACK, 0.9, "--"),
        Line("executive:reference_2.q_d_rad", "reference 2", BLACK, 0.9, ":"),
        *_each("plant:arm.q_{}_rad", "joint {}", 1.1),
    ]
    panels = [
        Panel("angle [rad]", angles),
        Panel("error [rad]", [_error_line(j) for j in JOINTS], 6.0),
        Panel("torque [N m]", _each("plant:arm.acting_{}_Nm", "torque {}", 0.7), 6.0),
        Panel("friction [N m]", _each("plant:arm.friction_{}_Nm", "friction {}", 0.7)),
    ]
    if "executive" in log.node and "controller.norm_z" in log.node["executive"].columns:
        network = _each("executive:controller.network_{}_Nm", "network {}", 0.7)
        norm = Line("executive:controller.norm_z", "norm of all weights", GREEN)
        panels += [Panel("network [N m]", network), Panel("norm", [norm], 3.0)]
    draw_page(log, path, title, _summary(metrics, window_s), window_s, panels)


def _error_line(joint: int) -> Line:
    return Line(lambda run: error(run, joint), f"error {joint}", COLOURS[joint])


def _each(name: str, label: str, width: float) -> list[Line]:
    return [Line(name.format(j), label.format(j), COLOURS[j], width) for j in JOINTS]


def _summary(metrics: Mapping[str, float], window_s: tuple[float, float]) -> str:
    def pair(name: str) -> str:
        values = [metrics.get(f"{name}_{j}_rad", math.nan) for j in JOINTS]
        return " / ".join(f"{value:.4f}" for value in values)

    first = [
        f"mean |error| {pair('error_mean')} rad",
        f"rms {pair('error_rms')}",
        f"largest {pair('error_max')}",
    ]
    second = [
        f"shaded {window_s[0]:g} to {window_s[1]:g} s",
        f"overshoot {pair('overshoot')}",
        f"torque peak {metrics.get('torque_peak_Nm', math.nan):.0f} N m, "
        f"variation {metrics.get('torque_variation_Nm_s', math.nan):.0f} N m/s",
    ]
    return "   ·   ".join(first) + "\n" + "   ·   ".join(second)
