"""What judges and draws a run of the chains: each against its reference, widths learned, jumps.

    e(k) = x3(k) - x_d(k)               of either chain, true, not as measured               (1)
    du = |u(k+1) - u(k)|                jumps of a command                                   (2)

Contract: plants/evaluation.py. Without units, but s.
"""

from collections.abc import Callable

import numpy as np

from pcpc.plants.evaluation import *


def output_group(chain: str) -> str:
    """Return the name of the law's output group of a chain."""
    return f"executive:controller.{chain}_"


def error(chain: str) -> Callable[[Run], Vector]:
    """Return what computes (1). Its values: (n,)."""
    return lambda run: run[f"plant:chains.{chain}_x3"] - run[f"executive:reference_{chain}.now"]


def jump(chain: str) -> Callable[[Run], Vector]:
    """Return what computes (2). Its values: (n,)."""
    return lambda run: np.abs(run.step(run[f"{output_group(chain)}command"]))


def state(chain: str, colour: str) -> Panel:
    """Return the panel of a chain's newest state."""
    return Panel(
        f"x3 of {chain}",
        (
            Line(f"executive:reference_{chain}.now", "reference", BLACK, 1.4, "--"),
            Line(f"plant:chains.{chain}_x3", "x3", colour),
        ),
        5.0,
    )


def inputs(chain: str, colour: str) -> Panel:
    """Return the panel of what drives a chain."""
    return Panel(
        f"input of {chain}",
        (
            Line(f"{output_group(chain)}command", "command", GREY, 0.7),
            Line(f"plant:chains.{chain}_tau", "behind deadzone or gap", colour, 0.9),
        ),
        4.0,
    )


EVALUATION = Evaluation(
    signals={
        "error_a": error("a"),
        "error_b": error("b"),
        "jump_a": jump("a"),
        "jump_b": jump("b"),
    },
    merits={
        "error_a_rms": Rms("error_a"),
        "error_b_rms": Rms("error_b"),
        "error_a_max": Peak("error_a"),
        "error_b_max": Peak("error_b"),
        "a_d_plus": Last(f"{output_group('a')}d_plus", RUN),
        "a_d_minus": Last(f"{output_group('a')}d_minus", RUN),
        "b_d_plus": Last(f"{output_group('b')}d_plus", RUN),
        "b_d_minus": Last(f"{output_group('b')}d_minus", RUN),
        "jump_a_median": Median("jump_a", RUN),
        "jump_b_median": Median("jump_b", RUN),
        "a_diverged": Highest(f"{output_group('a')}diverged", RUN),
        "b_diverged": Highest(f"{output_group('b')}diverged", RUN),
    },
    panels=(
        state("a", BLUE),
        state("b", GREEN),
        Panel(
            "error x3 - reference",
            (Line("error_a", "chain a", BLUE, 0.8), Line("error_b", "chain b", GREEN, 0.8)),
            5.0,
        ),
        inputs("a", BLUE),
        inputs("b", GREEN),
    ),
    notes=(
        ("a: error {error_a_rms:.4f} rms, {error_a_max:.4f} max",),
        ("b: error {error_b_rms:.4f} rms, {error_b_max:.4f} max",),
    ),
)
