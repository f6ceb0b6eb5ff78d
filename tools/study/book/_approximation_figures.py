"""Figures of `pcpc experiment approximation`: functions with a jump, nets, receptive fields."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.drivers.machine.packages import pip_install
from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION
from pcpc.tools.study.book._approximation_training import CASES, Array, Net, TrainedNet, output
from pcpc.tools.study.book.approximators import jumps
from pcpc.tools.study.book.approximators.family import (
    Approximator,
    Cmac,
    Fuzzy,
    Grid,
    rbf_net,
    rvfl_net,
)

DPI = 110
SEED = 0  # of the nets drawn
COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE)


def draw(
    folder: Path, done: Sequence[TrainedNet], fits: Mapping[int, Mapping[str, Sequence[float]]]
) -> None:
    """Write all figures into `folder`. Raises ImportError, with the cure, without matplotlib."""
    nets = {result.net: result for result in done}
    for name, case in CASES.items():
        if case.inputs == 2:
            draw_surfaces(folder / f"{name}.png", name, nets)
    standard, right = Net("sin1d", SEED), Net("sin1d", SEED, jumps.SIGMOID, -1.0)
    wrong = Net("sin1d", SEED, jumps.SIGMOID, 0.0)
    draw_lines(
        folder / "sin1d.png", "sin1d",
        {"standard network": nets[standard], "augmented, jump nodes at x = -1": nets[right],
         "augmented, jump nodes left at x = 0": nets[wrong]},
    )  # fmt: skip
    line = Net("lin1d", SEED), Net("lin1d", SEED, jumps.SIGMOID, 0.0)
    draw_lines(
        folder / "lin1d.png",
        "lin1d",
        {"standard network": nets[line[0]], "augmented, jump nodes at x = 0": nets[line[1]]},
    )
    lm = Net("sin1d", SEED, None, 0.0, "lm"), Net("sin1d", SEED, jumps.SIGMOID, -1.0, "lm")
    draw_lines(
        folder / "lm.png",
        "sin1d",
        {
            "standard, Levenberg-Marquardt": nets[lm[0]],
            "augmented, Levenberg-Marquardt": nets[lm[1]],
        },
        zoom=(-1.3, -0.7),
    )
    draw_fits(folder / "fit.png", fits)
    draw_fields(folder / "fields.png")


def page(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Any, Any]:
    """Return a figure and its axes (rows, columns)."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise ImportError(f"a figure needs matplotlib: {pip_install('matplotlib')}") from None
    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def dress(ax: Any) -> None:
    """Give axes their grid and take what frames them."""
    ax.grid(color="#D0D0D0", linewidth=0.5)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(labelsize=8)


def in_pieces(x: Array, y: Array, c: float) -> tuple[Array, Array]:
    """Return the line with a gap at its jump."""
    at = int(np.searchsorted(x, c))
    return np.insert(x, at, c), np.insert(y, at, np.nan)


def draw_lines(
    path: Path,
    name: str,
    results: Mapping[str, TrainedNet],
    zoom: tuple[float, float] | None = None,
) -> None:
    """Draw function and nets beside each other, their errors below."""
    case = CASES[name]
    low, high = zoom or (-case.half_range, case.half_range)
    x = np.linspace(low, high, 1201)
    train = case.grid(case.train_points)
    train = train[(train[:, 0] >= low - 1e-9) & (train[:, 0] <= high + 1e-9)]
    figure, axes = page(
        2,
        len(results),
        (3.6 * len(results), 5.0),
        sharex=True,
        sharey="row",
        height_ratios=(2.0, 1.3),
    )
    figure.suptitle(f"f(x) = {case.title}", fontsize=11)
    for column, (title, result) in enumerate(results.items()):
        top, below = axes[:, column]
        y = output(result.net, result.theta, x[:, None])
        exact = case.function(x[:, None])
        colour = VERMILION if column == 0 else BLUE
        top.plot(*in_pieces(x, exact, case.c), color="#B0B0B0", linewidth=4.0, label="function")
        top.plot(x, y, color=colour, linewidth=1.3, label="network")
        if zoom:
            marks = {"fillstyle": "none", "color": BLACK, "label": "training points"}
            top.plot(train[:, 0], case.function(train), "o", markersize=5.0, **marks)
        top.set_title(title, fontsize=9)
        top.legend(fontsize=7.5, frameon=False, loc="lower right" if zoom is None else "upper left")
        below.plot(*in_pieces(x, y - exact, case.c), color=colour, linewidth=1.1)
        below.set_xlabel(
            f"x\nseed {SEED}: test rms {result.test:.2g}, largest {result.largest:.2g}", fontsize=9
        )
        dress(top)
        dress(below)
    axes[0, 0].set_ylabel("f, y")
    axes[1, 0].set_ylabel("error y - f")
    figure.savefig(path)


