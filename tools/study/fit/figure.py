"""The picture of a fit: each sensor with the model over it, and what the model leaves."""

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pcpc.plants.pages import BLACK, BLUE, VERMILION, sheet
from pcpc.tools.after.log.drawing import DPI, decimated

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
from pcpc.tools.study.arrays import Array

_WIDTH_IN, _ROW_IN, _REST_IN = 12.0, 1.5, 0.8
_LETTERS = 18  # of a label beside a row


def overlay(fit: Any) -> "Figure":
    """Return a row for each sensor of a `Fit`: samples and model, and what the model leaves."""
    rows = len(fit.sensors)
    page, axes = sheet(
        (_WIDTH_IN, _ROW_IN * rows + _REST_IN), DPI, rows, 2, sharex=True, squeeze=False
    )
    for j, sensor in enumerate(fit.sensors):
        there = np.isfinite(fit.measured[:, j])
        t, y = fit.t_s[there], fit.measured[there, j]
        _samples(axes[j, 0], t, y, fit.predicted[there, j], sensor)
        _draw_residual(axes[j, 1], t, y - fit.predicted[there, j], sensor)
    axes[0, 0].legend(loc="upper right", ncols=2, fontsize=8)
    axes[0, 0].set_title("log and model", fontsize=10)
    axes[0, 1].set_title("residuals, with two standard deviations", fontsize=10)
    for axis in axes[-1]:
        axis.set_xlabel("t [s]")
    page.suptitle(f"{fit.rig}: {len(fit.parameters)} parameters fitted to {Path(fit.log).parent}")
    return page


def _samples(axis: "Axes", t: Array, y: Array, model: Array, about: Any) -> None:
    axis.plot(*decimated(t, y), color=BLACK, linewidth=1.6, label="log")
    axis.plot(*decimated(t, model), color=VERMILION, linewidth=0.8, label="model")
    unit = f" [{about.unit}]" if about.unit else ""
    label = "\n".join(textwrap.wrap(about.name, _LETTERS)) + f"\n{unit}" * bool(unit)
    axis.set_ylabel(label, fontsize=8)
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.3)


def _draw_residual(axis: "Axes", t: Array, residual: Array, about: Any) -> None:
    axis.plot(*decimated(t, residual), color=BLUE, linewidth=0.6)
    for side in (-2.0, 2.0):
        axis.axhline(side * about.residual, color=BLACK, linewidth=0.8, linestyle="--")
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.3)
