"""Bode and Nyquist plots of a `pcpc.Margin`: linearised as lines, measured as points."""

from typing import TYPE_CHECKING, Any

import numpy as np

from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, VERMILION, bare, sheet
from pcpc.tools.study.arrays import Vector

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DPI = 110
_FAR = 3.0  # of the Nyquist plot's axes


def _dress(ax: "Axes") -> None:
    bare(ax)
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=8)


def _title(found: Any) -> str:
    return f"{found.rig}, {found.controller}: open loop at {found.loop}"


def bode(found: Any) -> "Figure":
    """Return |L|, arg L and |S| over the frequency."""
    figure, axes = sheet((7.5, 7.5), _DPI, 3, sharex=True)
    top, middle, low = axes
    figure.suptitle(_title(found), fontsize=11)
    for one, style in _styles(found):
        size, angle = np.abs(one.response), np.unwrap(np.angle(one.response))
        angle -= 2.0 * np.pi * np.ceil(angle[0] / (2.0 * np.pi) - 1e-9)
        top.loglog(one.f_hz, size, **style)
        middle.semilogx(one.f_hz, np.rad2deg(angle), **style)
        low.loglog(one.f_hz, np.abs(1.0 / (1.0 + one.response)), **style)
    for ax in (top, low):
        ax.axhline(1.0, color=GREY, linewidth=0.7)
    first, last = middle.get_ylim()
    for level in np.arange(-1980.0, 1980.0, 360.0):
        if first <= level <= last:
            middle.axhline(level, color=GREY, linewidth=0.7)
    numbers = found.margins
    for ax in (top, middle):
        for at, colour in ((numbers.gain_margin_hz, VERMILION), (numbers.crossover_hz, GREEN)):
            if np.isfinite(at):
                ax.axvline(at, color=colour, linewidth=0.8, linestyle=":")
    if found.measured is not None:
        own = found.measured.margins
        for at, size, colour in (
            (own.gain_margin_hz, 1.0 / own.gain_margin, VERMILION),
            (own.crossover_hz, 1.0, GREEN),
        ):
            if np.isfinite(at):  # nothing where it was not measured
                top.loglog(at, size, "D", color=colour, markersize=5.0)
    low.set_xlabel(
        "frequency [Hz]; where |L| = 1 (green), where L < 0 is real (red); diamonds: as measured"
    )
    top.legend(fontsize=8, frameon=False)
    for ax, label in zip(axes, ("|L|", "arg L [deg]", "|S| = 1/|1 + L|"), strict=True):
        ax.set_ylabel(label)
        _dress(ax)
    return figure


def nyquist(found: Any) -> "Figure":
    """Return L in the complex plane about -1, with the disk that it keeps out of."""
    figure, ax = sheet((6.0, 6.0), _DPI)
    ax.set_title(_title(found), fontsize=11)
    turn = np.linspace(0.0, 2.0 * np.pi, 400)
    ax.plot(np.cos(turn), np.sin(turn), color=GREY, linewidth=0.7, linestyle=":")
    ax.fill(*_disk(found.margins.disk_margin, turn), color="#F3D9CB", linewidth=0)
    for one, style in _styles(found):
        ax.plot(one.response.real, one.response.imag, **style)
    ax.plot(-1.0, 0.0, "+", color=VERMILION, markersize=10, markeredgewidth=1.6)
    ax.set(xlim=(-_FAR, 0.5 * _FAR), ylim=(-0.75 * _FAR, 0.75 * _FAR), aspect="equal")
    ax.set(xlabel="real part of L; shaded: the disk of the disk margin", ylabel="imaginary part")
    ax.legend(fontsize=8, frameon=False, loc="upper left")
    _dress(ax)
    return figure


def limit_cycle(found: Any) -> "Figure":
    """Return the branch of a `LimitCycle` and the runs beside it."""
    figure, ax = sheet((7.0, 4.6), _DPI)
    at = found.branch.index(found.onset)
    for part, line, name in (
        (found.branch[: at + 1], "-", "predicted, stable"),
        (found.branch[at:], "--", "predicted, unstable"),
    ):
        x, y = [one.factor for one in part], [one.step_rms for one in part]
        ax.semilogy(x, y, line, color=BLUE, linewidth=1.2, label=name)
    x = [row.factor for row in found.rows]
    shown = min(one.step_rms for one in found.branch)
    y = [row.alone if row.alone > shown else np.nan for row in found.rows]
    ax.semilogy(
        x, y, "s", color=GREEN, fillstyle="none", label="alone: no reference, noise, models"
    )
    y = [row.run for row in found.rows]
    ax.semilogy(x, y, "o", color=BLACK, fillstyle="none", label="the rig, with all of them")
    ax.axvline(
        found.linear_factor,
        color=VERMILION,
        linewidth=0.8,
        linestyle=":",
        label="the linear loop becomes unstable",
    )
    unit = f" [{found.unit}]" if found.unit else ""
    ax.set_title(f"{found.rig}, {found.controller}: limit cycles", fontsize=11)
    ax.set(xlabel=f"factor of {found.gain}", ylabel=f"step of {found.signal}, rms{unit}")
    ax.legend(fontsize=8, frameon=False)
    _dress(ax)
    return figure


def _disk(alpha: float, turn: Vector) -> tuple[Vector, Vector]:
    """Return the edge of what L keeps out of: -1/factor of all factors of the disk margin."""
    delta = min(alpha, 1.999) * np.exp(1j * turn)
    edge = -(1.0 - 0.5 * delta) / (1.0 + 0.5 * delta)
    return edge.real, edge.imag


_STYLES: dict[str, dict[str, Any]] = {
    "linearised": {"color": BLUE, "linewidth": 1.2},
    "measured": {
        "color": BLACK, "linestyle": "none", "marker": "o", "markersize": 3.0, "fillstyle": "none",
    },
}  # fmt: skip


def _styles(found: Any) -> list[tuple[Any, dict[str, Any]]]:
    return [(one, _STYLES[name] | {"label": name}) for name, one in found.responses.items()]
