"""The study of the map: PD, fuzzy precompensator, adaptive inverse; other plants, delay, rates.

Errors of x2 over 10-30 s, k = 100..299; widths at the end. Every figure is exactly reproducible
where the run does not diverge.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from pcpc.plants.book.tables import bracketed_cells, by_case, case_maker, expected_figures
from pcpc.plants.deadzone_map.book.study_figures import draw_beside
from pcpc.plants.study import Case, Result, markdown

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
        for controller in CONTROLLERS:
            for label, settings in MODELS.items():
                yield _case("main", rig, controller, label, *settings, traces=TRACES)
                yield _case("delayed", rig, controller, label, *settings, *DELAYED)
    for rig in RIG_NAMES[1:]:
        for name, law, values in RATES:
            for value in values:
                yield _case(name, rig, law, str(value), f"controller.{name}={value}")


def result_text(result: Result) -> str:
    """Return rms, largest error; widths."""
    if result.metric("diverged") > 0.5:
        return "diverges"
    text = f"{result.metric('error_rms'):.4f}, {result.metric('error_max'):.4f}"
    if "d_plus" in result.metrics:
        text += f"; {result.metric('d_plus'):.3f} {result.metric('d_minus'):.3f}"
    return text


def report(results: Sequence[Result]) -> str:
    """Return the tables."""
    return "\n".join((
        "Error rms, largest; widths learned d+ d-, (expected).\n",
        _models(results, "main"),
        "\nThe same with one sample more of delay:\n",
        _models(results, "delayed"),
        "\nLearning rates of `fuzzy`, then of `inverse`, cf 0.15:\n",
        *(_rates(results, *one) for one in RATES),
    ))  # fmt: skip


def _models(results: Sequence[Result], group: str) -> str:
    """Return a row a rig and controller, a column a model."""
    found, rows = by_case(results, group), []
    for rig in RIG_NAMES:
        for controller in CONTROLLERS:
            cells = [result_text(found[rig, controller, label]) for label in MODELS]
            rows.append(
                [f"{controller}, {rig}", *bracketed_cells(cells, known(group, rig, controller))]
            )
    return markdown(("", *MODELS), rows)


def _rates(results: Sequence[Result], name: str, law: str, values: Sequence[float]) -> str:
    found = by_case(results, name)
    rows = [
        [str(value), *(result_text(found[rig, law, str(value)]) for rig in RIG_NAMES[1:])]
        for value in values
    ]
    return markdown((name, "d = 0.1", "d = 0.3"), rows)


def draw(results: Sequence[Result], folder: Path) -> None:
    """Draw PD beside the fuzzy precompensator behind both deadzones."""
    found = by_case(results, "main")
    for rig in RIG_NAMES[1:]:
        pair = [found[rig, controller, "cf 0.15"] for controller in ("pd", "fuzzy")]
        draw_beside(pair, folder / f"{rig}.png")
