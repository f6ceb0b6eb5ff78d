"""What judges and draws a run of the barrel: pointing errors against the plant's true state.

    hub error     q_d - theta                                                               (1)
    muzzle error  q_d - (theta + slope'q - droop(q_d))                                      (2)
    droop(q_d)    static muzzle slope, droop(theta) cos q_d / cos theta; calibrated out     (3)
    u             motor torque command, saturated, times the gear ratio                     (4)

Windows, and which record of the plant belongs to a cycle: plants/judging.py.
Inside rad, s, N m; metrics in mrad, s, N m at the output. The definitions are this project's.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pcpc.executive.log.reader import Log
from pcpc.plants.judging import (
    Mask,
    Measure,
    Run,
    Signal,
    Vector,
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
    VERMILION,
    draw_lateness,
    draw_line,
    dress,
    new_page,
    traces,
    was_clocked,
)
from pcpc.plants.statistics import COUNT, HIGH, MEAN, PEAK, RMS, STD, peak

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SETTLED_RAD = 2e-3
MRAD = 1e3

ONE_DEGREE_RAD = math.pi / 180


@dataclass(frozen=True)
class Signals:
    """A run, or a stretch of it, by executive cycle, all (n,); NaN where the log does not tell."""

    true: Mask  # the plant's record is there
    q_d_rad: Vector
    theta_rad: Vector  # measured, as its error, if no cycle has the plant's record
    hub_error_rad: Vector
    muzzle_error_rad: Vector
    elastic_rad: Vector
    slope1_rad: Vector
    gear_torque_Nm: Vector
    motor_torque_Nm: Vector  # the command


def signals(run: Run) -> Signals:
    """Pair the records of both nodes, form the errors (1) and (2)."""

    def told(name: str) -> Vector:
        return run.executive(name, or_nan=True)

    def truth(name: str) -> Vector:
        return run.plant(f"barrel.{name}", or_nan=True)

    q_d, theta, elastic = told("reference.q_d_rad"), truth("theta_rad"), truth("elastic_slope_rad")
    true = run.plant_told
    if not run.plant_tells:
        theta = q_d - told("controller.e_rad")
    with np.errstate(invalid="ignore"):  # of an infinite theta
        droop = truth("droop_rad") * np.cos(q_d) / np.cos(theta)  # (3)
    return Signals(
        true, q_d, theta,
        q_d - theta,  # (1)
        q_d - (theta + elastic - droop),  # (2)
        elastic, truth("slope1_rad"), truth("gear_torque_Nm"), told("controller.motor_torque_Nm"),
    )  # fmt: skip


def _signal(name: str) -> Signal:
    """Return one of `Signals` as a function of a run."""

    def of(run: Run) -> Vector:
        found: Vector = getattr(run.once(signals), name)
        return found

    return of


HUB_ERROR, MUZZLE_ERROR = _signal("hub_error_rad"), _signal("muzzle_error_rad")


def metrics(
    log: Log, window_s: tuple[float, float], numbers: Mapping[str, float], period_s: float
) -> dict[str, float]:
    """Return what the log tells about a run; {} without a cycle in the window.

    `numbers`: `rest`, `settle` and `vibration`, each with `_from_s` and `_to_s` (default: the end),
    ask for `muzzle_rest_mrad`, `settle_2mrad_s` (inf: never), `vibration_mrad` with
    `vibration1_mrad`; `gear_ratio` overrides the rig's. Values that are not finite are left out,
    but do not count as settled. Without the plant's record the hub error is the measured one, and
    what needs the true state is absent.
    """
    if not reaches(log, period_s, window_s, "executive"):
        return {}
    ratio = numbers.get("gear_ratio", setting(log, "gear_ratio"))

    def command_Nm(run: Run) -> Vector:
        return run.once(signals).motor_torque_Nm * ratio  # (4)

    def command_step_Nm(run: Run) -> Vector:  # also from the cycle before the window
        return run.step(command_Nm(run))

    measures = {
        "muzzle_error_rms_mrad": Measure(MUZZLE_ERROR, RMS, window_s, MRAD),
        "muzzle_error_max_mrad": Measure(MUZZLE_ERROR, PEAK, window_s, MRAD),
        "hub_error_rms_mrad": Measure(HUB_ERROR, RMS, window_s, MRAD),
        "hub_error_max_mrad": Measure(HUB_ERROR, PEAK, window_s, MRAD),
        "effort_rms_Nm": Measure(command_Nm, RMS, window_s),
        "command_step_rms_Nm": Measure(command_step_Nm, RMS, window_s),
    }
    if (part := _part(numbers, "rest")) is not None:
        measures["muzzle_rest_mrad"] = Measure(
            lambda run: np.abs(MUZZLE_ERROR(run)), MEAN, part, MRAD
        )
    if (part := _part(numbers, "settle")) is not None:
        measures["seen_s"] = Measure(_seen_s, HIGH, part)
        measures["outside_s"] = Measure(_outside_s, HIGH, part)
    if (part := _part(numbers, "vibration")) is not None:
        measures["vibration_mrad"] = Measure(_signal("elastic_rad"), STD, part, MRAD)
        measures["vibration1_mrad"] = Measure(_signal("slope1_rad"), STD, part, MRAD)
    found = measured(log, period_s, measures)
    if "seen_s" in found:
        ends = found.pop("seen_s"), found.pop("outside_s")
        found["settle_2mrad_s"] = _settling(*ends, period_s, numbers["settle_from_s"])
    return known(found)


def _part(numbers: Mapping[str, float], name: str) -> tuple[float, float] | None:
    """Return a metric's own window; None where `numbers` does not ask for it."""
    if f"{name}_from_s" not in numbers:
        return None
    return numbers[f"{name}_from_s"], numbers.get(f"{name}_to_s", math.inf)


