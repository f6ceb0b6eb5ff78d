"""The figures of the study: PD beside the critic, what each part brings, the weights over 60 s."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.plants.book.figures import SHADE, Traces, columns, dress, legends, reference, save, times
from pcpc.plants.pages import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILION,
    Line,
    Panel,
    sheet,
)
from pcpc.plants.study import CaseResult

NAMES = {"pd": "PD", "robust_only": "PD, robust term", "critic": "PD, robust term, both networks"}
JOINTS = ((1, BLUE), (2, VERMILION))
GRID: dict[str, Any] = {"below": True, "which": "both", "alpha": 0.6}
SMALLEST_RAD = 1e-4  # of the logarithmic axis


def _shade(axes: Iterable[Any], result: CaseResult) -> None:
    """Shade the time with the payload."""
    ends = [result.settings[f"arm.payload_{end}_s"] for end in ("from", "to")]
    for ax in axes:
        ax.axvspan(*ends, **SHADE)


def size(joint: int) -> Callable[[Traces], Any]:
    """Return what gives the magnitude of a joint's error."""

    def values(x: Traces) -> Any:
        error = x[f"executive:reference_{joint}.q_d_rad"] - x[f"plant:arm.q_{joint}_rad"]
        return np.maximum(np.abs(error), SMALLEST_RAD)

    return values


def of_joints(source: Callable[[int], Any], width: float = 0.9) -> tuple[Line, ...]:
    """Return a line a joint."""
    return tuple(Line(source(j), f"joint {j}", colour, width) for j, colour in JOINTS)


Q_1, Q_2 = of_joints("plant:arm.q_{}_rad".format, 1.2)
Q_D = "executive:reference_{}.q_d_rad"
PANELS = (
    Panel(
        "angle [rad]",
        (Q_1, reference(Q_D.format(1), "", 0.8), Q_2, reference(Q_D.format(2), "references", 0.8)),
        4.0,
    ),
    Panel("|error| [rad]", of_joints(size), 5.0),
    Panel("torque [N m], start cut", of_joints("plant:arm.acting_{}_Nm".format), 3.0),
)
LONG = (
    Panel("error [mrad]", of_joints(lambda j: times(1e3, f"error_{j}_rad"))),
    Panel(
        "critic",
        (
            Line("critic", "critic signal |R|", PURPLE, 1.5),
            Line("executive:controller.norm_w1", "critic |W1|", GREEN, 1.5),
            Line("executive:controller.norm_rho", "critic |rho|", ORANGE, 1.5),
        ),
    ),
    Panel(
        "action network", (Line("executive:controller.norm_w2", "action |W2|", BLACK, 1.5),)
    ),
)  # fmt: skip


def name(result: CaseResult) -> str:
    """Return the name of a law."""
    return NAMES[result.case.controller]


def draw_beside(runs: Sequence[CaseResult], path: Path) -> None:
    """Draw a column a controller: angles, errors, torques; the payload is shaded."""
    figure, axes = columns(
        runs,
        PANELS,
        ((-1.3, 1.9), None, (-80.0, 100.0)),
        (12.0, 9.0),
        name,
        below=_shade,
        until_s=10.0,
        left=11.0,
        sharey="row",
    )
    dress(axes.flat, **GRID)
    axes[1, 0].set(yscale="log", ylim=(SMALLEST_RAD, 3.0))
    legends(axes[:, -1])
    save(figure, path, "sin t and cos t with a payload of 1.5 kg from 5 to 7 s (shaded)", 13)


def draw_parts(shown: Mapping[str, CaseResult], seeds: Sequence[CaseResult], path: Path) -> None:
    """Draw the rms errors of each combination of parts before, under and after the payload."""
    figure, axes = sheet((12.0, 5.0), 120, 1, 3, sharex=True, sharey=True)
    windows = (
        ("early_error_rms", "3 to 5 s, before the payload"),
        ("payload_error_rms", "5 to 7 s, with the payload"),
        ("error_rms", "8 to 10 s, after it"),
    )
    labels = list(shown)[::-1]
    all_parts = labels.index(next(label for label in labels if label.startswith("all:")))
    for ax, (metric, title) in zip(axes, windows, strict=True):
        for joint, colour in JOINTS:
            place = np.arange(len(labels)) - (0.12 if joint == 2 else -0.12)
            values = [shown[label].metric(f"{metric}_{joint}_rad") for label in labels]
            ax.plot(values, place, "o", color=colour, markersize=7, label=f"joint {joint}")
            drawn = [result.metric(f"{metric}_{joint}_rad") for result in seeds]
            at = np.full(len(drawn), place[all_parts])
            name = "other first layers" if joint == 2 else None
            ax.plot(drawn, at, "|", color=GREY, markersize=9, label=name, zorder=0)
        ax.set_xscale("log")
        ax.set_xlabel("rms error [rad]")
        ax.set_title(title, fontsize=10, loc="left")
    dress(axes, **GRID)
    axes[0].set_yticks(range(len(labels)), labels)
    legends(axes[:1], ncols=1)
    save(figure, path, "What each part of the law brings", 13)


def draw_long(result: CaseResult, path: Path) -> None:
    """Draw errors and norms of the run of 60 s with the payload in its beginning."""
    limits = ((-60.0, 60.0), None, None)
    end_s = result.traces["t"][-1]
    figure, axes = columns(
        [result], LONG, limits, (11.0, 7.0), lambda _: "", below=_shade, until_s=end_s
    )
    legends(axes.flat)
    dress(axes.flat, **GRID)
    save(figure, path, "60 s: errors and weights stay bounded, payload from 5 to 7 s", 13)
