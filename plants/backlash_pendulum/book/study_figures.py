"""The figures of the pendulum's study: three cases side by side, and where their gain is from."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from pcpc.plants.book.figures import columns, dress, legends, reference, save, times
from pcpc.plants.pages import BLUE, GREEN, GREY, ORANGE, VERMILION, Line, Panel, sheet
from pcpc.plants.study import CaseResult

NAMES = {"pd": "PD (case 1)", "robust": "PD + robust term (2)", "nn": "PD + robust + network (3)"}
COLOURS = {"pd": VERMILION, "robust": ORANGE, "nn": BLUE}
PANELS = (
    Panel("error q - q_d [mrad]", (Line(times(1e3, "error_rad"), "", "", 1.0),)),
    Panel(
        "torque [N m]",
        (
            Line("plant:pendulum.acting_Nm", "command u", GREY, 0.9),
            reference("executive:controller.tau_d_Nm", "desired torque", 1.4),
            Line("plant:pendulum.torque_Nm", "torque behind the gap", "", 1.0),
        ),
    ),
    Panel("torque error [N m]", (Line("torque_error_Nm", "", "", 0.8),)),
)
LIMITS = ((-60.0, 60.0), (-36.0, 66.0), (-11.0, 11.0))


def title(result: CaseResult) -> str:
    """Return the name of a case, and its errors."""
    rms, largest = (1e3 * result.metric(f"error_{of}_rad") for of in ("rms", "max"))
    name = NAMES[result.case.controller]
    return f"{name}\nrms {rms:.1f}, largest {largest:.1f} mrad over 2 to 20 s"


def draw_cases(results: Sequence[CaseResult], path: Path) -> None:
    """Draw error, torque and command of the three cases, a column each, same scales in a row."""
    made, axes = columns(
        results, PANELS, LIMITS, (12.0, 7.2), title, COLOURS, until_s=20.0, dpi=130, sharey="row"
    )
    legends(axes.flat, fontsize=7, ncols=1)
    axes[0, 0].set_xticks((0, 5, 10, 15, 20))
    dress(axes.flat)
    save(made, path)


def draw_attribution(gains: Mapping[str, CaseResult], path: Path) -> None:
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
