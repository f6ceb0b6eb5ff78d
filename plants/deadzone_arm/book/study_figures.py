"""The figures of the study: PD beside the network, and what twenty draws come to."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.plants.book.figures import SHADE, Traces, columns, dress, legends, reference, save
from pcpc.plants.book.tables import Words, rig_name
from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILION, Line, Panel, sheet
from pcpc.plants.study import CaseResult

NAMES = {"pd": "PD", "nn": "PD and two networks a joint"}
SMALLEST_RAD = 1e-5  # of the logarithmic axis
SHOWN = ("rig", "rig + 1 sample", "rig + 2 samples", "L = 40", "no jump nodes", "S = 0",
         "S = 240", "random signs S = 24", "random signs S = 0", "as in the book")  # fmt: skip


def size(joint: int) -> Callable[[Traces], Any]:
    """Return what gives the magnitude of a joint's error."""
    return lambda traces: np.maximum(np.abs(traces[f"error_{joint}_rad"]), SMALLEST_RAD)


def torques(joint: int) -> Panel:
    """Return the panel of a joint's torques."""
    lines = (
        Line(f"executive:controller.torque_{joint}_Nm", "command u", GREEN, 0.8),
        Line(f"plant:arm.acting_{joint}_Nm", "torque behind the deadzone", BLACK, 0.8),
    )
    return Panel(f"joint {joint} [N m]", lines, 3.0)


JOINTS = ((1, BLUE), (2, VERMILION))
ANGLES = tuple(Line(f"plant:arm.q_{j}_rad", f"joint {j}", colour) for j, colour in JOINTS)
PANELS = (
    Panel("angle [rad]", (*ANGLES, reference("executive:reference_1.q_d_rad")), 4.0),
    Panel("|error| [rad]", [Line(size(j), f"joint {j}", c, 0.8) for j, c in JOINTS], 4.0),
    torques(1),
    torques(2),
)
LIMITS = (None, None, (-160.0, 200.0), (-160.0, 200.0))


def shade(column: Sequence[Any], result: CaseResult) -> None:
    """Shade the deadzone in the panels of the torques."""
    ends = -result.settings["arm.d_minus_Nm"], result.settings["arm.d_plus_Nm"]
    for ax in column[2:]:
        ax.axhspan(*ends, label="deadzone of u", **SHADE)


def name(result: CaseResult) -> str:
    """Return the name of a law."""
    return NAMES[result.case.controller]


def draw_beside(pair: Sequence[CaseResult], path: Path) -> None:
    """Draw PD in the left column, the network in the right: angles, errors, torques."""
    figure, axes = columns(
        pair, PANELS, LIMITS, (11.0, 10.0), name, below=shade, until_s=10.0, left=11.0, sharey="row"
    )
    for ax, result in zip(axes[1], pair, strict=True):
        if np.ptp(result.traces["executive:reference_1.q_d_rad"]) == 0.0:
            of = result.settings
            edge_Nm = of["controller.kv_Nms_rad"] * of["controller.lam_per_s"]  # per rad
            look: dict[str, Any] = {"color": GREY, "linewidth": 0.8, "linestyle": ":"}
            ax.axhline(of["arm.d_minus_Nm"] / edge_Nm, label="d/(Kv Lam)", **look)
    low, high = axes[0, 0].get_ylim()
    axes[0, 0].set_ylim(low, high + 0.15 * (high - low))  # room for the legend
    axes[1, 0].set(yscale="log", ylim=(SMALLEST_RAD, 10.0))
    dress(axes.flat)
    legends(axes[:3, 1])
    scenario = rig_name(pair[0]).removeprefix("deadzone-")
    save(figure, path, f"Two-link arm behind deadzones: {scenario}", 13)


def draw_seeds(
    errors: Mapping[Words, np.ndarray], base: Mapping[str, np.ndarray], path: Path
) -> None:
    """Draw the worse joint's error over 8-10 s of each draw against PD's.

    `errors`: errors (runs, 4) by draw and scenario; `base`: PD's (4,).
    """
    figure, axes = sheet((11.0, 5.2), 120, 1, 2, sharey=True)
    rng = np.random.default_rng(1)
    for ax, scenario in zip(axes, base, strict=True):
        for i, label in enumerate(reversed(SHOWN)):
            worse = errors[label, scenario][:, 2:].max(axis=1)
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
    save(figure, path, "Twenty draws of the networks; red ones are worse than PD", 13)