def draw_surfaces(path: Path, name: str, nets: Mapping[Net, TrainedNet]) -> None:
    """Draw function, standard and augmented network as surfaces, the errors as maps below."""
    case, n = CASES[name], 81
    x = case.grid(n)
    standard = nets[Net(name, SEED)]
    augmented = nets[Net(name, SEED, jumps.SIGMOID, case.c)]
    exact = case.function(x)
    outputs = [exact, *(output(r.net, r.theta, x) for r in (standard, augmented))]
    low, high = min(y.min() for y in outputs), max(y.max() for y in outputs)
    figure, axes = page(2, 3, (11.0, 6.8), height_ratios=(1.5, 1.0))
    figure.suptitle(f"f(x1, x2) = {case.title}; seed {SEED}", fontsize=11)
    a, b = x[:, 0].reshape(n, n), x[:, 1].reshape(n, n)
    titles = ("function", "standard network", "augmented network, jump nodes at x1 = 0")
    for ax, y, title in zip(axes[0], outputs, titles, strict=True):
        spec = ax.get_subplotspec()
        ax.remove()
        surface = figure.add_subplot(spec, projection="3d")
        surface.plot_surface(
            a,
            b,
            y.reshape(n, n),
            cmap="viridis",
            vmin=low,
            vmax=high,
            rcount=41,
            ccount=41,
            linewidth=0.1,
            edgecolor="#00000030",
        )
        surface.set(xlabel="x1", ylabel="x2", zlim=(low, high))
        surface.set(xticks=(-1, 0, 1), yticks=(-1, 0, 1))
        surface.set_title(title, fontsize=10)
        surface.tick_params(labelsize=7)
        surface.view_init(26, -62)
    limit = 0.5 * float(np.abs(outputs[1] - exact).max())
    image = None
    for ax, y, result in zip(axes[1, 1:], outputs[1:], (standard, augmented), strict=True):
        image = ax.pcolormesh(
            a, b, (y - exact).reshape(n, n), cmap="RdBu_r", vmin=-limit, vmax=limit
        )
        ax.set(xlabel="x1", ylabel="x2", aspect="equal")
        text = f"error y - f: test rms {result.test:.3f}, largest {result.largest:.2f}"
        ax.set_title(text, fontsize=9)
        ax.tick_params(labelsize=8)
    figure.colorbar(image, ax=axes[1, 1:], shrink=0.9, extend="both", label="error y - f")
    draw_cut(axes[1, 0], case.function, (standard, augmented))
    figure.savefig(path)


def draw_cut(
    ax: Any, function: Callable[[Array], Array], results: tuple[TrainedNet, TrainedNet]
) -> None:
    """Draw the cut x2 = 0."""
    line = np.linspace(-1.0, 1.0, 801)
    cut = np.column_stack((line, np.zeros_like(line)))
    ax.plot(*in_pieces(line, function(cut), 0.0), color="#B0B0B0", linewidth=4.0, label="function")
    for result, colour, label in zip(
        results, (VERMILION, BLUE), ("standard", "augmented"), strict=True
    ):
        ax.plot(
            line, output(result.net, result.theta, cut), color=colour, linewidth=1.2, label=label
        )
    ax.set_title("cut at x2 = 0", fontsize=9)
    ax.set(xlabel="x1", ylabel="f, y")
    ax.legend(fontsize=8, frameon=False, loc="upper left")
    dress(ax)


def draw_fits(path: Path, fits: Mapping[int, Mapping[str, Sequence[float]]]) -> None:
    """Draw the error of the least-squares fits over the number of nodes."""
    figure, axes = page(1, 1, (7.0, 4.6))
    ax, sizes = axes[0, 0], sorted(fits)
    nodes = [n * n for n in sizes]
    for kind, colour, mark in zip(fits[sizes[0]], COLOURS, "osD^v", strict=True):
        values = [fits[n][kind] for n in sizes]
        ax.plot(nodes, [np.median(v) for v in values], marker=mark, color=colour, label=kind)
        if len(values[0]) > 1:
            low, high = [min(v) for v in values], [max(v) for v in values]
            ax.fill_between(nodes, low, high, color=colour, alpha=0.15, linewidth=0)
    ax.set(xscale="log", yscale="log", xlabel="nodes", ylabel="rms error on the offset grid")
    ax.set_xticks(nodes, [f"{n * n}\n({n} x {n})" for n in sizes])
    ax.minorticks_off()
    ax.set_title("sin(pi x1) cos(pi x2/2) + 0.3 x1 x2 on [-1, 1]^2, least squares", fontsize=10)
    ax.legend(fontsize=8.5, frameon=False, title="RVFL: median and range of 20 seeds")
    dress(ax)
    figure.savefig(path)


def draw_fields(path: Path) -> None:
    """Draw the hidden vector of every approximator over one input."""
    grid, x = Grid((-1.0,), (1.0,), (5,)), np.linspace(-1.5, 1.5, 601)
    nets: dict[str, Approximator] = {
        "RBF, one-sided edges": rbf_net(grid, 1),
        "CMAC, triangles": Cmac(grid, 1),
        "CMAC, splines of order 4": Cmac(grid, 1, order=4),
        "fuzzy basis of Gaussian sets": Fuzzy(grid, 1),
        "RVFL, seed 0": rvfl_net((-1.0,), (1.0,), 5, 1, 0),
    }
    figure, axes = page(2, 3, (10.0, 5.2))
    for ax, (title, net) in zip(axes.flat, nets.items(), strict=False):
        phi = np.array([net.hidden(np.array([point]))[0] for point in x])
        for j in range(phi.shape[1]):
            ax.plot(x, phi[:, j], linewidth=1.2)
        ax.axvspan(-1.0, 1.0, color="#ECEFF3", linewidth=0, zorder=0)
        ax.set_title(title, fontsize=9)
        ax.set(xlabel="x", ylabel="phi")
        dress(ax)
    ax, phi = axes[1, 2], np.zeros(4)
    z = np.linspace(-1.0, 3.0, 801)
    values = []
    for point in z:
        jumps.jump_nodes(jumps.SIGMOID, float(point), 4, phi, 0)
        values.append(phi.copy())
    for k, colour in enumerate((BLACK, BLUE, VERMILION, GREEN)):
        ax.plot(*in_pieces(z, np.array(values)[:, k], 0.0), color=colour, label=f"k = {k}")
    ax.axvline(0.0, color=GREY, linewidth=0.6, linestyle=":")
    ax.set_title("jump basis, sigmoid", fontsize=9)
    ax.set(xlabel="z = x - c", ylabel="phi_k")
    ax.legend(fontsize=8, frameon=False, loc="lower right")
    dress(ax)
    figure.savefig(path)
