"""The figures of the study: errors, phase planes, chatter close up, weights, sampling rates."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.plants.book.figures import REFERENCE, legend_below, name_rows
from pcpc.plants.book.tables import grouped, label_of, rig_name
from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, sheet
from pcpc.plants.study import Result, of_group, statistic

COLOURS = {
    "pd": GREY, "nn_standard": BLUE, "nn_step": VERMILION, "nn_ramp": GREEN, "nn_project": PURPLE,
    "nn_const": ORANGE,
}  # fmt: skip
TITLES = {
    "friction-a": "Case A, unit step under gravity",
    "friction-b": "Case B, unit step without gravity",
    "friction-c": "Case C, tracking sin t and cos t",
    "friction-d": "Case D, unit step, LuGre friction",
}
IDEAL_Nm = (72.0, 78.0)  # twice the friction level of each joint
ZOOM_S = (2.80, 2.82)
PHASES = ("pd", "nn_standard", "nn_step", "nn_const")
PHASE_FROM_S = {"friction-a": 0.0, "friction-c": 13.0}  # the last period of sin t and more


def draw_all(results: Sequence[Result], folder: Path) -> None:
    """Draw all figures of `results` into the folder."""
    drawn = of_group(results, "drawn")
    for rig, title in TITLES.items():
        own = [result for result in drawn if rig_name(result) == rig]
        _errors(own, title, folder / f"{rig}.png")
    _phase_planes(drawn, folder / "phase.png")
    _chatter(of_group(results, "zoom"), folder / "chatter.png")
    _weights(drawn, folder / "weights.png")
    _rates(of_group(results, "rates"), folder / "rates.png")


def _style(result: Result, width: float = 1.1) -> dict[str, Any]:
    name = result.case.controller
    return {"color": COLOURS[name], "linewidth": width, "label": name}


def _errors(results: Sequence[Result], title: str, path: Path) -> None:
    """Draw angles and errors of both joints side by side, one line a controller."""
    figure, axes = sheet((11, 8), 100, 3, 2, sharex=True, height_ratios=(4, 4, 3))
    for j in (1, 2):
        angle, error, torque = axes[:, j - 1]
        for result in results:
            x = result.traces
            reference = x[f"executive:reference_{j}.q_d_rad"]
            angle.plot(x["t"], x[f"plant:arm.q_{j}_rad"], **_style(result))
            error.plot(x["t"], x[f"error_{j}_rad"], **_style(result))
            if result.case.controller in ("pd", "nn_standard", "nn_ramp"):
                torque.plot(x["t"], x[f"plant:arm.acting_{j}_Nm"], **_style(result, 0.9))
        angle.plot(x["t"], reference, linewidth=0.9, label="reference", **REFERENCE)
        error.axhline(0.0, color=BLACK, linewidth=0.6)
        span = max(0.2, *(_late_error(r, j) for r in results if r.case.controller != "pd"))
        error.set_ylim(-1.15 * span, 1.15 * span)
        if (pd := _late_error(results[0], j)) > 1.15 * span:
            error.text(
                0.99,
                0.94,
                f"pd out of view: {pd:.2f} rad",
                color=COLOURS["pd"],
                ha="right",
                fontsize=8,
                transform=error.transAxes,
            )
        angle.set_title(f"joint {j}", fontsize=10)
        torque.set_title("pd, nn_standard, nn_ramp", fontsize=8, color=GREY)
    name_rows(axes, ("angle [rad]", "error [rad], detail", "torque [N m]"), "time [s]")
    _finish(figure, axes, axes[0, 0], f"{title}: PD and networks, seed 1", path)


def _late_error(result: Result, joint: int) -> float:
    """Return the largest error from 2 s on."""
    x = result.traces
    return float(np.max(np.abs(x[f"error_{joint}_rad"][x["t"] >= 2.0])))


def _phase_planes(results: Sequence[Result], path: Path) -> None:
    """Draw the error rate over the error: the whole step of case A, the last turns of case C."""
    figure, axes = sheet((11, 8.5), 100, 2, 2)
    for row, (rig, from_s) in zip(axes, PHASE_FROM_S.items(), strict=True):
        own = [r for r in results if rig_name(r) == rig]
        for j, ax in enumerate(row, 1):
            for result in own:
                if result.case.controller in PHASES:
                    x = result.traces
                    rate = x[f"executive:reference_{j}.q_d_rate_rad_s"]
                    rate = rate - x[f"plant:arm.rate_{j}_rad_s"]
                    late = x["t"] >= from_s
                    ax.plot(x[f"error_{j}_rad"][late], rate[late], **_style(result, 0.9))
            ax.plot(0.0, 0.0, "+", color=BLACK, markersize=9)
            span = f"from {from_s:g} s on" if from_s else "whole run"
            ax.set_title(f"{TITLES[rig]}: joint {j}, {span}", fontsize=9)
            ax.set_xlabel("error e [rad]")
    name_rows(axes, ["error rate e' [rad/s]"] * 2)
    _finish(figure, axes, axes[0, 0], "Phase planes, PD and networks, seed 1", path)


def _chatter(results: Sequence[Result], path: Path) -> None:
    """Draw the torque of joint 1 of the step node beside the others, whole and close up."""
    figure, axes = sheet(
        (11, 8), 100, len(results), 2, sharey="row", sharex="col", width_ratios=(3, 2)
    )
    for row, result in zip(axes, results, strict=True):
        x = result.traces
        tau = x["plant:arm.acting_1_Nm"]
        row[0].plot(x["t"], tau, **_style(result, 0.6))
        near = (x["t"] >= ZOOM_S[0]) & (x["t"] <= ZOOM_S[1])
        t_ms = 1e3 * (x["t"][near] - ZOOM_S[0])
        row[1].step(t_ms, tau[near], where="pre", **_style(result, 1.0))
        row[1].plot(t_ms, tau[near], ".", color=COLOURS[result.case.controller])
        row[0].axvspan(*ZOOM_S, color="#D0D6DE", linewidth=0)
        row[0].set_ylabel("torque 1 [N m]")
        variation = result.metrics["torque_variation_Nm_s"]
        row[0].set_title(
            f"{result.case.controller}: variation of both joints {variation:.0f} N m/s", fontsize=9
        )
        row[1].set_title("the shaded 20 ms", fontsize=9)
    axes[-1, 0].set_xlabel("time [s]")
    axes[-1, 1].set_xlabel(f"time from {ZOOM_S[0]} s [ms], every sample")
    _finish(figure, axes, None, "Case A: the step node at rest chatters, its variants do not", path)


def _weights(results: Sequence[Result], path: Path) -> None:
    """Draw the own-joint weights of phi_0 in cases A and C beside twice the friction."""
    figure, axes = sheet((11, 6), 100, 2, 2, sharex="row")
    for row, rig in zip(axes, ("friction-a", "friction-c"), strict=True):
        own = [r for r in results if rig_name(r) == rig]
        for j, ax in enumerate(row):
            for result in own:
                if result.case.controller in ("nn_step", "nn_ramp"):
                    weight = result.traces[f"executive:controller.step_weight_{j + 1}_Nm"]
                    ax.plot(result.traces["t"], weight, **_style(result, 0.9))
            ax.axhline(IDEAL_Nm[j], linewidth=0.9, label="2 x friction", **REFERENCE)
            ax.axhline(0.0, color=BLACK, linewidth=0.6)
            ax.set_title(f"{TITLES[rig]}: joint {j + 1}", fontsize=9)
            ax.set_xlabel("time [s]")
    name_rows(axes, ["weight of phi_0 [N m]"] * 2)
    title = "The weight of the step node does not converge to twice the friction, seed 1"
    _finish(figure, axes, axes[0, 0], title, path)


def _rates(results: Sequence[Result], path: Path) -> None:
    """Draw error, variation and tuning gain of case A over the sampling rate."""
    figure, axes = sheet((12, 4), 100, 1, 3)
    metrics = (
        ("error_abs_mean_{}_rad", "mean |error|, 9 to 10 s [rad]"),
        ("torque_variation_Nm_s", "torque variation [N m/s]"),
        ("tuning_gain_median_Nms_rad", "median tuning gain T G [N m s/rad]"),
    )
    for ax, (metric, label) in zip(axes, metrics, strict=True):
        for controller in ("nn_standard", "nn_step", "nn_ramp"):
            for j in (1, 2) if "{}" in metric else (0,):
                rates, values = _over_rate(results, controller, metric.format(j))
                style = {"color": COLOURS[controller], "marker": "o", "markersize": 3}
                more = f", joint {j}" if j else ""
                ax.plot(rates, values, "--" if j == 2 else "-", label=controller + more, **style)
        ax.set(xscale="log", yscale="log", xlabel="sampling rate [Hz]", ylabel=label)
        ax.grid(alpha=0.3, which="both")
        ax.legend(frameon=False, fontsize=7)
    axes[2].axhline(20.0, linewidth=0.9, **REFERENCE)
    axes[2].annotate("Kv", (3000.0, 22.0), fontsize=9)
    figure.suptitle("Case A over the sampling rate, medians over 5 seeds", fontsize=11)
    figure.savefig(path)


def _over_rate(
    results: Sequence[Result], controller: str, metric: str
) -> tuple[list[float], list[float]]:
    """Return rates and medians."""
    own = [r for r in results if r.case.controller == controller]
    rates = grouped(own, label_of)
    values = [statistic(runs, metric, np.median) for runs in rates.values()]
    return [float(rate) for (rate,) in rates], values


def _finish(figure: Any, axes: Any, legend_of: Any, title: str, path: Path) -> None:
    for ax in axes.flat:
        ax.grid(alpha=0.3)
    if legend_of is not None:
        legend_below(figure, legend_of, 6)
    figure.suptitle(title, fontsize=11)
    figure.savefig(path)
