"""What judges and draws a run of the pendulum behind backlash.

    e1 = q - q_d, e2 = q' - q_d'        from the plant's true state                          (1)
    tt = tau_d - tau                    desired against true torque behind the gap           (2)

Windows, and which record of the plant belongs to a cycle: plants/judging.py. Metrics in mrad,
mrad/s, N m, s.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pcpc.executive.log.reader import Log
from pcpc.plants.judging import Measure, Run, Vector, known, measured, reaches
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
from pcpc.plants.statistics import HIGH, LAST, PEAK, RMS

MRAD = 1e3
SETTLED_RAD = 0.01
STARTED_S = 0.5  # the start would hide the rest in a panel


def error_rad(run: Run) -> Vector:
    """Return e1 of (1)."""
    return run.plant("pendulum.true_angle_rad") - run.executive("reference.q_d_rad")


def rate_error_rad_s(run: Run) -> Vector:
    """Return e2 of (1)."""
    return run.plant("pendulum.true_rate_rad_s") - run.executive("reference.q_d_rate_rad_s")


def torque_error_Nm(run: Run) -> Vector:
    """Return tt of (2)."""
    wanted = run.executive("controller.tau_d_Nm", or_nan=True)
    return wanted - run.plant("pendulum.true_torque_Nm")


def started(run: Run, values: Vector) -> Vector:
    """Return `values` from 0.5 s on, NaN before."""
    return np.where(run.t_s < STARTED_S, np.nan, values)


def metrics(
    log: Log, window_s: tuple[float, float], numbers: Mapping[str, float], period_s: float
) -> dict[str, float]:
    """Return what the log tells about a run; {} without a cycle in the window.

    `numbers`: `transient_from_s` and `transient_to_s` ask for `error_transient_mrad`.
    `settled_s` is the last time of the run with |e1| > 0.01 rad. Without the plant's record what
    needs the true state is absent.
    """
    if not reaches(log, period_s, window_s, "executive"):
        return {}
    measures = {
        "error_rms_mrad": Measure(error_rad, RMS, window_s, MRAD),
        "error_max_mrad": Measure(error_rad, PEAK, window_s, MRAD),
        "rate_error_rms_mrad_s": Measure(rate_error_rad_s, RMS, window_s, MRAD),
        "torque_error_rms_Nm": Measure(torque_error_Nm, RMS, window_s),
        "command_max_Nm": Measure(lambda run: run.executive("controller.command_Nm"), PEAK),
        "settled_s": Measure(unsettled_s, HIGH),
        "norm_w_max": Measure(norm_w, PEAK),
        "norm_w_end": Measure(norm_w, LAST),
        "latched_off": Measure(lambda run: run.executive("controller.diverged", or_nan=True), PEAK),
    }
    if "transient_from_s" in numbers:
        part = numbers["transient_from_s"], numbers["transient_to_s"]
        measures["error_transient_mrad"] = Measure(error_rad, RMS, part, MRAD)
    return known(measured(log, period_s, measures))


def norm_w(run: Run) -> Vector:
    """Return |W|; NaN for a law without it."""
    return run.executive("controller.norm_w", or_nan=True)


def unsettled_s(run: Run) -> Vector:
    """Return the times with |e1| > 0.01 rad, NaN else."""
    return np.where(np.abs(error_rad(run)) > SETTLED_RAD, run.t_s, np.nan)


PANELS = (
    Panel(
        "angle [rad]",
        (
            Line("executive:reference.q_d_rad", "desired", BLACK, 1.6, "--"),
            Line("plant:pendulum.true_angle_rad", "true", BLUE),
        ),
    ),
    Panel(
        "error [mrad]",
        (
            Line(
                lambda run: started(run, MRAD * error_rad(run)), "q - q_d from 0.5 s on", VERMILION
            ),
        ),
    ),
    Panel(
        "torque [N m]",
        (
            Line("plant:pendulum.acting_Nm", "command before the gap", GREY),
            Line("executive:controller.tau_d_Nm", "desired", BLACK, 1.6, "--"),
            Line("plant:pendulum.true_torque_Nm", "behind the gap", BLUE),
        ),
        6.0,
    ),
    Panel(
        "torque error [N m]",
        (
            Line(
                lambda run: started(run, torque_error_Nm(run)),
                "desired - true from 0.5 s on",
                VERMILION,
            ),
        ),
    ),
    Panel(
        "terms of u' [N m/s]",
        (
            Line(
                lambda run: started(run, run.executive("controller.robust_Nm_s", or_nan=True)),
                "robust from 0.5 s on",
                ORANGE,
            ),
            Line(
                lambda run: started(run, run.executive("controller.network_Nm_s", or_nan=True)),
                "network from 0.5 s on",
                GREEN,
            ),
        ),
    ),
    Panel(
        "weights",
        (
            Line("executive:controller.norm_w", "|W|", GREEN),
            Line("executive:controller.norm_v", "|V|", PURPLE),
        ),
        4.0,
    ),
)


def figure(
    log: Log, path: Path, title: str, metrics: Mapping[str, float], window_s: tuple[float, float]
) -> None:
    """Write one PNG, 1200 x 1500 pixels; ImportError, with the cure, without matplotlib."""
    text = (
        f"shaded: {window_s[0]:g} to {window_s[1]:g} s; error rms "
        f"{metrics.get('error_rms_mrad', float('nan')):.2f} mrad, largest "
        f"{metrics.get('error_max_mrad', float('nan')):.2f} mrad; torque error rms "
        f"{metrics.get('torque_error_rms_Nm', float('nan')):.3f} N m\n"
        f"largest command {metrics.get('command_max_Nm', float('nan')):.1f} N m; |e| above 10 mrad "
        f"for the last time at {metrics.get('settled_s', float('nan')):.2f} s"
    )
    draw_page(log, path, title, text, window_s, PANELS)
