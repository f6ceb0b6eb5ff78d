"""The study of the map: PD, fuzzy precompensator, adaptive inverse; other plants, delay, rates.

Errors of x2 over 10-30 s, k = 100..299; widths at the end. Every figure is exactly reproducible
where the run does not diverge.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from pcpc.plants.study import Case, Result, markdown, of_group

CHAPTER = 4
TITLE = "Chapter 4.3: deadzone compensation with fuzzy logic, in discrete time"
RIGS = Path(__file__).resolve().parents[1] / "rigs"
RIG_NAMES = ("fuzzy-d00", "fuzzy-d01", "fuzzy-d03")
CONTROLLERS = ("pd", "fuzzy", "fuzzy_detuned", "inverse", "inverse_known")
MODELS = {"cf 0.15": (), "cf exact": ("controller.model_c=0.1875",)}
DELAYED = ("map.delay_samples=1.0",)
ALPHAS = (0.01, 0.03, 0.1, 0.4)
GAMS = (0.1, 0.25, 0.5, 1.0, 1.5)
TRACES = (
    "executive:reference.now", "plant:map.x2", "executive:controller.command", "plant:map.tau",
    "executive:controller.d_plus", "executive:controller.d_minus",
)  # fmt: skip
# What an independent implementation gave: rms, largest error; d+, d-
EXPECTED = {
    ("fuzzy-d00", "pd", "cf 0.15"): "0.0184, 0.0226", ("fuzzy-d00", "pd", "cf exact"): "0, 0",
    ("fuzzy-d01", "pd", "cf 0.15"): "0.1305, 0.1413",
    ("fuzzy-d01", "pd", "cf exact"): "0.1147, 0.1190",
    ("fuzzy-d01", "fuzzy", "cf 0.15"): "0.0061, 0.0203; 0.113 0.111",
    ("fuzzy-d01", "fuzzy", "cf exact"): "0.0022, 0.0068; 0.097 0.099",
    ("fuzzy-d03", "pd", "cf 0.15"): "0.3384, 0.3772",
    ("fuzzy-d03", "pd", "cf exact"): "0.3266, 0.3571",
    ("fuzzy-d03", "fuzzy", "cf 0.15"): "0.0073, 0.0137; 0.307 0.309",
    ("fuzzy-d03", "fuzzy", "cf exact"): "0.0067, 0.0208; 0.292 0.297",
}  # fmt: skip
EXPECTED_DELAYED = {
    ("fuzzy-d01", "fuzzy", "cf 0.15"): "diverges", ("fuzzy-d01", "fuzzy", "cf exact"): "diverges",
    ("fuzzy-d03", "fuzzy", "cf 0.15"): "diverges", ("fuzzy-d03", "fuzzy", "cf exact"): "0.017",
    ("fuzzy-d01", "fuzzy_detuned", "cf 0.15"): "0.0117",
    ("fuzzy-d03", "fuzzy_detuned", "cf 0.15"): "0.0279",
    ("fuzzy-d01", "fuzzy_detuned", "cf exact"): "0.0123",
    ("fuzzy-d03", "fuzzy_detuned", "cf exact"): "0.0288",
}  # fmt: skip
Key = tuple[str, str, str]


def cases() -> Iterator[Case]:
    """Yield all runs of the study."""
    for rig in RIG_NAMES:
        file = str(RIGS / f"{rig}.yaml")
        for controller in CONTROLLERS:
            for label, settings in MODELS.items():
                yield Case("main", file, controller, label, settings, traces=TRACES)
                yield Case("delayed", file, controller, label, (*settings, *DELAYED))
    for rig in RIG_NAMES[1:]:
        for alpha in ALPHAS:
            settings = (f"controller.alpha={alpha}",)
            yield Case("alpha", str(RIGS / f"{rig}.yaml"), "fuzzy", f"{alpha}", settings)
        for gam in GAMS:
            settings = (f"controller.gam={gam}",)
            yield Case("gam", str(RIGS / f"{rig}.yaml"), "inverse", f"{gam}", settings)


def keyed(results: Sequence[Result], group: str) -> dict[Key, Result]:
    """Return the results of a group by (rig, controller, label)."""
    return {
        (Path(r.case.rig).stem, r.case.controller, r.case.label): r
        for r in of_group(results, group)
    }


def shown(result: Result) -> str:
    """Return rms, largest error; widths."""
    if result.metric("diverged") > 0.5:
        return "diverges"
    text = f"{result.metric('error_rms'):.4f}, {result.metric('error_max'):.4f}"
    if "d_plus" in result.metrics:
        text += f"; {result.metric('d_plus'):.3f} {result.metric('d_minus'):.3f}"
    return text


def report(results: Sequence[Result]) -> str:
    """Return the tables."""
    rates = [
        [f"{rate}", *(shown(keyed(results, group)[rig, law, f"{rate}"]) for rig in RIG_NAMES[1:])]
        for group, law, of in (("alpha", "fuzzy", ALPHAS), ("gam", "inverse", GAMS))
        for rate in of
    ]
    return "\n".join(
        (
            "Error rms, largest; widths learned d+ d-, (expected).\n",
            main_table(keyed(results, "main"), EXPECTED),
            "\nThe same with one sample more of delay:\n",
            main_table(keyed(results, "delayed"), EXPECTED_DELAYED),
            "\nLearning rates of `fuzzy`, then of `inverse`, cf 0.15:\n",
            markdown(("alpha", "d = 0.1", "d = 0.3"), rates[: len(ALPHAS)]),
            markdown(("gam", "d = 0.1", "d = 0.3"), rates[len(ALPHAS) :]),
        )
    )


def main_table(found: Mapping[Key, Result], expected: Mapping[Key, str]) -> str:
    """Return a row a rig and controller, a column a model."""
    rows = []
    for rig in RIG_NAMES:
        for controller in CONTROLLERS:
            row = [f"{controller}, {rig}"]
            for label in MODELS:
                key = (rig, controller, label)
                told = f" ({expected[key]})" if key in expected else ""
                row.append(shown(found[key]) + told)
            rows.append(row)
    return markdown(("", *MODELS), rows)


def draw(results: Sequence[Result], folder: Path) -> None:
    """Draw PD beside the fuzzy precompensator behind both deadzones."""
    from pcpc.plants.deadzone_map.book.study_figures import draw_beside

    found = keyed(results, "main")
    for rig in RIG_NAMES[1:]:
        pair = [found[rig, controller, "cf 0.15"] for controller in ("pd", "fuzzy")]
        draw_beside(pair, folder / f"{rig}.png")
