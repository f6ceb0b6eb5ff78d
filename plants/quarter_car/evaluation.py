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

from pcpc.executive.log.reader import Log
from pcpc.plants.judging import (
    Measure,
    Run,
    Signal,
    Vector,
    edges,
    known,
    measured,
    reaches,
    setting,
)
from pcpc.plants.pages import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    PURPLE,
    SKY,
    VERMILION,
    Line,
    Panel,
    draw_page,
)
from pcpc.plants.statistics import CORRELATION, COUNT, HIGH, LOW, MEAN, PEAK, RMS, STD

SPEED = "car.body_rate_m_s"

SMALLEST_OSCILLATION_M_S = 1e-3  # below it a crossing is no oscillation


def acceleration(run: Run) -> Vector:
    """Return (2); NaN without a sample before and after."""
    speed = run.plant(SPEED)
    return (run.after(speed) - run.before(speed)) / (2.0 * run.period_s)


def oscillation(log: Log, period_s: float, window_s: tuple[float, float]) -> float:
    """Return (7), interpolating between samples; NaN for fewer than three crossings."""
    speed = Measure(lambda run: run.plant(SPEED), MEAN, window_s)
    mean = measured(log, period_s, {"mean": speed}, "plant")["mean"]
    first, past = edges(period_s, *window_s)

    def crossings(run: Run) -> Vector:
        """Return the cycles, from the window's first on, at which the deviation is 0."""
        here = run.plant(SPEED) - mean
        there = run.after(here)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = run.cycle - first + here / (here - there)
        inside = (run.cycle >= first) & (run.cycle < past - 1)
        return np.where(inside & ((here < 0.0) != (there < 0.0)), at, math.nan)

    away = Measure(lambda run: run.plant(SPEED) - mean, PEAK, window_s)
    named = {"begin": LOW, "end": HIGH, "count": COUNT}
    found = measured(
        log, period_s, {"away": away} | {n: Measure(crossings, one) for n, one in named.items()},
        "plant",
    )  # fmt: skip
    if not found["away"] > SMALLEST_OSCILLATION_M_S or found["count"] < 3:
        return math.nan
    return math.pi * (found["count"] - 1) / ((found["end"] - found["begin"]) * period_s)


def metrics(
    log: Log, window_s: tuple[float, float], numbers: Mapping[str, float], period_s: float
) -> dict[str, float]:
    """Return (1) to (8); {} without a cycle in the window."""
    found: dict[str, float] = {}
    if reaches(log, period_s, window_s, "plant"):
        found |= measured(log, period_s, _motion(window_s), "plant")
        found["oscillation_rad_s"] = oscillation(log, period_s, window_s)
    if reaches(log, period_s, window_s, "executive"):
        found |= measured(log, period_s, _control(log, window_s))
    return known(found)


def _motion(window_s: tuple[float, float]) -> dict[str, Measure]:
    def speed(run: Run) -> Vector:
        return run.plant(SPEED)

    def extension(run: Run) -> Vector:
        return run.plant("car.extension_m")

    return {
        "v_rms_m_s": Measure(speed, RMS, window_s),
        "v_max_m_s": Measure(speed, PEAK, window_s),
        "a_rms_m_s2": Measure(acceleration, RMS, window_s),
        "extension_min_m": Measure(extension, LOW, window_s),
        "extension_max_m": Measure(extension, HIGH, window_s),
        "spool_max_m": Measure(lambda run: run.plant("car.spool_true_m"), PEAK, window_s),
    }


def _control(log: Log, window_s: tuple[float, float]) -> dict[str, Measure]:
    def law(name: str) -> Signal:
        return lambda run: run.executive(f"controller.{name}", or_nan=True)

    desired, force = law("desired_N"), law("force_N")
    found = {
        "theta_norm_max_m": Measure(law("norm_theta_m"), PEAK),
        "theta_max_m": Measure(law("largest_theta_m"), PEAK),
    }
    if setting(log, "strut") == 1.0:
        found["ef_rms_N"] = Measure(law("ef_N"), RMS, window_s)
        found["desired_sd_N"] = Measure(desired, STD, window_s)
        found["force_correlation"] = Measure(
            lambda run: np.column_stack((desired(run), force(run))), CORRELATION, window_s
        )
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
                Line(_of_law("desired_N", 1e-3), "desired", BLUE, 0.9),
                Line(lambda run: 1e-3 * run.plant("car.bump_N"), "bump stops", GREY, 0.8),
            ],
            6.0,
        ),
    ]
    if "executive" in log.node and setting(log, "strut") == 1.0:
        panels += _valve_panels("controller.wanted_spool_m" in log.node["executive"].columns)
    draw_page(log, path, title, _summary(metrics, window_s), window_s, panels)


def _valve_panels(learns: bool) -> list[Panel]:
    spool = Line(lambda run: 1e3 * run.plant("car.spool_true_m"), "spool", VERMILION, 0.9)
    wanted = Line(_of_law("wanted_spool_m", 1e3), "wanted", SKY, 2.2)
    p1 = Line(lambda run: 1e-6 * run.plant("car.p1_Pa"), "bore side", BLUE, 0.9)
    p2 = Line(lambda run: 1e-6 * run.plant("car.p2_Pa"), "rod side", GREEN, 0.8)
    panels = [
        Panel("valve [mm]", [wanted, spool] if learns else [spool], 4.0),
        Panel("pressure [MPa]", [p1, p2], 4.0),
    ]
    if learns:
        drift = Line(_of_law("drift_m", 1e3), "drift", BLUE, 0.8)
        norm = Line(_of_law("norm_theta_m", 1e3), "norm of all rules", PURPLE)
        panels.append(Panel("fuzzy [mm]", [drift, norm], 4.0))
    return panels


def _of_law(name: str, scale: float) -> Signal:
    return lambda run: scale * run.executive(f"controller.{name}", or_nan=True)


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
