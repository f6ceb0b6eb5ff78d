"""The figures of the study: signals, networks and phase plane of each scenario."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.plants.book.figures import (
    draw_lines,
    legend_below,
    name_rows,
    overlay,
    reference,
    save,
    times,
)
from pcpc.plants.book.tables import grouped, rig_name
from pcpc.plants.pages import sheet
from pcpc.plants.study import CaseResult

COLOURS = {"pd": "#7f7f7f", "pid": "#0072b2", "pd_nn_fast": "#d55e00", "nn_backstepping": "#009e73"}
MRAD, DEG = 1e3, 180.0 / np.pi
TIMES = (1.0, 2.3, 5.0)  # counted in the table too


def draw_all(results: Sequence[CaseResult], folder: Path) -> None:
    """Draw all scenarios that `results` hold traces of."""
    for (scenario,), own in grouped(results, rig_name).items():
        _signals(scenario, own, folder / f"{scenario}.png")
        _networks(scenario, own, folder / f"{scenario}-networks.png")


def draw_monte_carlo(results: Sequence[CaseResult], path: Path) -> None:
    """Draw how many of the random plants each controller improves, and by how much.

    Each step of a curve is a plant: its own error with plain PD over that with the controller.
    """
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    scenarios = grouped(results, rig_name)
    figure, axes = sheet((12, 4.6), 110, 1, len(scenarios), sharey=True)
    for ax, ((scenario,), of_scenario) in zip(axes, scenarios.items(), strict=True):
        base = {r.case.label: _rms(r) for r in of_scenario if r.case.controller == "pd"}
        for name in (n for n in COLOURS if n != "pd"):
            mine = [r for r in of_scenario if r.case.controller == name]
            better = np.sort([base[r.case.label] / _rms(r) for r in mine])
            left = np.arange(len(better), 0, -1)  # of so many plants it is at least this
            look: dict[str, Any] = {"color": COLOURS[name], "linewidth": 1.0, "markersize": 5}
            ax.plot(better, left, ".-", drawstyle="steps-pre", label=name, **look)
        for ratio in TIMES:
            ax.axvline(ratio, color="k", linestyle=":", linewidth=0.8)
        ax.set_xscale("log")
        ax.set_xticks((0.5, *TIMES, 10.0))
        ax.xaxis.set_major_formatter(ScalarFormatter())
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.set_title(scenario, fontsize=10)
        ax.set_xlabel("muzzle error rms: pd over controller, same plant")
        ax.grid(alpha=0.3)
    axes[0].set_ylabel(f"plants of {len(base)} that reach this ratio")
    axes[0].set_ylim(0.0, len(base) + 1.0)
    axes[0].set_yticks(range(0, len(base) + 1, 5))
    axes[-1].legend(frameon=False, fontsize=8, loc="upper right")
    figure.savefig(path)


def _rms(result: CaseResult) -> float:
    return result.metrics.get("muzzle_error_rms_mrad", float("nan"))


def _signals(scenario: str, results: Sequence[CaseResult], path: Path) -> None:
    figure, axes = sheet((9, 10), 110, 4, 1, sharex=True)
    q_d = results[0].traces["executive:reference.q_d_rad"]
    in_degrees = np.abs(q_d).max() >= 1.0 / DEG  # else in the unit of the error below
    unit, scale = ("deg", DEG) if in_degrees else ("mrad", MRAD)
    for ax, (source, by) in zip(
        axes,
        (
            ("plant:barrel.theta_rad", scale),
            ("muzzle_error_rad", MRAD),
            ("plant:barrel.elastic_slope_rad", MRAD),
            ("command_Nm", 1.0),
        ),
        strict=True,
    ):
        overlay(ax, results, times(by, source), COLOURS, 0.9)
        ax.grid(alpha=0.3)
    wanted = reference(times(scale, "executive:reference.q_d_rad"), width=0.8)
    draw_lines(axes[0], [wanted], results[0].traces)
    labels = (f"hub [{unit}]", "muzzle error [mrad]", "elastic slope [mrad]", "command [N m]")
    name_rows(axes[:, None], labels, "time [s]")
    place: dict[str, Any] = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0)}
    axes[0].legend(frameon=False, fontsize=8, ncols=5, **place)
    save(figure, path, f"{scenario}: reference, error, bending, command")


def _networks(scenario: str, results: Sequence[CaseResult], path: Path) -> None:
    figure, axes = sheet((12, 3.6), 110, 1, 3)
    network, norm, plane = axes
    overlay(network, results, "executive:controller.network_Nm", COLOURS, 0.9)
    overlay(norm, results, "executive:controller.norm_z", COLOURS, 0.9)
    for result in results:
        x, name = result.traces, result.case.controller
        rate = x["executive:reference.q_d_rate_rad_s"] - x["plant:barrel.theta_rate_rad_s"]
        look: dict[str, Any] = {"color": COLOURS[name], "linewidth": 0.9, "label": name}
        plane.plot(MRAD * x["hub_error_rad"], MRAD * rate, **look)
    network.set(xlabel="time [s]", ylabel="network [N m]")
    norm.set(xlabel="time [s]", ylabel="norm of weights")
    plane.set(xlabel="e [mrad]", ylabel="e' [mrad/s]")
    for ax in axes:
        ax.grid(alpha=0.3)
    legend_below(figure, plane, 5, size=8)
    title = f"{scenario}: network output, weight norm, phase plane of the hub"
    save(figure, path, title, 11)
