"""What judges and draws a run of the quarter car: speed, acceleration, travel, force, valve.

    v_rms, v_max      of the body's true speed x2                                            (1)
    a_rms             rms of (x2(k+1) - x2(k-1))/(2 T), not of Ft/ms - g, which is up to
                      1.6 % more on the stops                                                (2)
    extension_min, _max   of x3                                                              (3)
    ef_rms            of Fd - F, measured, of a hydraulic strut                              (4)
    spool_max         largest |xv|                                                           (5)
    desired_sd, force_correlation   standard deviation of Fd; correlation of F with it       (6)
    oscillation       angular frequency of x2 by the zero crossings of its deviation         (7)
    theta_norm_max, theta_max   largest norm and largest entry of the fuzzy consequents,
                      of the whole run                                                       (8)

All but (8) over the window; (1) to (3), (5), (7) from the plant's own record, whose samples are a
period apart also where its clock is not the executive's. m, m/s, m/s^2, N, rad/s.
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
    PURPLE,
    SKY,
    VERMILION,
    Line,
    Mask,
    Panel,
    Run,
    Vector,
    between,
    draw_page,
    known,
    over_finite,
    peak,
    rms,
)

SMALLEST_OSCILLATION_M_S = 1e-3  # below it a crossing is no oscillation


def acceleration(rate: Vector, period_s: float) -> Vector:
    """Return (2) at every sample; NaN at both ends."""
    found = np.full(len(rate), math.nan)
    found[1:-1] = (rate[2:] - rate[:-2]) / (2.0 * period_s)
    return found


def oscillation(rate: Vector, period_s: float) -> float:
    """Return (7), interpolating between samples; NaN for fewer than three crossings."""
    if not len(rate):
        return math.nan
    x = rate - np.mean(rate)
    if not np.max(np.abs(x)) > SMALLEST_OSCILLATION_M_S:
        return math.nan
    at = np.flatnonzero((x[:-1] < 0.0) != (x[1:] < 0.0))
    if len(at) < 3:
        return math.nan
    crossing = at + x[at] / (x[at] - x[at + 1])
    return math.pi * (len(at) - 1) / float((crossing[-1] - crossing[0]) * period_s)


def correlation(a: Vector, b: Vector) -> float:
    """Return the coefficient of correlation; NaN where one does not vary."""
    if len(a) < 2 or not (np.std(a) > 0.0 and np.std(b) > 0.0):
        return math.nan
    return float(np.corrcoef(a, b)[0, 1])


def metrics(
    log: Log, window_s: tuple[float, float], numbers: Mapping[str, float], period_s: float
) -> dict[str, float]:
    """Return (1) to (8); {} without a cycle in the window."""
    found: dict[str, float] = {}
    if "plant" in log.node:
        plant = log.node["plant"]
        window = between(plant.cycle, period_s, *window_s)
        if window.any():
            found |= _motion(plant.columns, window, period_s)
    if "executive" in log.node:
        run = Run(log, period_s)
        window = run.between(*window_s)
        if window.any():
            found |= _control(run, window)
    return known(found)


def _motion(columns: Mapping[str, Vector], window: Mask, period_s: float) -> dict[str, float]:
    rate = columns["car.body_rate_m_s"]
    extension = columns["car.extension_m"][window]
    return {
        "v_rms_m_s": rms(rate[window]),
        "v_max_m_s": peak(rate[window]),
        "a_rms_m_s2": rms(acceleration(rate, period_s)[window]),
        "extension_min_m": over_finite(extension, np.min),
        "extension_max_m": over_finite(extension, np.max),
        "spool_max_m": peak(columns["car.spool_true_m"][window]),
        "oscillation_rad_s": oscillation(rate[window], period_s),
    }


def _control(run: Run, window: Mask) -> dict[str, float]:
    norm, largest = (run.executive(f"controller.{n}_theta_m") for n in ("norm", "largest"))
    found = {"theta_norm_max_m": peak(norm), "theta_max_m": peak(largest)}
    if run.setting("strut") == 1.0:
        desired, force = (run.executive(f"controller.{n}_N")[window] for n in ("desired", "force"))
        found["ef_rms_N"] = rms(run.executive("controller.ef_N")[window])
        found["desired_sd_N"] = over_finite(desired, np.std)
        found["force_correlation"] = correlation(desired, force)
    return found


def figure(
    log: Log, path: Path, title: str, metrics: Mapping[str, float], window_s: tuple[float, float]
) -> None:
    """Write one PNG: speeds, road and travel, forces, valve, pressures, fuzzy system, wake-up.

    Raises ImportError, with the cure, where matplotlib is not installed.
    """
    panels = [
        Panel("speed [m/s]", [Line("plant:car.body_rate_m_s", "body", BLUE)]),
        Panel(
            "position [m]",
            [
                Line("plant:car.ground_m", "road", GREY, 0.8),
                Line("plant:car.extension_m", "strut extension", VERMILION, 0.9),
                Line(lambda run: _stop(run, 1.0), "stops", BLACK, 0.7, "--"),
                Line(lambda run: _stop(run, -1.0), "_", BLACK, 0.7, "--"),
            ],
        ),
        Panel(
            "force [kN]",
            [
                Line(lambda run: 1e-3 * run.plant("car.strut_N"), "strut", VERMILION, 0.9),
                Line(
                    lambda run: 1e-3 * run.executive("controller.desired_N"), "desired", BLUE, 0.9
                ),
                Line(lambda run: 1e-3 * run.plant("car.bump_N"), "bump stops", GREY, 0.8),
            ],
            6.0,
        ),
    ]
    if "executive" in log.node and Run(log, 1.0).setting("strut") == 1.0:
        panels += _valve_panels("controller.wanted_spool_m" in log.node["executive"].columns)
    draw_page(log, path, title, _summary(metrics, window_s), window_s, panels)


def _valve_panels(learns: bool) -> list[Panel]:
    spool = Line(lambda run: 1e3 * run.plant("car.spool_true_m"), "spool", VERMILION, 0.9)
    wanted = Line(lambda run: 1e3 * run.executive("controller.wanted_spool_m"), "wanted", SKY, 2.2)
    p1 = Line(lambda run: 1e-6 * run.plant("car.p1_Pa"), "bore side", BLUE, 0.9)
    p2 = Line(lambda run: 1e-6 * run.plant("car.p2_Pa"), "rod side", GREEN, 0.8)
    panels = [
        Panel("valve [mm]", [wanted, spool] if learns else [spool], 4.0),
        Panel("pressure [MPa]", [p1, p2], 4.0),
    ]
    if learns:
        drift = Line(lambda run: 1e3 * run.executive("controller.drift_m"), "drift", BLUE, 0.8)
        norm = Line(
            lambda run: 1e3 * run.executive("controller.norm_theta_m"), "norm of all rules", PURPLE
        )
        panels.append(Panel("fuzzy [mm]", [drift, norm], 4.0))
    return panels


def _stop(run: Run, side: float) -> Vector:
    on = run.setting("limits_on") == 1.0
    return np.full(len(run.cycle), side * run.setting("stop_m") if on else math.nan)


def _summary(metrics: Mapping[str, float], window_s: tuple[float, float]) -> str:
    def of(name: str, scale: float = 1.0) -> float:
        return scale * metrics.get(name, math.nan)

    first = [
        f"body speed rms {of('v_rms_m_s'):.4f}, largest {of('v_max_m_s'):.4f} m/s",
        f"acceleration rms {of('a_rms_m_s2'):.2f} m/s2",
    ]
    second = [
        f"shaded {window_s[0]:g} to {window_s[1]:g} s",
        f"strut {of('extension_min_m', 1e3):.0f} to {of('extension_max_m', 1e3):.0f} mm",
    ]
    if "ef_rms_N" in metrics:
        first.append(f"force error rms {of('ef_rms_N'):.0f} N")
        second.append(f"spool at most {of('spool_max_m', 1e3):.3f} mm")
    return "   ·   ".join(first) + "\n" + "   ·   ".join(second)
