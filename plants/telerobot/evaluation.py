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
PARTS = ("before", "load", "late")


def error(run: Run, joint: int) -> Vector:
    """Return e_i (1), rad."""
    return run.executive(f"controller.aim_{joint}_rad") - run.plant(f"arm.q_{joint}_rad")


def local(run: Run, name: str) -> Vector:
    """Return a variable of the local node, row by row; NaN where the log has none."""
    node = run.log.node.get("local")
    found = None if node is None else node.columns.get(name)
    whole = np.full(len(run.cycle), math.nan)
    if found is not None:
        n = min(len(whole), len(found))
        whole[:n] = found[:n]
    return whole


def metrics(
    log: Log, window_s: tuple[float, float], numbers: Mapping[str, float], period_s: float
) -> dict[str, float]:
    """Return (2) to (7); {} without a cycle in the window.

    `numbers`: `before_from_s`, `before_to_s`, `load_from_s`, `load_to_s` ask for more of (2).
    """
    if "executive" not in log.node:
        return {}
    run = Run(log, period_s)
    window = run.between(*window_s)
    if not window.any():
        return {}
    found: dict[str, float] = {}
    edges = {**numbers, "late_from_s": window_s[1], "late_to_s": math.inf}
    parts = {
        part: run.between(edges.get(f"{part}_from_s", 0.0), edges.get(f"{part}_to_s", 0.0))
        for part in PARTS
    }
    for j in JOINTS:
        e = error(run, j)
        found |= {f"{part}_rms_{j}_rad": rms(e[own]) for part, own in parts.items()}
        found[f"error_rms_{j}_rad"] = rms(e[window])
        found[f"error_max_{j}_rad"] = peak(e[window])
    torques = [run.plant(f"arm.acting_{j}_Nm") for j in JOINTS]
    found["torque_peak_Nm"] = peak(np.concatenate(torques))
    norm = local(run, "servo.norm_w")
    for name, own in (("norm_w", window), ("late_norm_w", parts["late"])):
        found[f"{name}_low"] = over_finite(norm[own], np.min)
        found[f"{name}_high"] = over_finite(norm[own], np.max)
    found["held_u"] = over_finite(local(run, "servo.held_u"), np.max)
    found["held_x"] = over_finite(run.executive("controller.held_x"), np.max)
    trips = np.flatnonzero(local(run, "servo.tripped") > 0.5)
    found["tripped_s"] = float(run.t_s[trips[0]]) if len(trips) else math.nan
    return known(found)


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
    panels = [
        Panel("angle [rad]", angles),
        Panel("error [rad]", [_error_line(j) for j in JOINTS], 6.0),
        Panel("x(t-T) - z(t-2T) [rad]", _each("controller.off_{}_rad", "joint {}")),
        Panel("torque [N m]", _arm("arm.acting_{}_Nm", "torque {}")),
        Panel("network [rad/s2]", [_local_line(j) for j in JOINTS]),
        Panel("held ticks", _held(), 3.0),
    ]
    draw_page(log, path, title, _summary(metrics, window_s), window_s, panels)


def _error_line(joint: int) -> Line:
    return Line(lambda run: error(run, joint), f"error {joint}", COLOURS[joint])


def _local_line(joint: int) -> Line:
    name = f"servo.network_{joint}_rad_s2"
    return Line(lambda run: local(run, name), f"network {joint}", COLOURS[joint], 0.8)


def _each(name: str, label: str) -> list[Line]:
    return [Line("executive:" + name.format(j), label.format(j), COLOURS[j], 0.8) for j in JOINTS]


def _arm(name: str, label: str) -> list[Line]:
    return [Line("plant:" + name.format(j), label.format(j), COLOURS[j], 0.7) for j in JOINTS]


def _held() -> list[Line]:
    def held_u(run: Run) -> Vector:
        return local(run, "servo.held_u")

    return [
        Line(held_u, "u not there in time", GREEN),
        Line("executive:controller.held_x", "x not there in time", VERMILION),
    ]


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
