"""The study of the chains: order, coupling known and unknown, seeds, one sample more.

Errors of x3 over 10-30 s behind deadzones (T = 0.1 s), over 10-20 s behind gaps (T = 1 ms).
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from pcpc.plants.book.tables import (
    Column,
    RunsTable,
    across,
    case_maker,
    controller_of,
    grouped,
    joined,
    label_of,
    page,
    part,
    rig_name,
)
from pcpc.plants.map_chains.book.study_figures import draw_pair
from pcpc.plants.study import Case, CaseResult

CHAPTER = 5
TITLE = "Chapters 4.3 and 5.3 with two inputs and third order"
_case = case_maker(__file__)
ZONES, GAPS = "two-deadzones", "two-gaps"
LAWS = {ZONES: ("pd", "pd_exact", "fuzzy"), GAPS: ("pd_slow", "nn", "nn_unaware")}
COUPLINGS = (0.0, 0.05, 0.2, 0.5)
SEEDS = range(101, 121)
SECOND = ("chains.order=2.0", "controller.order=2.0", "controller.lam_2=0.0")
SHOWN = ("error_a_rms", "error_b_rms", "error_a_max", "error_b_max", "jump_a_median")
TRACES = tuple(
    name.format(chain)
    for chain in "ab"
    for name in (
        "executive:reference_{}.now", "plant:chains.{}_x3", "plant:chains.{}_tau",
        "executive:controller.{}_command",
    )
)  # fmt: skip


def cases() -> Iterator[Case]:
    """Yield all runs."""
    for rig, laws in LAWS.items():
        for law in laws:
            for order, settings in (("2", SECOND), ("3", ())):
                for kappa in COUPLINGS:
                    known = f"controller.model_coupling={kappa}"
                    more = (known,) if law in ("pd_exact", "pd_slow", "nn") else ()
                    traces = TRACES if order == "3" and kappa == 0.05 else ()
                    yield _case(
                        "main",
                        rig,
                        law,
                        f"{order}, {kappa}",
                        *settings,
                        f"chains.coupling={kappa}",
                        *more,
                        traces=traces,
                    )
            yield _case("late", rig, law, law, "chains.delay_samples=1.0")
    for seed in SEEDS:
        yield _case("seeds", GAPS, "nn", str(seed), f"controller.network_seed={float(seed)}")


def result_text(result: CaseResult) -> str:
    """Return rms of chain a and of chain b."""
    if max(result.metric("a_diverged"), result.metric("b_diverged")) > 0.5:
        return "diverges"
    return f"{result.metric('error_a_rms'):.4f}, {result.metric('error_b_rms'):.4f}"


TABLES = (
    "Error rms of chain a, of chain b; a column for each coupling of the plant.\n",
    RunsTable(
        "main",
        across(part(1, ", "), COUPLINGS, Column("kappa {}", result_text)),
        rows={"rig, law": joined(rig_name, controller_of), "order": part(0, ", ")},
    ),
    "\nOne sample of delay more:\n",
    RunsTable("late", across(label_of, sum(LAWS.values(), ()), Column("{}", result_text)), rows={}),
    f"\n`nn`, seeds {SEEDS[0]} to {SEEDS[-1]} of V:\n",
    RunsTable(
        "seeds",
        (
            Column("median", "", np.median), Column("least", "", min), Column("largest", "", max),
        ),
        metrics={name: name for name in SHOWN},
    ),
)  # fmt: skip


def report(results: Sequence[CaseResult]) -> str:
    """Return the tables."""
    return page(results, TABLES)


def draw(results: Sequence[CaseResult], folder: Path) -> None:
    """Draw both rigs with their best law and without it."""
    found = grouped((r for r in results if r.traces), rig_name, controller_of)
    for rig, pair in {ZONES: ("pd", "fuzzy"), GAPS: ("pd_slow", "nn")}.items():
        draw_pair([found[rig, law][0] for law in pair], folder / f"{rig}.png")
