"""The figures of the study: errors of the default scenario; delay, wrong delay and bursts."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pcpc.plants.book.figures import draw_lines, legend_below, name_rows, overlay, reference, save
from pcpc.plants.pages import BLUE, GREEN, GREY, ORANGE, VERMILION, sheet
from pcpc.plants.study import CaseResult, of_group

COLOURS = {"pd_near": ORANGE, "pd_slow": GREY, "smith": BLUE, "nornn": GREEN, "rnn": VERMILION}
LABELS = {
    "pd_near": "PD, no delay", "pd_slow": "PD, slow", "smith": "Smith predictor",
    "nornn": "robust term only", "rnn": "predictor and RNN",
}  # fmt: skip
DETAIL_RAD = 0.15


def draw_all(
    results: Sequence[CaseResult],
    losses: Mapping[str, CaseResult],
    bursts: Sequence[int],
    folder: Path,
) -> None:
    """Draw all figures of `results` into the folder; `losses`: runs by label."""
    drawn = [r for r in of_group(results, "scenarios") if r.traces]
    _errors(drawn, folder / "telerobot-u2.png")
    _margins(results, losses, bursts, folder / "margins.png")


def _errors(results: Sequence[CaseResult], path: Path) -> None:
    """Draw angles, errors and errors in detail, both joints side by side."""
    figure, axes = sheet((11, 8), 100, 3, 2, sharex=True)
    pair = {law: COLOURS[law] for law in ("nornn", "rnn")}
    for j, (angle, error, detail) in enumerate(axes.T, 1):
        overlay(angle, results, f"plant:arm.q_{j}_rad", COLOURS, 1.1, LABELS)
        overlay(error, results, f"error_{j}_rad", COLOURS, 1.1, LABELS)
        overlay(detail, results, f"error_{j}_rad", pair, 1.1, LABELS)
        wanted = reference(f"executive:controller.aim_{j}_rad", "wanted, T ago")
        draw_lines(angle, [wanted], results[-1].traces)
        detail.set_ylim(-DETAIL_RAD, DETAIL_RAD)
        detail.set_title("detail: without and with the network", fontsize=9, color=GREY)
        angle.set_title(f"joint {j}", fontsize=10)
        for ax in (angle, error, detail):
            load_s = (results[-1].settings[f"arm.load_{end}_s"] for end in ("from", "to"))
            ax.axvspan(*load_s, color="#ECEFF3", linewidth=0, zorder=0)
            ax.grid(alpha=0.3)
            ax.set_xlim(0.0, 20.0)
        place: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "ha": "center"}
        detail.annotate("payload", (13.4, 0.04), fontsize=8, color=GREY, **place)
    name_rows(axes, ("angle [rad]", "error [rad]", "error [rad]"), "time [s]")
    legend_below(figure, axes[0, 0], 6)
    save(figure, path, "Telerobot, T = 0.2 s each way, friction, payload from 10 to 15 s", 11)


def _margins(
    results: Sequence[CaseResult], runs: Mapping[str, CaseResult], bursts: Sequence[int], path: Path
) -> None:
    """Draw rms errors over delay, over the error of the delay's model and over bursts."""
    figure, axes = sheet((12, 4), 100, 1, 3)
    delays, wrong, losses = axes
    for name in ("smith", "nornn", "rnn"):
        drawn = [r for r in of_group(results, "delays") if r.case.controller == name]
        _lines(delays, [float(r.case.label) for r in drawn], drawn, COLOURS[name], LABELS[name])
    delays.set(yscale="log", xlabel="delay T each way [s]", ylabel="rms error, 15 to 20 s [rad]")
    drawn = of_group(results, "offsets")
    _lines(wrong, [0.5 * float(r.case.label) for r in drawn], drawn, COLOURS["rnn"], "rnn")
    wrong.set(xlabel="one-way delay of the predictor wrong by [ms]", ylim=(0.0, None))
    for echo, colour, label in ((1, VERMILION, "z by echo"), (0, BLUE, "z by delay")):
        drawn = [runs[f"U 0.1 {burst} {echo}"] for burst in bursts]
        _lines(losses, [float(b) for b in bursts], drawn, colour, label)
    losses.set(xlabel="mean burst of 10 % losses of u [cycles]", ylim=(0.0, None))
    for ax in axes:
        ax.grid(alpha=0.3, which="both")
    delays.legend(frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 0.3))
    losses.legend(frameon=False, fontsize=8, loc="lower right")
    delays.set_title("PD of the same gains: unstable at all of these", fontsize=9, color=GREY)
    wrong.set_title("predictor and RNN, T = 0.2 s", fontsize=9, color=GREY)
    losses.set_title("predictor and RNN, T = 0.2 s", fontsize=9, color=GREY)
    save(figure, path, "rms error after the payload; joint 1 solid, joint 2 dashed", 11)


def _lines(
    ax: Any, x: Sequence[float], results: Sequence[CaseResult], colour: str, label: str
) -> None:
    """Draw the errors of both joints."""
    for j, style in ((1, "-"), (2, "--")):
        y = [result.metric(f"error_rms_{j}_rad") for result in results]
        name = {"label": label} if j == 1 else {}
        ax.plot(x, y, style, color=colour, marker="o", markersize=3, **name)
