"""What judges and draws a run of the barrel: pointing errors against the plant's true state.

    hub error     q_d - theta                                                               (1)
    muzzle error  q_d - (theta + slope'q - droop(q_d))                                      (2)
    droop(q_d)    static muzzle slope, droop(theta) cos q_d / cos theta; calibrated out     (3)
    u             motor torque command, saturated, times the gear ratio                     (4)
    r             (q_d' - theta') + Lam (q_d - theta), from the true state                  (5)
    |r| < (sup|w| + kappa Z_B^2/4)/Kv,  w = M r' + Kv r: what the network left over         (6)

Windows, and which record of the plant belongs to a cycle: plants/judging.py.
Inside rad, s, N m; metrics in mrad, s, N m at the output. The definitions are this project's.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from executive.logs import Log
from plants.judging import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    VERMILION,
    Mask,
    Vector,
    between,
    draw_lateness,
    draw_line,
    dress,
    new_page,
    over_finite,
    peak,
    plant_rows,
    rms,
    setting,
    was_clocked,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SETTLED_RAD = 2e-3
MOVED_INERTIA_KG_M2 = 3.580  # nominal: hub, straight barrel, rotor through the gear
MRAD = 1e3

ONE_DEGREE_RAD = math.pi / 180


@dataclass(frozen=True)
class Signals:
    """A run by executive cycle, all (n,); NaN where the log does not tell."""

    period_s: float
    cycle: NDArray[np.int64]
    true: Mask  # the plant's record is there
    q_d_rad: Vector
    theta_rad: Vector  # measured, as its error, if no cycle has the plant's record
    hub_error_rad: Vector
    muzzle_error_rad: Vector
    elastic_rad: Vector
    slope1_rad: Vector
    gear_torque_Nm: Vector
    motor_torque_Nm: Vector  # the command

    @property
    def t_s(self) -> Vector:
        """Time of the cycles."""
        return np.asarray(self.cycle * self.period_s, np.float64)

    def between(self, begin_s: float, end_s: float) -> Mask:
        """Return which cycles are in the window [begin, end)."""
        return between(self.cycle, self.period_s, begin_s, end_s)


def signals(log: Log, period_s: float) -> Signals:
    """Pair the records of both nodes, form the errors (1) and (2). The log has an executive."""
    executive, plant = log.node["executive"], log.node.get("plant")
    rows = plant_rows(log, period_s)
    unknown = np.full(len(rows), math.nan)
    truths = plant.columns if plant and (rows >= 0).any() else {}

    def told(name: str) -> Vector:
        return executive.columns.get(name, unknown)

    def truth(name: str) -> Vector:
        values = truths.get(f"barrel.{name}")
        return unknown if values is None else np.where(rows < 0, math.nan, values[rows])

    q_d, theta, elastic = told("reference.q_d_rad"), truth("theta_rad"), truth("elastic_slope_rad")
    true = (rows >= 0) if "barrel.theta_rad" in truths else rows < -1
    if not true.any():
        theta = q_d - told("controller.e_rad")
    with np.errstate(invalid="ignore"):  # of an infinite theta
        droop = truth("droop_rad") * np.cos(q_d) / np.cos(theta)  # (3)
    return Signals(
        period_s, executive.cycle, true, q_d, theta,
        q_d - theta,  # (1)
        q_d - (theta + elastic - droop),  # (2)
        elastic, truth("slope1_rad"), truth("gear_torque_Nm"), told("controller.motor_torque_Nm"),
    )  # fmt: skip


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
    if "executive" not in log.node:
        return {}
    run = signals(log, period_s)
    window = run.between(*window_s)
    if not window.any():
        return {}
    u = run.motor_torque_Nm * numbers.get("gear_ratio", setting(log, "gear_ratio"))  # (4)
    into = (np.diff(run.cycle) == 1) & window[1:]  # also from the cycle before the window
    found = {
        "muzzle_error_rms_mrad": MRAD * rms(run.muzzle_error_rad[window]),
        "muzzle_error_max_mrad": MRAD * peak(run.muzzle_error_rad[window]),
        "hub_error_rms_mrad": MRAD * rms(run.hub_error_rad[window]),
        "hub_error_max_mrad": MRAD * peak(run.hub_error_rad[window]),
        "effort_rms_Nm": rms(u[window]),
        "command_step_rms_Nm": rms(np.diff(u)[into]),
    }
    if (part := _part(run, numbers, "rest")) is not None:
        found["muzzle_rest_mrad"] = MRAD * over_finite(np.abs(run.muzzle_error_rad[part]), np.mean)
    if (part := _part(run, numbers, "settle")) is not None:
        found["settle_2mrad_s"] = _settling(run, part, numbers["settle_from_s"])
    if (part := _part(run, numbers, "vibration")) is not None:
        found["vibration_mrad"] = MRAD * over_finite(run.elastic_rad[part], np.std)
        found["vibration1_mrad"] = MRAD * over_finite(run.slope1_rad[part], np.std)
    if "controller.norm_z" in log.node["executive"].columns:
        found |= _bound(log, run, window)
    return {name: value for name, value in found.items() if not math.isnan(value)}


def _bound(log: Log, run: Signals, window: Mask) -> dict[str, float]:
    """Return the largest filtered error and the bound of the theory (6), from the window."""
    lam, kv = setting(log, "lam_per_s"), setting(log, "kv_Nms_rad")
    rows = plant_rows(log, run.period_s)
    plant = log.node.get("plant")
    if plant is None or not (rows >= 0).any():
        return {}
    rate = np.where(rows < 0, math.nan, plant.columns["barrel.theta_rate_rad_s"][rows])
    desired = log.node["executive"].columns["reference.q_d_rate_rad_s"]
    r = (desired - rate) + lam * run.hub_error_rad  # (5)
    w = MOVED_INERTIA_KG_M2 * np.gradient(r, run.period_s) + kv * r
    leak = setting(log, "kappa") * setting(log, "z_bound") ** 2 / 4.0
    return {
        "filtered_error_max_rad_s": peak(r[window]),
        "filtered_error_bound_rad_s": (peak(w[window]) + leak) / kv,  # (6)
    }


def _part(run: Signals, numbers: Mapping[str, float], name: str) -> Mask | None:
    """Return the cycles of a metric's own window; None where `numbers` does not ask for it."""
    if f"{name}_from_s" not in numbers:
        return None
    return run.between(numbers[f"{name}_from_s"], numbers.get(f"{name}_to_s", math.inf))


