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

from executive.logs import Log
from plants.judging import (
    BLACK,
    BLUE,
    GREEN,
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
)

JOINTS = (1, 2)
COLOURS = {1: BLUE, 2: VERMILION}


def error(run: Run, joint: int) -> Vector:
    """Return e_j (1), the measured one where the plant's record is missing, rad."""
    true = run.executive(f"reference_{joint}.q_d_rad") - run.plant(f"arm.q_{joint}_rad")
    return true if np.isfinite(true).any() else run.executive(f"controller.e_{joint}_rad")


def metrics(
    log: Log, window_s: tuple[float, float], numbers: Mapping[str, float], period_s: float
) -> dict[str, float]:
    """Return (2) to (6) and the tuning gain; {} without a cycle in the window.

    `numbers`: `early_from_s`, `early_to_s` ask for the early means (2).
    """
    if "executive" not in log.node:
        return {}
    run = Run(log, period_s)
    window = run.between(*window_s)
    if not window.any():
        return {}
    early = run.between(numbers.get("early_from_s", 0.0), numbers.get("early_to_s", 0.0))
    found: dict[str, float] = {}
    torques = [run.plant(f"arm.acting_{j}_Nm") for j in JOINTS]
    for j in JOINTS:
        e = error(run, j)
        found[f"error_mean_{j}_rad"] = over_finite(np.abs(e[window]), np.mean)
        found[f"early_error_mean_{j}_rad"] = over_finite(np.abs(e[early]), np.mean)
        found[f"error_rms_{j}_rad"] = rms(e[window])
        found[f"error_max_{j}_rad"] = peak(e[window])
        found[f"overshoot_{j}_rad"] = over_finite(-e, np.max)
    found["torque_peak_Nm"] = peak(np.concatenate(torques))
    steps = sum(over_finite(np.abs(np.diff(tau)), np.sum) for tau in torques)
    found["torque_variation_Nm_s"] = steps / (len(run.cycle) * period_s)
    gain = run.executive("controller.tuning_gain_Nms_rad")
    found["tuning_gain_median_Nms_rad"] = over_finite(gain, np.median)
    found["tuning_gain_max_Nms_rad"] = peak(gain)
    return known(found)


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
