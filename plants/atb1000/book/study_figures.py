"""The figures of the study: signals, networks and phase plane of each scenario."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.plants.study import Result

COLOURS = {"pd": "#7f7f7f", "pid": "#0072b2", "pd_nn_fast": "#d55e00", "nn_backstepping": "#009e73"}
MRAD, DEG = 1e3, 180.0 / np.pi
TIMES = (1.0, 2.3, 5.0)  # counted in the table too


def draw_all(results: Sequence[Result], folder: Path) -> None:
    """Draw all scenarios that `results` hold traces of."""
    import matplotlib

    matplotlib.use("Agg")
    folder.mkdir(parents=True, exist_ok=True)
    scenarios = list(dict.fromkeys(Path(r.case.rig).stem for r in results))
    for scenario in scenarios:
        own = [r for r in results if Path(r.case.rig).stem == scenario]
        _signals(scenario, own, folder / f"{scenario}.png")
        _networks(scenario, own, folder / f"{scenario}-networks.png")


def draw_monte_carlo(results: Sequence[Result], path: Path) -> None:
    """Draw how many of the random plants each controller improves, and by how much.

    Each step of a curve is a plant: its own error with plain PD over that with the controller.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    scenarios = list(dict.fromkeys(Path(r.case.rig).stem for r in results))
    figure, axes = pyplot.subplots(
        1, len(scenarios), figsize=(12, 4.6), sharey=True, layout="constrained"
    )
    for ax, scenario in zip(axes, scenarios, strict=True):
        own = [r for r in results if Path(r.case.rig).stem == scenario]
        base = {r.case.label: _rms(r) for r in own if r.case.controller == "pd"}
        for name in (n for n in COLOURS if n != "pd"):
            mine = [r for r in own if r.case.controller == name]
            better = np.sort([base[r.case.label] / _rms(r) for r in mine])
            left = np.arange(len(better), 0, -1)  # of so many plants it is at least this
            ax.plot(better, left, ".-", drawstyle="steps-pre", color=COLOURS[name], label=name,
                    linewidth=1.0, markersize=5)  # fmt: skip
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
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def _rms(result: Result) -> float:
    return result.metrics.get("muzzle_error_rms_mrad", float("nan"))


def _signals(scenario: str, results: Sequence[Result], path: Path) -> None:
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(4, 1, figsize=(9, 10), sharex=True, layout="constrained")
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
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    for result in results:
        x, name = result.traces, result.case.controller
        style: dict[str, Any] = {"color": COLOURS[name], "linewidth": 0.9, "label": name}
        axes[0].plot(x["t"], x["executive:controller.network_Nm"], **style)
        axes[1].plot(x["t"], x["executive:controller.norm_z"], **style)
        rate = x["executive:reference.q_d_rate_rad_s"] - x["plant:barrel.theta_rate_rad_s"]
        axes[2].plot(MRAD * x["hub_error_rad"], MRAD * rate, **style)
    for ax, (below, beside) in zip(
        axes,
        (
            ("time [s]", "network [N m]"),
            ("time [s]", "norm of weights"),
            ("e [mrad]", "e' [mrad/s]"),
        ),
        strict=True,
    ):
        ax.set_xlabel(below)
        ax.set_ylabel(beside)
        ax.grid(alpha=0.3)
    handles, names = axes[2].get_legend_handles_labels()
    figure.legend(handles, names, frameon=False, fontsize=8, ncols=5, loc="outside lower center")
    figure.suptitle(f"{scenario}: network output, weight norm, phase plane of the hub", fontsize=11)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def _finish(figure: Any, axes: Any, labels: Sequence[str], title: str, path: Path) -> None:
    from matplotlib import pyplot

    for ax, label in zip(axes, labels, strict=True):
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
    axes[0].legend(
        frameon=False, fontsize=8, ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0)
    )
    axes[-1].set_xlabel("time [s]")
    figure.suptitle(title, fontsize=12)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
