"""The figures of the study: errors of the default scenario; delay, wrong delay and bursts."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILION
from pcpc.plants.study import Result, of_group

COLOURS = {"pd_near": ORANGE, "pd_slow": GREY, "smith": BLUE, "nornn": GREEN, "rnn": VERMILION}
LABELS = {
    "pd_near": "PD, no delay", "pd_slow": "PD, slow", "smith": "Smith predictor",
    "nornn": "robust term only", "rnn": "predictor and RNN",
}  # fmt: skip
DETAIL_RAD = (0.15, 0.15)


def draw_all(
    results: Sequence[Result], losses: Mapping[Any, Result], bursts: Sequence[int], folder: Path
) -> None:
    """Draw all figures of `results` into the folder; `losses`: runs by controller and label."""
    import matplotlib

    matplotlib.use("Agg")
    drawn = [r for r in of_group(results, "scenarios") if r.traces]
    _errors(drawn, folder / "telerobot-u2.png")
    _margins(results, losses, bursts, folder / "margins.png")


def _errors(results: Sequence[Result], path: Path) -> None:
    """Draw angles, errors and errors in detail, both joints side by side."""
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(3, 2, figsize=(11, 8), sharex=True, layout="constrained")
    for j in (1, 2):
        angle, error, detail = axes[:, j - 1]
        for result in results:
            x, name = result.traces, result.case.controller
            aim, e = x[f"executive:controller.aim_{j}_rad"], x[f"error_{j}_rad"]
            style = {"color": COLOURS[name], "linewidth": 1.1, "label": LABELS[name]}
            angle.plot(x["t"], x[f"plant:arm.q_{j}_rad"], **style)
            error.plot(x["t"], e, **style)
            if name in ("nornn", "rnn"):
                detail.plot(x["t"], e, **style)
        angle.plot(x["t"], aim, color=BLACK, linestyle="--", linewidth=0.9, label="wanted, T ago")
        detail.set_ylim(-DETAIL_RAD[j - 1], DETAIL_RAD[j - 1])
        detail.set_title("detail: without and with the network", fontsize=9, color=GREY)
        angle.set_title(f"joint {j}", fontsize=10)
        detail.set_xlabel("time [s]")
        for ax in axes[:, j - 1]:
            load_s = (result.settings[f"arm.load_{end}_s"] for end in ("from", "to"))
            ax.axvspan(*load_s, color="#ECEFF3", linewidth=0, zorder=0)
            ax.grid(alpha=0.3)
            ax.set_xlim(0.0, 20.0)
        detail.annotate("payload", (13.4, 0.04), xycoords=("data", "axes fraction"), ha="center",
                        fontsize=8, color=GREY)  # fmt: skip
    for ax, label in zip(axes[:, 0], ("angle [rad]", "error [rad]", "error [rad]"), strict=True):
        ax.set_ylabel(label)
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, frameon=False, fontsize=9, ncols=6, loc="outside lower center")
    figure.suptitle("Telerobot, T = 0.2 s each way, friction, payload from 10 to 15 s", fontsize=11)
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def _margins(
    results: Sequence[Result], runs: Mapping[Any, Result], bursts: Sequence[int], path: Path
) -> None:
    """Draw rms errors over delay, over the error of the delay's model and over bursts."""
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 3, figsize=(12, 4), layout="constrained", sharey=False)
    delays, wrong, losses = axes
    for name in ("smith", "nornn", "rnn"):
        own = [r for r in of_group(results, "delays") if r.case.controller == name]
        _lines(delays, [float(r.case.label) for r in own], own, COLOURS[name], LABELS[name])
    delays.set(yscale="log", xlabel="delay T each way [s]", ylabel="rms error, 15 to 20 s [rad]")
    own = of_group(results, "offsets")
    _lines(wrong, [0.5 * float(r.case.label) for r in own], own, COLOURS["rnn"], "rnn")
    wrong.set(xlabel="one-way delay of the predictor wrong by [ms]", ylim=(0.0, None))
    for echo, colour, label in ((1, VERMILION, "z by echo"), (0, BLUE, "z by delay")):
        own = [runs["rnn", f"U 0.1 {burst} {echo}"] for burst in bursts]
        _lines(losses, [float(b) for b in bursts], own, colour, label)
    losses.set(xlabel="mean burst of 10 % losses of u [cycles]", ylim=(0.0, None))
    for ax in axes:
        ax.grid(alpha=0.3, which="both")
    delays.legend(frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 0.3))
    losses.legend(frameon=False, fontsize=8, loc="lower right")
    delays.set_title("PD of the same gains: unstable at all of these", fontsize=9, color=GREY)
    wrong.set_title("predictor and RNN, T = 0.2 s", fontsize=9, color=GREY)
    losses.set_title("predictor and RNN, T = 0.2 s", fontsize=9, color=GREY)
    figure.suptitle("rms error after the payload; joint 1 solid, joint 2 dashed", fontsize=11)
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def _lines(ax: Any, x: Sequence[float], results: Sequence[Result], colour: str, label: str) -> None:
    """Draw the errors of both joints."""
    for j, style in ((1, "-"), (2, "--")):
        y = [result.metric(f"error_rms_{j}_rad") for result in results]
        name = {"label": label} if j == 1 else {}
        ax.plot(x, y, style, color=colour, marker="o", markersize=3, **name)