def _seen_s(run: Run) -> Vector:
    """Return the times of the cycles with the plant's record, NaN else."""
    return np.where(run.once(signals).true, run.t_s, math.nan)


def _outside_s(run: Run) -> Vector:
    """Return those of them that are not settled."""
    outside = ~(np.abs(MUZZLE_ERROR(run)) <= SETTLED_RAD)  # so is NaN
    return np.where(outside, _seen_s(run), math.nan)


def _settling(seen_s: float, outside_s: float, period_s: float, from_s: float) -> float:
    """Return the time to the last cycle outside plus a period; inf if none comes after it."""
    if math.isnan(seen_s):
        return math.nan
    if outside_s == seen_s:
        return math.inf
    return 0.0 if math.isnan(outside_s) else outside_s + period_s - from_s


def figure(
    log: Log, path: Path, title: str, metrics: Mapping[str, float], window_s: tuple[float, float]
) -> None:
    """Write one PNG, 1200 x 1500 pixels; `metrics` stand under the title, the window is shaded.

    Below elevation, errors, elastic slope and command: the wake-up of a paced run, the shaft torque
    of a run without clock. Raises ImportError, with the cure, where matplotlib is not installed.
    """
    page, axes = new_page((5, 6, 4, 5, 4), title, _summary(metrics, window_s))
    end_s = window_s[1]
    if "executive" in log.node and len(log.node["executive"].cycle):
        period_s = 1e-9 * float(log.metadata["executive"]["period_ns"])
        end_s = period_s * (int(log.node["executive"].cycle[-1]) + 1)
        lines = _lines(log, period_s)
        _draw_pointing(axes[0], axes[1], lines, "settle_2mrad_s" in metrics)
        _draw(axes[2], lines["elastic_rad"], MRAD, "elastic slope at the muzzle", GREEN)
        _draw_command(axes[3], lines, setting(log, "gear_ratio"), setting(log, "tau_max_Nm"))
        if was_clocked(log):
            draw_lateness(axes[4], period_s, log)
            axes[4].set_ylabel("wake-up [us]")
        else:
            style = {"linewidth": 0.8}
            _draw(axes[4], lines["gear_torque_Nm"], 1.0, "shaft torque on the hub", BLUE, **style)
            axes[4].set_ylabel("torque [N m]")
        _mark_tunings(axes, period_s, log)
    axes[2].set_ylabel("slope [mrad]")
    axes[4].set_xlabel("time [s]")
    for ax in axes:
        dress(ax, window_s)
    axes[0].set_xlim(0.0, end_s)
    page.align_ylabels(axes)
    page.savefig(path, format="png")


def _mark_tunings(axes: Any, period_s: float, log: Log) -> None:
    """Draw a line through all axes where parameters were tuned, and name them in the second."""
    for cycle in sorted({int(tuning["cycle"]) for tuning in log.node["executive"].tunings}):
        names = [t for t in log.node["executive"].tunings if t["cycle"] == cycle]
        words = ", ".join(f"{t['name']} = {t['value']:g}" for t in names[:2])
        for ax in axes:
            ax.axvline(cycle * period_s, color=BLACK, linewidth=0.8, linestyle=":")
        axes[1].annotate(
            words, (cycle * period_s, 0.04), xycoords=("data", "axes fraction"), fontsize=7,
            xytext=(3, 0), textcoords="offset points",
        )  # fmt: skip