def _settling(run: Signals, part: Mask, from_s: float) -> float:
    """Return the time to the last cycle outside plus a period; inf if none comes after it."""
    part = part & run.true
    if not part.any():
        return math.nan
    outside = ~(np.abs(run.muzzle_error_rad[part]) <= SETTLED_RAD)  # so is NaN
    if outside[-1]:
        return math.inf
    return float(run.t_s[part][outside][-1]) + run.period_s - from_s if outside.any() else 0.0


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
        run = signals(log, 1e-9 * float(log.metadata["executive"]["period_ns"]))
        end_s = float(run.t_s[-1]) + run.period_s
        _draw_pointing(axes[0], axes[1], run, "settle_2mrad_s" in metrics)
        draw_line(axes[2], run.t_s, MRAD * run.elastic_rad, "elastic slope at the muzzle", GREEN)
        _draw_command(axes[3], run, setting(log, "gear_ratio"), setting(log, "tau_max_Nm"))
        _draw_timing(axes[4], run, log)
        _mark_tunings(axes, run.period_s, log)
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


def _draw_pointing(angle: "Axes", error: "Axes", run: Signals, settles: bool) -> None:
    measured = "" if run.true.any() else ", measured"
    in_degrees = peak(run.q_d_rad) >= ONE_DEGREE_RAD
    scale = 1 / ONE_DEGREE_RAD if in_degrees else MRAD
    draw_line(angle, run.t_s, scale * run.theta_rad, f"hub angle{measured}", BLUE)
    draw_line(
        angle, run.t_s, scale * run.q_d_rad, "reference", BLACK, linewidth=0.9, linestyle="--"
    )
    angle.set_ylabel("elevation [deg]" if in_degrees else "elevation [mrad]")
    draw_line(error, run.t_s, MRAD * run.muzzle_error_rad, "muzzle error", VERMILION, linewidth=1.5)
    draw_line(error, run.t_s, MRAD * run.hub_error_rad, f"hub error{measured}", BLUE, linewidth=0.7)
    if settles:
        for bound in (-MRAD * SETTLED_RAD, MRAD * SETTLED_RAD):
            error.axhline(bound, color=GREY, linewidth=0.7, linestyle=":")
    error.set_ylabel("error [mrad]")


def _draw_command(ax: "Axes", run: Signals, ratio: float, limit_Nm: float) -> None:
    """Draw the command; its limits where they are in sight, else their value."""
    place = "at the motor" if math.isnan(ratio) else "at the output"
    u = run.motor_torque_Nm * (1.0 if math.isnan(ratio) else ratio)
    draw_line(ax, run.t_s, u, f"torque command {place}", BLACK, linewidth=0.8)
    seen = limit_Nm <= 2.0 * peak(u)
    if seen:
        for bound in (-limit_Nm, limit_Nm):
            ax.axhline(bound, color=VERMILION, linewidth=0.9, linestyle="--")
    if not math.isnan(ratio * limit_Nm):
        label = f"limit ±{limit_Nm:g} N m{'' if seen else ', out of view'}"
        ax.plot([], [], color=VERMILION, linewidth=0.9, linestyle="--", label=label)
    ax.set_ylabel("command [N m]")


def _draw_timing(ax: "Axes", run: Signals, log: Log) -> None:
    """Draw how late a paced executive woke up; without a clock the torque on the hub."""
    if was_clocked(log):
        draw_lateness(ax, run.t_s, log)
        ax.set_ylabel("wake-up [us]")
        return
    draw_line(ax, run.t_s, run.gear_torque_Nm, "shaft torque on the hub", BLUE, linewidth=0.8)
    ax.set_ylabel("torque [N m]")
