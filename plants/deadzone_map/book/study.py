"""The study of the map: PD, fuzzy precompensator, adaptive inverse; other plants, delay, rates.

Errors of x2 over 10-30 s, k = 100..299; widths at the end. Every figure is exactly reproducible
where the run does not diverge.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from pcpc.plants.book.tables import (
    Column,
    Part,
    RunsTable,
    across,
    by_case,
    case_maker,
    controller_of,
    expected_figures,
    joined,
    label_of,
    page,
    rig_name,
)
from pcpc.plants.deadzone_map.book.study_figures import draw_beside
from pcpc.plants.study import Case, CaseResult

CHAPTER = 4
TITLE = "Chapter 4.3: deadzone compensation with fuzzy logic, in discrete time"
_case, known = case_maker(__file__), expected_figures(__file__)
RIG_NAMES = ("fuzzy-d00", "fuzzy-d01", "fuzzy-d03")
CONTROLLERS = ("pd", "fuzzy", "fuzzy_detuned", "inverse", "inverse_known")
MODELS = {"cf 0.15": (), "cf exact": ("controller.model_c=0.1875",)}
DELAYED = ("map.delay_samples=1.0",)
RATES = (
    ("alpha", "fuzzy", (0.01, 0.03, 0.1, 0.4)),
    ("gam", "inverse", (0.1, 0.25, 0.5, 1.0, 1.5)),
)
TRACES = (
    "executive:reference.now", "plant:map.x2", "executive:controller.command", "plant:map.tau",
    "executive:controller.d_plus", "executive:controller.d_minus",
)  # fmt: skip


def cases() -> Iterator[Case]:
    """Yield all runs of the study."""
    for rig in RIG_NAMES:
        for law in CONTROLLERS:
            for model, settings in MODELS.items():
                yield _case("main", rig, law, model, *settings, traces=TRACES)
                yield _case("delayed", rig, law, model, *settings, *DELAYED)
    for rig in RIG_NAMES[1:]:
        for name, law, values in RATES:
            for value in values:
                yield _case(name, rig, law, str(value), f"controller.{name}={value}")


def result_text(result: CaseResult) -> str:
    """Return rms, largest error; widths."""
    if result.metric("diverged") > 0.5:
        return "diverges"
    text = f"{result.metric('error_rms'):.4f}, {result.metric('error_max'):.4f}"
    if "d_plus" in result.metrics:
        text += f"; {result.metric('d_plus'):.3f} {result.metric('d_minus'):.3f}"
    return text


LAW_ON_RIG = {"": joined(controller_of, rig_name)}
BY_MODEL = across(label_of, [*MODELS], Column("{}", result_text))
WIDTHS = {rig: f"d = 0.{rig[-1]}" for rig in RIG_NAMES[1:]}
TABLES: tuple[Part, ...] = (
    "Error rms, largest; widths learned d+ d-, (expected).\n",
    RunsTable("main", BY_MODEL, rows=LAW_ON_RIG),
    "\nThe same with one sample more of delay:\n",
    RunsTable("delayed", BY_MODEL, rows=LAW_ON_RIG),
    "\nLearning rates of `fuzzy`, then of `inverse`, cf 0.15:\n",
    *(
        RunsTable(name, across(rig_name, WIDTHS, Column("{}", result_text)), rows={name: label_of})
        for name, _, _ in RATES
    ),
)


def report(results: Sequence[CaseResult]) -> str:
    """Return the tables."""
    return page(results, TABLES, known)


def draw(results: Sequence[CaseResult], folder: Path) -> None:
    """Draw PD beside the fuzzy precompensator behind both deadzones."""
    found = by_case(results, "main")
    for rig in RIG_NAMES[1:]:
        pair = [found[rig, law, "cf 0.15"] for law in ("pd", "fuzzy")]
        draw_beside(pair, folder / f"{rig}.png")
