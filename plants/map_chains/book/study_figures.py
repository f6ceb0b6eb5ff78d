"""The figures of the chains' study: a law beside another, both chains."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from pcpc.plants.book.figures import columns, dress, legends, reference, save
from pcpc.plants.pages import BLUE, GREEN, GREY, Line, Panel
from pcpc.plants.study import CaseResult

TITLES = {
    "pd": "PD",
    "fuzzy": "PD with fuzzy precompensators",
    "pd_slow": "PD",
    "nn": "inversion with networks",
}


def panels(chain: str, colour: str) -> Iterator[Panel]:
    """Yield newest state and inputs of a chain."""
    wanted = reference(f"executive:reference_{chain}.now", "$x_d$", 1.2)
    state = Line(f"plant:chains.{chain}_x3", "$x_3$", colour, 1.0)
    yield Panel(f"x3 of {chain} (no unit)", (wanted, state))
    command = Line(f"executive:controller.{chain}_command", "command", GREY, 0.6)
    tau = Line(f"plant:chains.{chain}_tau", "tau", colour, 0.9)
    yield Panel(f"input of {chain} (no unit)", (command, tau))


def title(result: CaseResult, chain: str = "a") -> str:
    """Return what is drawn of a chain."""
    rms = result.metric(f"error_{chain}_rms")
    return f"chain {chain}, {TITLES[result.case.controller]}: rms {rms:.4f}"


def draw_pair(pair: Sequence[CaseResult], path: Path) -> None:
    """Draw newest states and inputs of both chains, a column a law."""
    rows = (*panels("a", BLUE), *panels("b", GREEN))
    limits = ((-1.3, 1.3), (-0.7, 0.7)) * 2
    figure, axes = columns(pair, rows, limits, (11.0, 8.0), title, dpi=110, sharey="row")
    for ax, result in zip(axes[2], pair, strict=True):
        ax.set_title(title(result, "b"), fontsize=10)
    legends(axes.flat, ncols=2)
    dress(axes.flat, 8)
    save(figure, path)
