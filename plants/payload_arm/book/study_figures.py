"""The figures of the study: PD beside the critic, what each part brings, the weights over 60 s."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.plants.book.figures import REFERENCE, dress, name_rows
from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, sheet
from pcpc.plants.study import Result

NAMES = {"pd": "PD", "robust_only": "PD, robust term", "critic": "PD, robust term, both networks"}
JOINTS = ((1, BLUE), (2, VERMILION))
SHADE = "#F3E8D2"
GRID: dict[str, Any] = {"below": True, "which": "both", "alpha": 0.6}
SMALLEST_RAD = 1e-4  # of the logarithmic axis


def _shade(ax: Any, result: Result) -> None:
    """Shade the time with the payload."""
    ends = (result.settings[f"arm.payload_{end}_s"] for end in ("from", "to"))
    ax.axvspan(*ends, color=SHADE, linewidth=0, zorder=0)


def draw_beside(runs: Sequence[Result], path: Path) -> None:
    """Draw a column a controller: angles, errors, torques; the payload is shaded."""
    figure, axes = sheet(
        (12.0, 9.0), 120, 3, len(runs), sharex=True, sharey="row", height_ratios=(4, 5, 3)
    )
    for column, result in zip(axes.T, runs, strict=True):
        _draw_run(column, result.traces)
        column[0].set_title(NAMES[result.case.controller], fontsize=11, loc="left")
        for ax in column:
            _shade(ax, result)
    dress(axes.flat, **GRID)
    name_rows(axes, ("angle [rad]", "|error| [rad]", "torque [N m], start cut"), "time [s]")
    axes[0, 0].set_ylim(-1.3, 1.9)
    axes[0, 0].set_xlim(0.0, 10.0)
    axes[1, 0].set_yscale("log")
    axes[1, 0].set_ylim(SMALLEST_RAD, 3.0)
    axes[2, 0].set_ylim(-80.0, 100.0)
    for ax in axes[:, -1]:
        ax.legend(fontsize=8, ncols=3, loc="upper right", framealpha=0.9)
    figure.suptitle("sin t and cos t with a payload of 1.5 kg from 5 to 7 s (shaded)", fontsize=13)
    figure.savefig(path)


def _draw_run(axes: Any, x: Mapping[str, Any]) -> None:
    t = x["t"]
    for joint, colour in JOINTS:
        q, q_d = x[f"plant:arm.q_{joint}_rad"], x[f"executive:reference_{joint}.q_d_rad"]
        axes[0].plot(t, q, color=colour, linewidth=1.2, label=f"joint {joint}")
        name = "references" if joint == 2 else None
        axes[0].plot(t, q_d, linewidth=0.8, label=name, **REFERENCE)
        size = np.maximum(np.abs(q_d - q), SMALLEST_RAD)
        axes[1].plot(t, size, color=colour, linewidth=0.9, label=f"joint {joint}")
        tau = x[f"plant:arm.acting_{joint}_Nm"]
        axes[2].plot(t, tau, color=colour, linewidth=0.9, label=f"joint {joint}")


def draw_parts(shown: Mapping[str, Result], seeds: Sequence[Result], path: Path) -> None:
    """Draw the rms errors of each combination of parts before, under and after the payload."""
    figure, axes = sheet((12.0, 5.0), 120, 1, 3, sharex=True, sharey=True)
    windows = (
        ("early_error_rms", "3 to 5 s, before the payload"),
        ("payload_error_rms", "5 to 7 s, with the payload"),
        ("error_rms", "8 to 10 s, after it"),
    )
    labels = list(shown)[::-1]
    whole = labels.index(next(label for label in labels if label.startswith("all:")))
    for ax, (metric, title) in zip(axes, windows, strict=True):
        for joint, colour in JOINTS:
            place = np.arange(len(labels)) - (0.12 if joint == 2 else -0.12)
            values = [shown[label].metric(f"{metric}_{joint}_rad") for label in labels]
            ax.plot(values, place, "o", color=colour, markersize=7, label=f"joint {joint}")
            drawn = [result.metric(f"{metric}_{joint}_rad") for result in seeds]
            at = np.full(len(drawn), place[whole])
            name = "other first layers" if joint == 2 else None
            ax.plot(drawn, at, "|", color=GREY, markersize=9, label=name, zorder=0)
        ax.set_xscale("log")
        ax.set_xlabel("rms error [rad]")
        ax.set_title(title, fontsize=10, loc="left")
    dress(axes, **GRID)
    axes[0].set_yticks(range(len(labels)), labels)
    axes[0].legend(fontsize=8, loc="upper right", framealpha=0.9)
    figure.suptitle("What each part of the law brings", fontsize=13)
    figure.savefig(path)


def draw_long(result: Result, path: Path) -> None:
    """Draw errors and norms of the run of 60 s with the payload in its beginning."""
    x = result.traces
    figure, axes = sheet((11.0, 7.0), 120, 3, 1, sharex=True)
    for joint, colour in JOINTS:
        style: dict[str, Any] = {"color": colour, "linewidth": 0.9, "label": f"joint {joint}"}
        axes[0].plot(x["t"], 1e3 * x[f"error_{joint}_rad"], **style)
    axes[1].plot(x["t"], x["critic"], color=PURPLE, label="critic signal |R|")
    axes[1].plot(x["t"], x["executive:controller.norm_w1"], color=GREEN, label="critic |W1|")
    axes[1].plot(x["t"], x["executive:controller.norm_rho"], color=ORANGE, label="critic |rho|")
    axes[2].plot(x["t"], x["executive:controller.norm_w2"], color=BLACK, label="action |W2|")
    axes[0].set_ylim(-60.0, 60.0)
    axes[0].set_xlim(0.0, x["t"][-1])
    for ax, label in zip(axes, ("error [mrad]", "critic", "action network"), strict=True):
        ax.set_ylabel(label)
        _shade(ax, result)
        ax.legend(fontsize=8, ncols=3, loc="upper right", framealpha=0.9)
    dress(axes, **GRID)
    axes[-1].set_xlabel("time [s]")
    figure.suptitle("60 s: errors and weights stay bounded, payload from 5 to 7 s", fontsize=13)
    figure.savefig(path)
