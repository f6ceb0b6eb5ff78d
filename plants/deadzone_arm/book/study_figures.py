"""The figures of the study: PD beside the network, and what twenty draws come to."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.plants.book.figures import REFERENCE, dress, name_rows
from pcpc.plants.book.tables import Words, rig_name
from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILION, sheet
from pcpc.plants.study import Result

NAMES = {"pd": "PD", "nn": "PD and two networks a joint"}
SMALLEST_RAD = 1e-5  # of the logarithmic axis
SHOWN = ("rig", "rig + 1 sample", "rig + 2 samples", "L = 40", "no jump nodes", "S = 0",
         "S = 240", "random signs S = 24", "random signs S = 0", "as in the book")  # fmt: skip


def draw_beside(pair: Sequence[Result], path: Path) -> None:
    """Draw PD in the left column, the network in the right: angles, errors, torques."""
    figure, axes = sheet(
        (11.0, 10.0), 120, 4, 2, sharex=True, sharey="row", height_ratios=(4, 4, 3, 3)
    )
    for column, result in zip(axes.T, pair, strict=True):
        _draw_run(column, result)
        column[0].set_title(NAMES[result.case.controller], fontsize=11, loc="left")
    labels = ("angle [rad]", "|error| [rad]", "joint 1 [N m]", "joint 2 [N m]")
    name_rows(axes, labels, "time [s]")
    scenario = rig_name(pair[0]).removeprefix("deadzone-")
    figure.suptitle(f"Two-link arm behind deadzones: {scenario}", fontsize=13)
    low, high = axes[0, 0].get_ylim()
    axes[0, 0].set_ylim(low, high + 0.15 * (high - low))  # room for the legend
    axes[1, 0].set_yscale("log")
    axes[1, 0].set_ylim(SMALLEST_RAD, 10.0)
    axes[2, 0].set_ylim(-160.0, 200.0)
    axes[3, 0].set_ylim(-160.0, 200.0)
    dress(axes.flat)
    axes[0, 0].set_xlim(0.0, 10.0)
    for ax in axes[:3, 1]:
        ax.legend(fontsize=8, ncols=3, loc="upper right", framealpha=0.9)
    figure.savefig(path)


def _draw_run(axes: Any, result: Result) -> None:
    x, of = result.traces, result.settings
    t, q_d = x["t"], x["executive:reference_1.q_d_rad"]
    deadzone_Nm = -of["arm.d_minus_Nm"], of["arm.d_plus_Nm"]
    for joint, colour in ((1, BLUE), (2, VERMILION)):
        style: dict[str, Any] = {"color": colour, "label": f"joint {joint}"}
        axes[0].plot(t, x[f"plant:arm.q_{joint}_rad"], linewidth=1.1, **style)
        size = np.maximum(np.abs(x[f"error_{joint}_rad"]), SMALLEST_RAD)
        axes[1].plot(t, size, linewidth=0.8, **style)
        command, torque = (
            x[f"executive:controller.torque_{joint}_Nm"],
            x[f"plant:arm.acting_{joint}_Nm"],
        )
        ax = axes[1 + joint]
        ax.axhspan(*deadzone_Nm, color="#F3E8D2", linewidth=0, zorder=0, label="deadzone of u")
        ax.plot(t, command, color=GREEN, linewidth=0.8, label="command u")
        ax.plot(t, torque, color=BLACK, linewidth=0.8, label="torque behind the deadzone")
    axes[0].plot(t, q_d, linewidth=0.9, label="reference", **REFERENCE)
    if np.ptp(q_d) == 0.0:
        edge_Nm = of["controller.kv_Nms_rad"] * of["controller.lam_per_s"]  # per rad
        axes[1].axhline(
            of["arm.d_minus_Nm"] / edge_Nm,
            color=GREY,
            linewidth=0.8,
            linestyle=":",
            label="d/(Kv Lam)",
        )


def draw_seeds(
    found: Mapping[Words, np.ndarray], base: Mapping[str, np.ndarray], path: Path
) -> None:
    """Draw the worse joint's error over 8-10 s of each draw against PD's.

    `found`: errors (runs, 4) by draw and scenario; `base`: PD's (4,).
    """
    figure, axes = sheet((11.0, 5.2), 120, 1, 2, sharey=True)
    rng = np.random.default_rng(1)
    for ax, scenario in zip(axes, base, strict=True):
        for i, label in enumerate(reversed(SHOWN)):
            worse = found[label, scenario][:, 2:].max(axis=1)
            beats = worse < base[scenario][2:].max()
            place = i + rng.uniform(-0.22, 0.22, len(worse))
            for mine, colour in ((beats, BLUE), (~beats, VERMILION)):
                ax.scatter(worse[mine], place[mine], s=14, color=colour, linewidths=0, alpha=0.8)
            ax.plot([np.median(worse)] * 2, [i - 0.36, i + 0.36], color=BLACK, linewidth=1.6)
        ax.axvline(base[scenario][2:].max(), color=ORANGE, linewidth=1.2)
        ax.set_xscale("log")
        ax.set_xlabel("error rms over 8-10 s, worse joint [rad]")
        ax.set_title(f"{scenario}: 20 draws, median black, PD orange", fontsize=10, loc="left")
    dress(axes, which="both", axis="x", alpha=0.6)
    axes[0].set_yticks(range(len(SHOWN)), list(reversed(SHOWN)))
    figure.suptitle("Twenty draws of the networks; red ones are worse than PD", fontsize=13)
    figure.savefig(path)
