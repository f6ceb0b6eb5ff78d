"""What judges and draws a run of the quarter car: speed, acceleration, travel, force, valve.

    speed_rms, speed_max  of the body's true speed x2                                        (1)
    acceleration_rms  rms of (x2(k+1) - x2(k-1))/(2 T), not of Ft/ms - g, which is up to
                      1.6 % more on the stops                                                (2)
    extension_min, _max   of x3                                                              (3)
    force_error_rms   of Fd - F, measured, of a hydraulic strut                              (4)
    spool_max         largest |xv|                                                           (5)
    desired_sd, force_correlation   standard deviation of Fd; correlation of F with it       (6)
    oscillation       angular frequency of x2 by the zero crossings of its deviation         (7)
    theta_norm_max, theta_max   largest norm and largest entry of the fuzzy consequents,
                      of the whole run                                                       (8)

All but (8) over the window; (1) to (3), (5), (7) from the plant's own record, whose samples are a
period apart also where its clock is not the executive's. m, m/s, m/s^2, N, rad/s. Contract:
plants/evaluation.py.
"""

import math
from functools import partial

import numpy as np

from pcpc.plants.evaluation import *
from pcpc.plants.judging import edges

SPEED, EXTENSION = "plant:car.body_rate_m_s", "plant:car.extension_m"
DESIRED, FORCE = "executive:controller.desired_N", "executive:controller.force_N"
SMALLEST_OSCILLATION_M_S = 1e-3  # below it a crossing is no oscillation


def acceleration(run: Run) -> Vector:
    """Return (2); NaN without a sample before and after. Shape (n,)."""
    return (run.after(run[SPEED]) - run.before(run[SPEED])) / (2.0 * run.period_s)


def oscillation(judged: Judged) -> float:
    """Return (7), interpolating between samples; NaN for fewer than three crossings."""
    mean = judged.measured({"mean": Mean(SPEED)}, "plant")["mean"]
    first, past = edges(judged.period_s, *judged.windows[WINDOW])

    def crossings(run: Run) -> Vector:
        """Return the cycles, from the window's first on, at which the deviation is 0."""
        here = run[SPEED] - mean
        there = run.after(here)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = run.cycle - first + here / (here - there)
        inside = (run.cycle >= first) & (run.cycle < past - 1)
        return np.where(inside & ((here < 0.0) != (there < 0.0)), at, math.nan)

    merits = {
        "away": Peak(lambda run: run[SPEED] - mean),
        "begin": Lowest(crossings),
        "end": Highest(crossings),
        "count": Count(crossings),
    }
    figures = judged.measured(merits, "plant")
    if not figures["away"] > SMALLEST_OSCILLATION_M_S or figures["count"] < 3:
        return math.nan
    return (
        math.pi * (figures["count"] - 1) / ((figures["end"] - figures["begin"]) * judged.period_s)
    )


def stop_m(run: Run) -> float:
    """Return where the bump stops are, NaN if there are none."""
    return run.setting("stop_m") if run.setting("limits_on") == 1.0 else math.nan


def hydraulic(run: Run) -> bool:
    """Return whether the strut is hydraulic, not ideal."""
    return run.setting("strut") == 1.0


def of_strut(source: str) -> Signal:
    """Return what the controller knows of a hydraulic strut, NaN of another one."""

    def hydraulic_values(run: Run) -> Vector:
        values = run.get(source)
        return values if hydraulic(run) else np.full_like(values, math.nan)

    return hydraulic_values


def learns(run: Run) -> bool:
    """Return whether the controller has a fuzzy system for the valve."""
    return hydraulic(run) and run.has("executive:controller.wanted_spool_m")


def scaled_line(scale: float, source: str, label: str, colour: str, width: float = 0.9) -> Line:
    """Return a line in another unit than the log's."""
    return Line(lambda run: scale * run.get(source), label, colour, width)


PlantRms, PlantPeak = partial(Rms, leader="plant"), partial(Peak, leader="plant")
EVALUATION = Evaluation(
    merits={
        "speed_rms_m_s": PlantRms(SPEED),
        "speed_max_m_s": PlantPeak(SPEED),
        "acceleration_rms_m_s2": PlantRms(acceleration),
        "extension_min_m": Lowest(EXTENSION, leader="plant"),
        "extension_max_m": Highest(EXTENSION, leader="plant"),
        "spool_max_m": PlantPeak("plant:car.spool_m"),
        "oscillation_rad_s": oscillation,
        "theta_norm_max_m": Peak("executive:controller.norm_theta_m", RUN),
        "theta_max_m": Peak("executive:controller.largest_theta_m", RUN),
        "force_error_rms_N": Rms(of_strut("executive:controller.ef_N")),
        "desired_sd_N": Deviation(of_strut(DESIRED)),
        "force_correlation": Correlation(
            lambda run: np.column_stack((of_strut(DESIRED)(run), of_strut(FORCE)(run)))
        ),
    },
    panels=(
        Panel("speed [m/s]", (Line(SPEED, "body", BLUE),)),
        Panel(
            "position [m]",
            (
                Line("plant:car.ground_m", "road", GREY, 0.8),
                Line(EXTENSION, "strut extension", VERMILION, 0.9),
            ),
            levels=(Level(stop_m, "stops", BLACK),),
        ),
        Panel(
            "force [kN]",
            (
                scaled_line(1e-3, "plant:car.strut_N", "strut", VERMILION),
                scaled_line(1e-3, DESIRED, "desired", BLUE),
                scaled_line(1e-3, "plant:car.bump_N", "bump stops", GREY, 0.8),
            ),
            6.0,
        ),
        Panel(
            "valve [mm]",
            (
                scaled_line(1e3, "executive:controller.wanted_spool_m", "wanted", SKY, 2.2),
                scaled_line(1e3, "plant:car.spool_m", "spool", VERMILION),
            ),
            4.0,
            when=hydraulic,
        ),
        Panel(
            "pressure [MPa]",
            (
                scaled_line(1e-6, "plant:car.p1_Pa", "bore side", BLUE),
                scaled_line(1e-6, "plant:car.p2_Pa", "rod side", GREEN, 0.8),
            ),
            4.0,
            when=hydraulic,
        ),
        Panel(
            "fuzzy [mm]",
            (
                scaled_line(1e3, "executive:controller.drift_m", "drift", BLUE, 0.8),
                scaled_line(1e3, "executive:controller.norm_theta_m", "norm of all rules", PURPLE),
            ),
            4.0,
            when=learns,
        ),
    ),
    notes=(
        (
            "body speed rms {speed_rms_m_s:.4f}, largest {speed_max_m_s:.4f} m/s",
            "acceleration rms {acceleration_rms_m_s2:.2f} m/s2",
            "force error rms {force_error_rms_N:.0f} N",
        ),
        (
            "strut {extension_min_m:.3f} to {extension_max_m:.3f} m",
            "spool at most {spool_max_m:.2g} m",
        ),
    ),
)