_SUMMARY = (  # of the two lines under the title; what is not known is left out
    (
        ("muzzle error {:.3g} rms, {:.3g} max mrad", "muzzle_error_rms_mrad muzzle_error_max_mrad"),
        ("hub error {:.3g} rms, {:.3g} max mrad", "hub_error_rms_mrad hub_error_max_mrad"),
        ("command {:.3g} rms, {:.3g} step N m", "effort_rms_Nm command_step_rms_Nm"),
    ),
    (
        ("muzzle at rest {:.3g} mrad", "muzzle_rest_mrad"),
        ("within 2 mrad after {:.3g} s", "settle_2mrad_s"),
        ("vibration {:.3g}, mode 1 {:.3g} mrad", "vibration_mrad vibration1_mrad"),
    ),
)


def _summary(metrics: Mapping[str, float], window_s: tuple[float, float]) -> str:
    parts: list[list[str]] = [[], [f"shaded {window_s[0]:g} to {window_s[1]:g} s"]]
    for line, entries in zip(parts, _SUMMARY, strict=True):
        for text, names in entries:
            if all(name in metrics for name in names.split()):
                line.append(text.format(*(metrics[name] for name in names.split())))
    text = "\n".join("   ·   ".join(line) for line in parts)
    return text.replace("within 2 mrad after inf s", "not settled to 2 mrad")


@dataclass(frozen=True)
class Lines:
    """The drawn signals by name, each as (t, values); `true`: they are the plant's own."""

    of: Mapping[str, tuple[Vector, Vector]]
    true: bool

    def __getitem__(self, name: str) -> tuple[Vector, Vector]:
        return self.of[name]


_DRAWN = (
    "q_d_rad", "theta_rad", "hub_error_rad", "muzzle_error_rad", "elastic_rad", "gear_torque_Nm",
    "motor_torque_Nm",
)  # fmt: skip


def _lines(log: Log, period_s: float) -> Lines:
    found = traces(log, period_s, [_signal(name) for name in _DRAWN])
    seen = Measure(_seen_s, COUNT)
    true = measured(log, period_s, {"seen": seen})["seen"] > 0
    return Lines(dict(zip(_DRAWN, found, strict=True)), true)


def _draw(
    ax: "Axes", line: tuple[Vector, Vector], scale: float, label: str, colour: str, **style: Any
) -> None:
    draw_line(ax, line[0], scale * line[1], label, colour, **style)


def _draw_pointing(angle: "Axes", error: "Axes", lines: Lines, settles: bool) -> None:
    measured = "" if lines.true else ", measured"
    in_degrees = peak(lines["q_d_rad"][1]) >= ONE_DEGREE_RAD
    scale = 1 / ONE_DEGREE_RAD if in_degrees else MRAD
    _draw(angle, lines["theta_rad"], scale, f"hub angle{measured}", BLUE)
    _draw(angle, lines["q_d_rad"], scale, "reference", BLACK, linewidth=0.9, linestyle="--")
    angle.set_ylabel("elevation [deg]" if in_degrees else "elevation [mrad]")
    _draw(error, lines["muzzle_error_rad"], MRAD, "muzzle error", VERMILION, linewidth=1.5)
    _draw(error, lines["hub_error_rad"], MRAD, f"hub error{measured}", BLUE, linewidth=0.7)
    if settles:
        for bound in (-MRAD * SETTLED_RAD, MRAD * SETTLED_RAD):
            error.axhline(bound, color=GREY, linewidth=0.7, linestyle=":")
    error.set_ylabel("error [mrad]")


def _draw_command(ax: "Axes", lines: Lines, ratio: float, limit_Nm: float) -> None:
    """Draw the command; its limits where they are in sight, else their value."""
    place = "at the motor" if math.isnan(ratio) else "at the output"
    t, u = lines["motor_torque_Nm"]
    u = u * (1.0 if math.isnan(ratio) else ratio)
    draw_line(ax, t, u, f"torque command {place}", BLACK, linewidth=0.8)
    seen = limit_Nm <= 2.0 * peak(u)
    if seen:
        for bound in (-limit_Nm, limit_Nm):
            ax.axhline(bound, color=VERMILION, linewidth=0.9, linestyle="--")
    if not math.isnan(ratio * limit_Nm):
        label = f"limit ±{limit_Nm:g} N m{'' if seen else ', out of view'}"
        ax.plot([], [], color=VERMILION, linewidth=0.9, linestyle="--", label=label)
    ax.set_ylabel("command [N m]")
