"""`pcpc experiment stability`: four small systems on which Lyapunov's method is seen at work.

    asymptotic   x' = y - x r^2, y' = -x - y r^2, r^2 = x^2 + y^2:  V = r^2/2, V' = -4 V^2       (1)
                 V = V0/(1 + 4 V0 t)
    local        x' = x (r^2 - 1) - y, y' = x + y (r^2 - 1):  V' = 2 V (2 V - 1)                 (2)
                 1/V = 2 + (1/V0 - 2) exp(2 t): to 0 from within r = 1 only
    Barbalat     e' = -e + p w, p' = -e w, w = exp(-t):  V = (e^2 + p^2)/2, V' = -e^2            (3)
                 e goes to 0, as e' is bounded; p need not, as w fades
    UUB          x' = -x + d, |d| <= D:  V' = x (d - x) < 0 where |x| > D                        (4)
                 d = D: x = D + (x0 - D) exp(-t), so that no smaller bound would do

All are chosen; the text used here does not have its examples. figures/stability.png draws them,
results.md compares them with what is exact. No units, s.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.plants.pages import BLUE, GREY, ORANGE, VERMILION
from pcpc.tools.study.book._gallery import Row, gallery
from pcpc.tools.terminal.progress import Progress

Vector = NDArray[np.float64]
T_S = np.linspace(0.0, 6.0, 1201)
MOST = 1.0  # D of (4)


def run(folder: Path, progress: Progress, jobs: int | None) -> int:
    """Write results.md and the figure; return 0."""
    progress.show("stability: drawing")
    head = ("what", "computed", "exact, or the limit")
    panels = (asymptotic, local, barbalat, bounded)
    return gallery(folder, progress, "stability", "Stability", head, panels, (14, 3.6), 1, 8)


def solution(slope: Callable[[float, Vector], Vector], start: tuple[float, ...]) -> Vector:
    """Return the states at `T_S`, (states, n), by the classical Runge-Kutta method."""
    with np.errstate(over="ignore", invalid="ignore"):  # (2) escapes in finite time
        return np.array([*_steps(slope, np.array(start))]).T


def _steps(slope: Callable[[float, Vector], Vector], x: Vector) -> Iterator[Vector]:
    h = float(T_S[1])
    yield x
    for t in map(float, T_S[:-1]):
        a = slope(t, x)
        b = slope(t + h / 2, x + h / 2 * a)
        c = slope(t + h / 2, x + h / 2 * b)
        d = slope(t + h, x + h * c)
        x = x + h / 6 * (a + 2 * b + 2 * c + d)
        yield x


def asymptotic(ax: Any) -> list[Row]:
    """Draw V of (1) from two starts over its closed form."""
    rows = []
    for size, colour in ((1.0, BLUE), (2.0, VERMILION)):
        x, y = solution(_spiral, (size, 0.0))
        v, exact = (x**2 + y**2) / 2, size**2 / 2 / (1 + 2 * size**2 * T_S)
        ax.semilogy(T_S, v, color=colour, label=f"from r = {size:g}")
        ax.semilogy(T_S, exact, ":", color=GREY)
        rows.append((f"(1) from r = {size:g}, V at the end", f"{v[-1]:.8f}", f"{exact[-1]:.8f}"))
    ax.set(title="asymptotic: V falls; dotted: exact", ylabel="V", xlabel="t [s]")
    return rows


def _spiral(t: float, s: Vector) -> Vector:
    x, y = s
    return np.array([y - x * (x * x + y * y), -x - y * (x * x + y * y)])


def local(ax: Any) -> list[Row]:
    """Draw V of (2) from within and from beyond the circle."""
    rows = []
    for size, colour in ((0.99, BLUE), (1.0, GREY), (1.001, VERMILION)):
        start = size**2 / 2
        x, y = solution(_circle, (size, 0.0))
        v, inverse = (x**2 + y**2) / 2, 2 + (1 / start - 2) * np.exp(2 * T_S)
        finite = inverse > 0.1
        ax.semilogy(T_S[finite], v[finite], color=colour, label=f"from r = {size:g}")
        at = int(np.flatnonzero(finite)[-1])
        what = f"(2) from r = {size:g}, V at {T_S[at]:.2f} s"
        rows.append((what, f"{v[at]:.4f}", f"{1 / inverse[at]:.4f}"))
    ax.set(title="local: only from within r = 1", ylabel="V", xlabel="t [s]")
    return rows


def _circle(t: float, s: Vector) -> Vector:
    x, y = s
    pull = x * x + y * y - 1
    return np.array([x * pull - y, x + y * pull])


def barbalat(ax: Any) -> list[Row]:
    """Draw error and parameter of (3)."""
    e, p, spent = solution(_adaptive, (1.0, 1.0, 0.0))
    for values, colour, name in (
        (e, VERMILION, "error e"),
        (p, BLUE, "parameter p"),
        ((e**2 + p**2) / 2, GREY, "V"),
    ):
        ax.plot(T_S, values, color=colour, label=name)
    ax.set(title="Barbalat: e to 0, p not", xlabel="t [s]")
    kept = (e[-1] ** 2 + p[-1] ** 2) / 2 + spent[-1]
    return [
        ("(3) V and the integral of e^2, at the end", f"{kept:.8f}", "V0 = 1"),
        ("(3) error at the end", f"{e[-1]:.4f}", "to 0"),
        ("(3) parameter at the end", f"{p[-1]:.4f}", "any"),
    ]


def _adaptive(t: float, s: Vector) -> Vector:
    (e, p, _), w = s, np.exp(-t)
    return np.array([-e + p * w, -e * w, e * e])


def bounded(ax: Any) -> list[Row]:
    """Draw x of (4) under three disturbances, and its bound."""
    rows = []
    for name, colour, d, most in (
        ("d = D", VERMILION, lambda t: MOST, MOST),
        ("d = D sin 2t", BLUE, lambda t: MOST * np.sin(2 * t), MOST / np.sqrt(5)),
        ("d = -D", ORANGE, lambda t: -MOST, MOST),
    ):
        (x,) = solution(lambda t, s, d=d: np.array([-s[0] + d(t)]), (3.0,))  # type: ignore[misc]
        ax.plot(T_S, x, color=colour, label=name)
        last = np.abs(x[T_S > 4.5]).max()
        rows.append((f"(4) {name}, largest x or -x after 4.5 s", f"{last:.4f}", f"to {most:.4f}"))
    for edge in (-MOST, MOST):
        ax.axhline(edge, color=GREY, linestyle=":")
    ax.set(title="UUB: into |x| <= D (dotted)", ylabel="x", xlabel="t [s]")
    return rows
