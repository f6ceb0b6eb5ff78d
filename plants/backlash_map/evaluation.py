"""What judges and draws a run of the map behind backlash.

    e  = x2 - x_d                       from the plant's true state                          (1)
    tt = tau_d - tau                    desired torque against the true one of the same step (2)
    du = |u(k+1) - u(k)|                jumps of the command                                 (3)

Windows, and which record of the plant belongs to a cycle: plants/judging.py. Without units, but s.
With `ahead` 0 the plant's record of cycle k+1 holds the tau that answers the tau_d of cycle k.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pcpc.executive.log.reader import Log
from pcpc.plants.judging import Measure, Run, Vector, known, measured, reaches
from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, VERMILION, Line, Panel, draw_page
from pcpc.plants.statistics import HIGH, MEAN, MEDIAN, PEAK, RMS

SETTLED = 0.05
JUMP = 0.3
STARTED_S = 0.5  # the start would hide the rest in a panel


def error(run: Run) -> Vector:
    """Return e of (1)."""
    return run.plant("map.true_x2") - run.executive("reference.now")


def tau_error(run: Run) -> Vector:
    """Return tt of (2)."""
    tau, ahead = run.plant("map.true_tau"), run.executive("controller.ahead")
    answer = np.where(ahead > 0.5, tau, run.after(tau))
    return run.executive("controller.tau_d") - answer


def started(run: Run, values: Vector) -> Vector:
    """Return `values` from 0.5 s on, NaN before."""
    return np.where(run.t_s < STARTED_S, np.nan, values)


def metrics(
    log: Log, window_s: tuple[float, float], numbers: Mapping[str, float], period_s: float
) -> dict[str, float]:
    """Return what the log tells about a run; {} without a cycle in the window.

    `numbers`: `early_from_s` and `early_to_s` ask for `error_early_...` in that window, for
    `settled_early_s`, the last time before its end with |e| > 0.05, and for `error_half_max`, the
    largest |e| from 0.5 s to its end. `settled_s` is the last such time of the run. Without the
    plant's record what needs the true state is absent.
    """
    if not reaches(log, period_s, window_s, "executive"):
        return {}
    measures = {
        "error_rms": Measure(error, RMS, window_s),
        "error_max": Measure(error, PEAK, window_s),
        "tau_error_rms": Measure(tau_error, RMS, window_s),
        "x2_max": Measure(lambda run: run.plant("map.true_x2"), PEAK),
        "command_max": Measure(lambda run: run.executive("controller.command"), PEAK),
        "command_jump_median": Measure(jump, MEDIAN),
        "command_jumps_share": Measure(is_jump, MEAN),
        "settled_s": Measure(unsettled_s, HIGH),
        "latched_off": Measure(lambda run: run.executive("controller.diverged", or_nan=True), PEAK),
    }
    if "early_from_s" in numbers:
        early = numbers["early_from_s"], numbers["early_to_s"]
        measures["error_early_rms"] = Measure(error, RMS, early)
        measures["error_early_max"] = Measure(error, PEAK, early)
        measures["error_half_max"] = Measure(error, PEAK, (0.5, early[1]))
        measures["settled_early_s"] = Measure(
            lambda run: np.where(run.t_s < early[1], unsettled_s(run), np.nan), HIGH
        )
    return known(measured(log, period_s, measures))


def jump(run: Run) -> Vector:
    """Return du of (3)."""
    return np.abs(run.step(run.executive("controller.command")))


def is_jump(run: Run) -> Vector:
    """Return 1 where the command jumps by more than `JUMP`, else 0; NaN where nothing is known."""
    du = jump(run)
    return np.where(np.isfinite(du), du > JUMP, np.nan)


def unsettled_s(run: Run) -> Vector:
    """Return the times with |e| beyond 0.05, NaN else."""
    return np.where(np.abs(error(run)) > SETTLED, run.t_s, np.nan)


PANELS = (
    Panel(
        "state",
        (
            Line("executive:reference.now", "x_d", BLACK, 1.6, "--"),
            Line("plant:map.true_x2", "x2", BLUE),
        ),
        6.0,
    ),
    Panel(
        "error x2 - x_d", (Line(lambda run: started(run, error(run)), "from 0.5 s on", VERMILION),)
    ),
    Panel("command u", (Line("plant:map.acting", "before the gap", GREY, 0.7),)),
    Panel(
        "tau",
        (
            Line("plant:map.true_tau", "behind the gap", BLUE),
            Line("executive:controller.tau_d", "desired", BLACK, 1.2, "--"),
        ),
        6.0,
    ),
    Panel(
        "tau error",
        (
            Line(
                lambda run: started(run, tau_error(run)),
                "desired - true from 0.5 s on",
                VERMILION,
                0.7,
            ),
        ),
    ),
    Panel("weights", (Line("executive:controller.norm_w", "|W|", GREEN),), 4.0),
)


def figure(
    log: Log, path: Path, title: str, metrics: Mapping[str, float], window_s: tuple[float, float]
) -> None:
    """Write one PNG, 1200 x 1500 pixels; ImportError, with the cure, without matplotlib."""
    none = float("nan")
    text = (
        f"shaded: {window_s[0]:g} to {window_s[1]:g} s; error rms "
        f"{metrics.get('error_rms', none):.4f}, largest {metrics.get('error_max', none):.4f}; "
        f"|e| above 0.05 for the last time at {metrics.get('settled_s', none):.2f} s\n"
        f"jumps of u: median {metrics.get('command_jump_median', none):.2f}, beyond {JUMP:g} in "
        f"{100 * metrics.get('command_jumps_share', none):.0f} % of the steps"
    )
    draw_page(log, path, title, text, window_s, PANELS)
