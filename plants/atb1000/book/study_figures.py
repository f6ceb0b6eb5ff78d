"""The figures of the study: signals, networks and phase plane of each scenario."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.plants.book.figures import legend_below, name_rows
from pcpc.plants.book.tables import rig_name
from pcpc.plants.pages import sheet
from pcpc.plants.study import Result

COLOURS = {"pd": "#7f7f7f", "pid": "#0072b2", "pd_nn_fast": "#d55e00", "nn_backstepping": "#009e73"}
MRAD, DEG = 1e3, 180.0 / np.pi
TIMES = (1.0, 2.3, 5.0)  # counted in the table too


def draw_all(results: Sequence[Result], folder: Path) -> None:
    """Draw all scenarios that `results` hold traces of."""
    for scenario, own in _by_scenario(results).items():
        _signals(scenario, own, folder / f"{scenario}.png")
        _networks(scenario, own, folder / f"{scenario}-networks.png")


def _by_scenario(results: Sequence[Result]) -> dict[str, list[Result]]:
    found: dict[str, list[Result]] = {}
    for result in results:
        found.setdefault(rig_name(result), []).append(result)
    return found


def draw_monte_carlo(results: Sequence[Result], path: Path) -> None:
    """Draw how many of the random plants each controller improves, and by how much.

    Each step of a curve is a plant: its own error with plain PD over that with the controller.
    """
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    scenarios = _by_scenario(results)
    figure, axes = sheet((12, 4.6), 110, 1, len(scenarios), sharey=True)
    for ax, (scenario, own) in zip(axes, scenarios.items(), strict=True):
        base = {r.case.label: _rms(r) for r in own if r.case.controller == "pd"}
        for name in (n for n in COLOURS if n != "pd"):
            mine = [r for r in own if r.case.controller == name]
            better = np.sort([base[r.case.label] / _rms(r) for r in mine])
            left = np.arange(len(better), 0, -1)  # of so many plants it is at least this
            ax.plot(
                better,
                left,
                ".-",
                drawstyle="steps-pre",
                color=COLOURS[name],
                label=name,
                linewidth=1.0,
                markersize=5,
            )
        for times in TIMES:
            ax.axvline(times, color="k", linestyle=":", linewidth=0.8)
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


def _rms(result: Result) -> float:
    return result.metrics.get("muzzle_error_rms_mrad", float("nan"))


def _signals(scenario: str, results: Sequence[Result], path: Path) -> None:
    figure, axes = sheet((9, 10), 110, 4, 1, sharex=True)
    q_d = results[0].traces["executive:reference.q_d_rad"]
    in_degrees = np.abs(q_d).max() >= 1.0 / DEG  # else in the unit of the error below
    unit, scale = ("deg", DEG) if in_degrees else ("mrad", MRAD)
    for result in results:
        x, name = result.traces, result.case.controller
        style: dict[str, Any] = {"color": COLOURS[name], "linewidth": 0.9, "label": name}
        t = x["t"]
        axes[0].plot(t, scale * x["plant:barrel.theta_rad"], **style)
        axes[1].plot(t, MRAD * x["muzzle_error_rad"], **style)
        axes[2].plot(t, MRAD * x["plant:barrel.elastic_slope_rad"], **style)
        axes[3].plot(t, x["command_Nm"], **style)
    t = results[0].traces["t"]
    axes[0].plot(t, scale * q_d, "k--", linewidth=0.8, label="reference")
    labels = (f"hub [{unit}]", "muzzle error [mrad]", "elastic slope [mrad]", "command [N m]")
    _finish(figure, axes, labels, f"{scenario}: reference, error, bending, command", path)


def _networks(scenario: str, results: Sequence[Result], path: Path) -> None:
    figure, axes = sheet((12, 3.6), 110, 1, 3)
    for result in results:
        x, name = result.traces, result.case.controller
        style: dict[str, Any] = {"color": COLOURS[name], "linewidth": 0.9, "label": name}
        axes[0].plot(x["t"], x["executive:controller.network_Nm"], **style)
        axes[1].plot(x["t"], x["executive:controller.norm_z"], **style)
        rate = x["executive:reference.q_d_rate_rad_s"] - x["plant:barrel.theta_rate_rad_s"]
        axes[2].plot(MRAD * x["hub_error_rad"], MRAD * rate, **style)
    axes[0].set(xlabel="time [s]", ylabel="network [N m]")
    axes[1].set(xlabel="time [s]", ylabel="norm of weights")
    axes[2].set(xlabel="e [mrad]", ylabel="e' [mrad/s]")
    for ax in axes:
        ax.grid(alpha=0.3)
    legend_below(figure, axes[2], 5, size=8)
    figure.suptitle(f"{scenario}: network output, weight norm, phase plane of the hub", fontsize=11)
    figure.savefig(path)


def _finish(figure: Any, axes: Any, labels: Sequence[str], title: str, path: Path) -> None:
    name_rows(axes[:, None], labels, "time [s]")
    for ax in axes:
        ax.grid(alpha=0.3)
    axes[0].legend(
        frameon=False, fontsize=8, ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0)
    )
    figure.suptitle(title, fontsize=12)
    figure.savefig(path)
