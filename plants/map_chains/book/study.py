"""The study of the chains: order, coupling known and unknown, seeds, one sample more.

Errors of x3 over 10-30 s behind deadzones (T = 0.1 s), over 10-20 s behind gaps (T = 1 ms).
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from pcpc.plants.book.tables import by_case, case_maker, rig_name
from pcpc.plants.map_chains.book.study_figures import draw_pair
from pcpc.plants.study import Case, Result, markdown, of_group

CHAPTER = 5
TITLE = "Chapters 4.3 and 5.3 with two inputs and third order"
_case = case_maker(__file__)
ZONES, GAPS = "two-deadzones", "two-gaps"
LAWS = {ZONES: ("pd", "pd_exact", "fuzzy"), GAPS: ("pd_slow", "nn", "nn_unaware")}
COUPLINGS = (0.0, 0.05, 0.2, 0.5)
SEEDS = range(101, 121)
SECOND = ("chains.order=2.0", "controller.order=2.0", "controller.lam_2=0.0")
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


def result_text(result: Result) -> str:
    """Return rms of chain a and of chain b."""
    if max(result.metric("a_diverged"), result.metric("b_diverged")) > 0.5:
        return "diverges"
    return f"{result.metric('error_a_rms'):.4f}, {result.metric('error_b_rms'):.4f}"


def report(results: Sequence[Result]) -> str:
    """Return the tables."""
    main, rows = by_case(results, "main"), []
    for rig, laws in LAWS.items():
        for law in laws:
            for order in "23":
                found = [main[rig, law, f"{order}, {kappa}"] for kappa in COUPLINGS]
                rows.append([f"{rig}, {law}", order, *map(result_text, found)])
    late = {r.case.label: result_text(r) for r in of_group(results, "late")}
    return "\n".join(
        (
            "Error rms of chain a, of chain b; a column for each coupling of the plant.\n",
            markdown(("rig, law", "order", *(f"kappa {kappa}" for kappa in COUPLINGS)), rows),
            "\nOne sample of delay more:\n",
            markdown(tuple(late), [list(late.values())]),
            f"\n`nn`, seeds {SEEDS[0]} to {SEEDS[-1]} of V:\n",
            _seeds(of_group(results, "seeds")),
        )
    )


def _seeds(runs: Sequence[Result]) -> str:
    rows = []
    for name in ("error_a_rms", "error_b_rms", "error_a_max", "error_b_max", "jump_a_median"):
        values = [run.metric(name) for run in runs]
        rows.append([name, f"{np.median(values):.4f}", f"{min(values):.4f}", f"{max(values):.4f}"])
    return markdown(("", "median", "least", "largest"), rows)


def draw(results: Sequence[Result], folder: Path) -> None:
    """Draw both rigs with their best law and without it."""
    drawn = (r for r in of_group(results, "main") if r.traces)
    found = {(rig_name(r), r.case.controller): r for r in drawn}
    draw_pair(found[ZONES, "pd"], found[ZONES, "fuzzy"], folder / "two-deadzones.png")
    draw_pair(found[GAPS, "pd_slow"], found[GAPS, "nn"], folder / "two-gaps.png")
