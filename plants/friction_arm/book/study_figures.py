"""The figures of the study: errors, phase planes, chatter close up, weights, sampling rates."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.plants.book.figures import (
    REFERENCE,
    draw_lines,
    legend_below,
    name_rows,
    overlay,
    reference,
    save,
)
from pcpc.plants.book.tables import grouped, label_of, rig_name
from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, sheet
from pcpc.plants.study import CaseResult, of_group, statistic

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


def draw_all(results: Sequence[CaseResult], folder: Path) -> None:
    """Draw all figures of `results` into the folder."""
    drawn = of_group(results, "drawn")
    for (rig,), own in grouped(drawn, rig_name).items():
        _errors(own, TITLES[rig], folder / f"{rig}.png")
    _phase_planes(drawn, folder / "phase.png")
    _chatter(of_group(results, "zoom"), folder / "chatter.png")
    _weights(drawn, folder / "weights.png")
    _rates(of_group(results, "rates"), folder / "rates.png")


def _of(*laws: str) -> dict[str, str]:
    """Return the colours of these laws."""
    return {law: COLOURS[law] for law in laws}


def _errors(results: Sequence[CaseResult], title: str, path: Path) -> None:
    """Draw angles and errors of both joints side by side, one line a controller."""
    figure, axes = sheet((11, 8), 100, 3, 2, sharex=True, height_ratios=(4, 4, 3))
    for j, (angle, error, torque) in enumerate(axes.T, 1):
        overlay(angle, results, f"plant:arm.q_{j}_rad", COLOURS, 1.1)
        overlay(error, results, f"error_{j}_rad", COLOURS, 1.1)
        shown = _of("pd", "nn_standard", "nn_ramp")
        overlay(torque, results, f"plant:arm.acting_{j}_Nm", shown, 0.9)
        wanted = reference(f"executive:reference_{j}.q_d_rad")
        draw_lines(angle, [wanted], results[-1].traces)
        error.axhline(0.0, color=BLACK, linewidth=0.6)
        span = max(0.2, *(_late_error(r, j) for r in results if r.case.controller != "pd"))
        error.set_ylim(-1.15 * span, 1.15 * span)
        if (pd := _late_error(results[0], j)) > 1.15 * span:
            look: dict[str, Any] = {"color": COLOURS["pd"], "ha": "right", "fontsize": 8}
            text = f"pd out of view: {pd:.2f} rad"
            error.text(0.99, 0.94, text, transform=error.transAxes, **look)
        angle.set_title(f"joint {j}", fontsize=10)
        torque.set_title("pd, nn_standard, nn_ramp", fontsize=8, color=GREY)
    name_rows(axes, ("angle [rad]", "error [rad], detail", "torque [N m]"), "time [s]")
    _finish(figure, axes, axes[0, 0], f"{title}: PD and networks, seed 1", path)


def _late_error(result: CaseResult, joint: int) -> float:
    """Return the largest error from 2 s on."""
    x = result.traces
    return float(np.max(np.abs(x[f"error_{joint}_rad"][x["t"] >= 2.0])))


def _phase_planes(results: Sequence[CaseResult], path: Path) -> None:
    """Draw the error rate over the error: the whole step of case A, the last turns of case C."""
    figure, axes = sheet((11, 8.5), 100, 2, 2)
    for row, (rig, from_s) in zip(axes, PHASE_FROM_S.items(), strict=True):
        for j, ax in enumerate(row, 1):
            for result in results:
                law, x = result.case.controller, result.traces
                if law in PHASES and rig_name(result) == rig:
                    wanted = x[f"executive:reference_{j}.q_d_rate_rad_s"]
                    rate, late = wanted - x[f"plant:arm.rate_{j}_rad_s"], x["t"] >= from_s
                    look: dict[str, Any] = {"color": COLOURS[law], "linewidth": 0.9, "label": law}
                    ax.plot(x[f"error_{j}_rad"][late], rate[late], **look)
            ax.plot(0.0, 0.0, "+", color=BLACK, markersize=9)
            span = f"from {from_s:g} s on" if from_s else "whole run"
            ax.set_title(f"{TITLES[rig]}: joint {j}, {span}", fontsize=9)
            ax.set_xlabel("error e [rad]")
    name_rows(axes, ["error rate e' [rad/s]"] * 2)
    _finish(figure, axes, axes[0, 0], "Phase planes, PD and networks, seed 1", path)


def _chatter(results: Sequence[CaseResult], path: Path) -> None:
    """Draw the torque of joint 1 of the step node beside the others, whole and close up."""
    shares: dict[str, Any] = {"sharey": "row", "sharex": "col", "width_ratios": (3, 2)}
    figure, axes = sheet((11, 8), 100, len(results), 2, **shares)
    for (whole, close), result in zip(axes, results, strict=True):
        t_s, tau = result.traces["t"], result.traces["plant:arm.acting_1_Nm"]
        law, colour = result.case.controller, COLOURS[result.case.controller]
        whole.plot(t_s, tau, color=colour, linewidth=0.6)
        near = (t_s >= ZOOM_S[0]) & (t_s <= ZOOM_S[1])
        t_ms = 1e3 * (t_s[near] - ZOOM_S[0])
        close.step(t_ms, tau[near], where="pre", color=colour, linewidth=1.0)
        close.plot(t_ms, tau[near], ".", color=colour)
        whole.axvspan(*ZOOM_S, color="#D0D6DE", linewidth=0)
        variation = result.metrics["torque_variation_Nm_s"]
        whole.set_title(f"{law}: variation of both joints {variation:.0f} N m/s", fontsize=9)
        close.set_title("the shaded 20 ms", fontsize=9)
    name_rows(axes, ["torque 1 [N m]"] * len(results))
    axes[-1, 0].set_xlabel("time [s]")
    axes[-1, 1].set_xlabel(f"time from {ZOOM_S[0]} s [ms], every sample")
    _finish(figure, axes, None, "Case A: the step node at rest chatters, its variants do not", path)


def _weights(results: Sequence[CaseResult], path: Path) -> None:
    """Draw the own-joint weights of phi_0 in cases A and C beside twice the friction."""
    figure, axes = sheet((11, 6), 100, 2, 2, sharex="row")
    for row, rig in zip(axes, ("friction-a", "friction-c"), strict=True):
        of_rig = [r for r in results if rig_name(r) == rig]
        for j, (ax, ideal_Nm) in enumerate(zip(row, IDEAL_Nm, strict=True), 1):
            weight = f"executive:controller.step_weight_{j}_Nm"
            overlay(ax, of_rig, weight, _of("nn_step", "nn_ramp"), 0.9)
            ax.axhline(ideal_Nm, linewidth=0.9, label="2 x friction", **REFERENCE)
            ax.axhline(0.0, color=BLACK, linewidth=0.6)
            ax.set_title(f"{TITLES[rig]}: joint {j}", fontsize=9)
            ax.set_xlabel("time [s]")
    name_rows(axes, ["weight of phi_0 [N m]"] * 2)
    title = "The weight of the step node does not converge to twice the friction, seed 1"
    _finish(figure, axes, axes[0, 0], title, path)


def _rates(results: Sequence[CaseResult], path: Path) -> None:
    """Draw error, variation and tuning gain of case A over the sampling rate."""
    figure, axes = sheet((12, 4), 100, 1, 3)
    metrics = (
        ("error_abs_mean_{}_rad", "mean |error|, 9 to 10 s [rad]"),
        ("torque_variation_Nm_s", "torque variation [N m/s]"),
        ("tuning_gain_median_Nms_rad", "median tuning gain T G [N m s/rad]"),
    )
    for ax, (metric, label) in zip(axes, metrics, strict=True):
        for law in ("nn_standard", "nn_step", "nn_ramp"):
            by_rate = grouped((r for r in results if r.case.controller == law), label_of)
            for j in (1, 2) if "{}" in metric else (0,):
                medians = [statistic(o, metric.format(j), np.median) for o in by_rate.values()]
                look: dict[str, Any] = {"color": COLOURS[law], "marker": "o", "markersize": 3}
                name = law + (f", joint {j}" if j else "")
                rates = [float(rate) for (rate,) in by_rate]
                ax.plot(rates, medians, "--" if j == 2 else "-", label=name, **look)
        ax.set(xscale="log", yscale="log", xlabel="sampling rate [Hz]", ylabel=label)
        ax.grid(alpha=0.3, which="both")
        ax.legend(frameon=False, fontsize=7)
    axes[2].axhline(20.0, linewidth=0.9, **REFERENCE)
    axes[2].annotate("Kv", (3000.0, 22.0), fontsize=9)
    save(figure, path, "Case A over the sampling rate, medians over 5 seeds", 11)


def _finish(figure: Any, axes: Any, legend_of: Any, title: str, path: Path) -> None:
    for ax in axes.flat:
        ax.grid(alpha=0.3)
    if legend_of is not None:
        legend_below(figure, legend_of, 6)
    save(figure, path, title, 11)
