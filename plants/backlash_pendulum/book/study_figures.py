"""The figures of the pendulum's study: three cases side by side, and where their gain is from."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from pcpc.plants.book.figures import REFERENCE, dress, name_rows
from pcpc.plants.pages import BLUE, GREEN, GREY, ORANGE, VERMILION, sheet
from pcpc.plants.study import Result

NAMES = {"pd": "PD (case 1)", "robust": "PD + robust term (2)", "nn": "PD + robust + network (3)"}
COLOURS = {"pd": VERMILION, "robust": ORANGE, "nn": BLUE}
MRAD = 1e3


def draw_cases(results: Sequence[Result], path: Path) -> None:
    """Draw error, torque and command of the three cases, a column each, same scales in a row."""
    made, axes = sheet((12.0, 7.2), 130, 3, len(results), sharex=True, sharey="row")
    for column, result in enumerate(results):
        tr, law = result.traces, result.case.controller
        t = tr["t"]
        top, middle, bottom = axes[:, column]
        rms, largest = (1e3 * result.metric(f"error_{of}_rad") for of in ("rms", "max"))
        top.set_title(
            f"{NAMES[law]}\nrms {rms:.1f}, largest {largest:.1f} mrad over 2 to 20 s", size=10
        )
        top.plot(t, MRAD * tr["error_rad"], color=COLOURS[law], linewidth=1.0)
        tau, tau_d = tr["plant:pendulum.torque_Nm"], tr["executive:controller.tau_d_Nm"]
        middle.plot(t, tr["plant:pendulum.acting_Nm"], color=GREY, linewidth=0.9, label="command u")
        middle.plot(t, tau_d, linewidth=1.4, label="desired torque", **REFERENCE)
        middle.plot(t, tau, color=COLOURS[law], linewidth=1.0, label="torque behind the gap")
        middle.legend(fontsize=7, loc="upper right", ncols=1, framealpha=0.9)
        bottom.plot(t, tr["torque_error_Nm"], color=COLOURS[law], linewidth=0.8)
    for ax, ends in zip(axes[:, 0], ((-60.0, 60.0), (-36.0, 66.0), (-11.0, 11.0)), strict=True):
        ax.set(ylim=ends, xlim=(0.0, 20.0), xticks=(0, 5, 10, 15, 20))
    names = ("error q - q_d [mrad]", "torque [N m]", "torque error [N m]")
    name_rows(axes, names, "time [s]")
    dress(axes.flat)
    made.savefig(path)


def draw_attribution(gains: Mapping[str, Result], path: Path) -> None:
    """Draw the rms error of each law as a bar, the whole law's last."""
    made, ax = sheet((8.0, 4.4), 130)
    labels = list(gains)
    values = [1e3 * result.metric("error_rms_rad") for result in gains.values()]
    colours = [_colour(label) for label in labels]
    bars = ax.barh(labels, values, color=colours)
    ax.bar_label(bars, fmt="%.1f", padding=3, fontsize=8)
    ax.invert_yaxis()
    ax.set_xlabel("error, rms over 2 to 20 s [mrad]")
    ax.set_title(
        "Pendulum behind backlash: a higher plain gain Kb does what the network does", size=10
    )
    dress([ax], 8, below=True, axis="x")
    made.savefig(path)


def _colour(label: str) -> str:
    if label.startswith("PD"):
        return VERMILION
    return ORANGE if label.startswith("robust") else GREEN if "without" in label else BLUE
