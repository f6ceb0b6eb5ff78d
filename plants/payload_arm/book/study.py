"""The study of the arm with a payload: PD beside the adaptive critic, what each part of it does.

Errors are rms in rad of joint 1 and 2; nothing is drawn but the fixed first layers, so that a
figure is one run. In brackets what an independent implementation gave, where it did.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from pcpc.plants.study import Case, Result, markdown, of_group

CHAPTER = 7
TITLE = "Chapter 7: adaptive critic on the two-link arm"
RIGS = Path(__file__).resolve().parents[1] / "rigs"
COLUMNS = ("early_error_rms", "payload_error_rms", "error_rms", "error_max", "after_error_max")
HEADS = ("3-5 s", "5-7 s", "8-10 s", "largest 8-10 s", "largest 5-8 s")
TRACES = (
    "executive:reference_1.q_d_rad", "executive:reference_2.q_d_rad",
    "plant:arm.q_1_rad", "plant:arm.q_2_rad", "plant:arm.acting_1_Nm", "plant:arm.acting_2_Nm",
    "plant:arm.outer_mass_kg", "error_1_rad", "error_2_rad",
)  # fmt: skip
NETWORK_TRACES = (
    *TRACES, "critic", "executive:controller.norm_w1", "executive:controller.norm_w2",
    "executive:controller.norm_rho",
)  # fmt: skip
MAIN: dict[str, tuple[str, ...]] = {  # label: rig, controller, expected
    "1 PD": ("none", "pd",
             "0.0516 0.0544", "0.0468 0.0528", "0.0544 0.0598", "0.0637 0.1142", "0.0726 0.1412"),
    "2 PD + critic": ("none", "critic", "0.0046 0.0061", "0.0075 0.0122", "0.0051 0.0054",
                      "0.0077 0.0084", "0.0113 0.0195"),
    "3 PD, payload": ("on", "pd",
                      "0.0516 0.0544", "0.0626 0.1101", "0.0545 0.0599", "0.0637 0.1147",
                      "0.1120 0.1658"),
    "4 PD + critic, payload": ("on", "critic", "0.0046 0.0061", "0.0129 0.0288", "0.0051 0.0055",
                               "0.0077 0.0084", "0.0192 0.0519"),
    "PD + robust term": ("none", "robust_only",
                         "0.0340 0.0363", "0.0316 0.0385", "0.0346 0.0389", "0.0454 0.0846"),
    "PD + robust term, payload": ("on", "robust_only"),
}  # fmt: skip
PARTS: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {  # rig, settings, expected
    "4 without robust term, kz 0": (
        "on", ("kz=0.0",), ("0.0053 0.0079", "0.0146 0.0324", "0.0063 0.0075", "0.0089 0.0107"),
    ),
    "4 critic asleep, beta 0": (
        "on", ("beta=0.0",), ("0.0045 0.0062", "0.0126 0.0288", "0.0050 0.0055", "0.0075 0.0086"),
    ),
    "4 beta 10": ("on", ("beta=10.0",), ()),
    "4 beta 15": ("on", ("beta=15.0",), ("", "0.0176", "0.0070")),
    "4 beta 30": (
        "on", ("beta=30.0",), ("0.3854 0.1192", "0.3722 0.1120", "0.0603 0.0162"),
    ),
    "4 integrator for the action network, V2 0": ("on", ("v2_size=0.0",), ()),
    "4 integrator, no critic": ("on", ("v2_size=0.0", "beta=0.0"), ()),
    "4 critic alone, no action network": ("on", ("action_on=0.0",), ()),
    "2 kz 0, kap2 1": ("none", ("kz=0.0", "kap2=1.0"), ("", "", "0.051 0.054")),
    "2 kz 0": ("none", ("kz=0.0",), ()),
}  # fmt: skip
QUANTA = {
    "1e-4 rad, 1e-3 rad/s, 0.1 N m": (1e-4, 1e-3, 0.1),
    "1e-3 rad, 1e-2 rad/s, 1 N m": (1e-3, 1e-2, 1.0),
}
DELAYS, SEEDS, LONG_S = range(1, 6), range(10), 60.0
LONG: dict[str, tuple[str, tuple[str, ...], str]] = {  # rig, settings, expected
    "case 2": ("none", (), "0.0064 0.0103"),
    "case 4": ("on", (), "0.0064 0.0103"),
    "case 4, integrator, no critic": ("on", ("controller.v2_size=0.0", "controller.beta=0.0"), ""),
}
NORMS = {
    "critic_max": ("norm of R", "0.49"),
    "w1_max": ("norm of W1", "0.26"),
    "w2_max": ("norm of W2", "18.8"),
    "rho_max": ("norm of rho", "0.69"),
    "torque_peak_Nm": ("torque N m", "465"),
}


def rig_of(payload: str) -> str:
    """Return the rig file without (`none`) or with (`on`) payload."""
    return str(RIGS / f"payload-{payload}.yaml")


def cases() -> Iterator[Case]:
    """Yield all runs of the study."""
    for label, (rig, controller, *_) in MAIN.items():
        traces = TRACES if controller == "pd" else NETWORK_TRACES
        yield Case("main", rig_of(rig), controller, label, traces=traces)
    for label, (rig, settings, _) in PARTS.items():
        own = tuple(f"controller.{setting}" for setting in settings)
        yield Case("parts", rig_of(rig), "critic", label, own)
    for samples in DELAYS:
        setting = f"arm.delay_samples={samples}.0"
        yield Case("delays", rig_of("on"), "critic", f"{samples}", (setting,))
    for label, quanta in QUANTA.items():
        names = ("position_lsb_rad", "rate_lsb_rad_s", "torque_lsb_Nm")
        settings = tuple(f"arm.{name}={lsb}" for name, lsb in zip(names, quanta, strict=True))
        yield Case("quanta", rig_of("on"), "critic", label, settings)
    for seed in SEEDS:
        setting = f"controller.network_seed={seed}.0"
        yield Case("seeds", rig_of("on"), "critic", f"{seed}", (setting,))
    for label, (rig, settings, _) in LONG.items():
        long = (f"duration_s={LONG_S}", *settings)
        window = (LONG_S - 10.0, LONG_S)
        yield Case("long", rig_of(rig), "critic", label, long, window, NETWORK_TRACES)


def pair(result: Result, metric: str) -> str:
    """Return the metric of both joints."""
    return " ".join(f"{result.metric(f'{metric}_{joint}_rad'):.4f}" for joint in (1, 2))


def row(result: Result, expected: Sequence[str]) -> list[str]:
    """Return label and errors, in brackets beside each what was expected."""
    beside = [*expected, *[""] * (len(COLUMNS) - len(expected))]
    cells = [pair(result, name) for name in COLUMNS]
    told = [f"{cell} ({e})" if e else cell for cell, e in zip(cells, beside, strict=True)]
    return [result.case.label, *told]


def report(results: Sequence[Result]) -> str:
    """Return the tables."""
    main, parts = of_group(results, "main"), of_group(results, "parts")
    text = ["Errors of joint 1 and 2, rad: rms, then the largest; in brackets as expected.\n"]
    text.append(markdown(("", *HEADS), [row(r, MAIN[r.case.label][2:]) for r in main]))
    rows = [row(r, PARTS[r.case.label][2]) for r in parts]
    text.append("Parts of the law\n\n" + markdown(("", *HEADS), rows))
    four = next(result for result in main if result.case.label.startswith("4"))
    norms = [[name, f"{four.metric(key):.3g}", other] for key, (name, other) in NORMS.items()]
    text.append("Largest values of case 4\n\n" + markdown(("", "here", "expected"), norms))
    rows = [row(four, ()), *(row(r, ()) for r in of_group(results, "delays"))]
    rows[0][0] = "0"
    text.append("Case 4, age of the torque in samples\n\n" + markdown(("", *HEADS), rows))
    rows = [row(r, ()) for r in of_group(results, "quanta")]
    text.append("Case 4, quanta of angles, rates and torques\n\n" + markdown(("", *HEADS), rows))
    rows = [row(r, ()) for r in of_group(results, "seeds")]
    text.append(
        "Case 4, seed of V1 and V2; expected of 0 to 3 at 8-10 s: "
        "0.0034-0.0067 0.0042-0.0069\n\n" + markdown(("", *HEADS), rows)
    )
    long = {result.case.label: result for result in of_group(results, "long")}
    rows = [[label, pair(r, "error_rms"), LONG[label][2]] for label, r in long.items()]
    text.append("60 s, rms of 50-60 s\n\n" + markdown(("", "here", "expected"), rows))
    return "\n".join(text)


def draw(results: Sequence[Result], folder: Path) -> None:
    """Draw PD beside the critic under the payload, the parts of the law, and the weights."""
    from pcpc.plants.payload_arm.book.study_figures import draw_beside, draw_long, draw_parts

    main = {result.case.label: result for result in of_group(results, "main")}
    beside = ("3 PD, payload", "PD + robust term, payload", "4 PD + critic, payload")
    draw_beside([main[label] for label in beside], folder / "payload-beside.png")
    parts = {result.case.label: result for result in of_group(results, "parts")}
    long = {result.case.label: result for result in of_group(results, "long")}
    shown = {
        "PD": main["3 PD, payload"],
        "PD, robust term": main["PD + robust term, payload"],
        "PD, robust term, critic": parts["4 critic alone, no action network"],
        "PD, action network, critic": parts["4 without robust term, kz 0"],
        "PD, robust term, action network": parts["4 critic asleep, beta 0"],
        "PD, robust term, integrator": parts["4 integrator, no critic"],
        "all: PD, robust term, action network, critic": main["4 PD + critic, payload"],
        "all, beta 15": parts["4 beta 15"],
        "all, beta 30": parts["4 beta 30"],
    }
    draw_parts(shown, of_group(results, "seeds"), folder / "payload-parts.png")
    draw_long(long["case 4"], folder / "payload-long.png")
