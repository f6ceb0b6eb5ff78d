"""The picture of a fit: each sensor with the model over it, and what the model leaves."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.tools.after.log.drawing import DPI, decimated

Array = NDArray[np.float64]
_WIDTH_IN, _ROW_IN, _REST_IN = 12.0, 1.5, 0.8
_BLACK, _ORANGE, _BLUE = "#000000", "#D55E00", "#0072B2"


def draw(fit: Any, path: Path) -> None:
    """Write a row for each sensor of a `Fit`: samples and model, and what the model leaves."""
    from matplotlib.figure import Figure

    rows = len(fit.sensors)
    height_in = _ROW_IN * rows + _REST_IN
    page = Figure((_WIDTH_IN, height_in), layout="constrained")
    axes = page.subplots(rows, 2, sharex=True, squeeze=False)
    for j, sensor in enumerate(fit.sensors):
        there = np.isfinite(fit.measured[:, j])
        t, y = fit.t_s[there], fit.measured[there, j]
        _overlay(axes[j, 0], t, y, fit.predicted[there, j], sensor)
        _left(axes[j, 1], t, y - fit.predicted[there, j], sensor)
    axes[0, 0].legend(loc="upper right", ncols=2, fontsize=8)
    axes[0, 0].set_title("log and model", fontsize=10)
    axes[0, 1].set_title("what the model leaves, with two standard deviations", fontsize=10)
    for axis in axes[-1]:
        axis.set_xlabel("t [s]")
    page.suptitle(f"{fit.rig}: {len(fit.parameters)} parameters fitted to {Path(fit.log).parent}")
    page.savefig(path, dpi=DPI)


def _overlay(axis: Any, t: Array, y: Array, model: Array, about: Any) -> None:
    axis.plot(*decimated(t, y), color=_BLACK, linewidth=1.6, label="log")
    axis.plot(*decimated(t, model), color=_ORANGE, linewidth=0.8, label="model")
    unit = f" [{about.unit}]" if about.unit else ""
    axis.set_ylabel(f"{about.name}\n{unit}".strip(), fontsize=8)
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.3)


def _left(axis: Any, t: Array, residual: Array, about: Any) -> None:
    axis.plot(*decimated(t, residual), color=_BLUE, linewidth=0.6)
    for side in (-2.0, 2.0):
        axis.axhline(side * about.residual, color=_BLACK, linewidth=0.8, linestyle="--")
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.3)
