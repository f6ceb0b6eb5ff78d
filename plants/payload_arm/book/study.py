"""The study of the arm with a payload: PD beside the adaptive critic, what each part of it does.

Errors are rms in rad of joint 1 and 2; nothing is drawn but the fixed first layers, so that a
figure is one run. In brackets what an independent implementation gave, where it did.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from pcpc.plants.book.tables import bracketed_cells, case_maker, expected_figures, results_of_label
from pcpc.plants.payload_arm.book.study_figures import draw_beside, draw_long, draw_parts
from pcpc.plants.study import Case, Result, markdown, of_group

CHAPTER = 7
TITLE = "Chapter 7: adaptive critic on the two-link arm"
_case, known = case_maker(__file__, "payload-"), expected_figures(__file__)
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
MAIN = {  # label: rig, controller
    "1 PD": ("none", "pd"),
    "2 PD + critic": ("none", "critic"),
    "3 PD, payload": ("on", "pd"),
    "4 PD + critic, payload": ("on", "critic"),
    "PD + robust term": ("none", "robust_only"),
    "PD + robust term, payload": ("on", "robust_only"),
}
PARTS = {  # label: rig, settings of the controller
    "4 without robust term, kz 0": ("on", "kz=0.0"),
    "4 critic asleep, beta 0": ("on", "beta=0.0"),
    "4 beta 10": ("on", "beta=10.0"),
    "4 beta 15": ("on", "beta=15.0"),
    "4 beta 30": ("on", "beta=30.0"),
    "4 integrator for the action network, V2 0": ("on", "v2_size=0.0"),
    "4 integrator, no critic": ("on", "v2_size=0.0", "beta=0.0"),
    "4 critic alone, no action network": ("on", "action_on=0.0"),
    "2 kz 0, kap2 1": ("none", "kz=0.0", "kap2=1.0"),
    "2 kz 0": ("none", "kz=0.0"),
}
QUANTA = {
    "1e-4 rad, 1e-3 rad/s, 0.1 N m": (1e-4, 1e-3, 0.1),
    "1e-3 rad, 1e-2 rad/s, 1 N m": (1e-3, 1e-2, 1.0),
}
DELAYS, SEEDS, LONG_S = range(1, 6), range(10), 60.0
LONG = {  # label: rig, settings
    "case 2": ("none",),
    "case 4": ("on",),
    "case 4, integrator, no critic": ("on", "controller.v2_size=0.0", "controller.beta=0.0"),
}
NORMS = {
    "critic_max": "norm of R",
    "w1_max": "norm of W1",
    "w2_max": "norm of W2",
    "rho_max": "norm of rho",
    "torque_peak_Nm": "torque N m",
}


def cases() -> Iterator[Case]:
    """Yield all runs of the study."""
    for label, (rig, controller) in MAIN.items():
        traces = TRACES if controller == "pd" else NETWORK_TRACES
        yield _case("main", rig, controller, label, traces=traces)
    for label, (rig, *settings) in PARTS.items():
        yield _case("parts", rig, "critic", label, *(f"controller.{one}" for one in settings))
    for samples in DELAYS:
        yield _case("delays", "on", "critic", str(samples), f"arm.delay_samples={samples}.0")
    for label, quanta in QUANTA.items():
        names = ("position_lsb_rad", "rate_lsb_rad_s", "torque_lsb_Nm")
        settings = [f"arm.{name}={lsb}" for name, lsb in zip(names, quanta, strict=True)]
        yield _case("quanta", "on", "critic", label, *settings)
    for seed in SEEDS:
        yield _case("seeds", "on", "critic", str(seed), f"controller.network_seed={seed}.0")
    for label, (rig, *settings) in LONG.items():
        long, window_s = f"duration_s={LONG_S}", (LONG_S - 10.0, LONG_S)
        yield _case(
            "long", rig, "critic", label, long, *settings, traces=NETWORK_TRACES, window_s=window_s
        )


def pair(result: Result, metric: str) -> str:
    """Return the metric of both joints."""
    return " ".join(f"{result.metric(f'{metric}_{joint}_rad'):.4f}" for joint in (1, 2))


def table(title: str, results: Sequence[Result], first: Sequence[list[str]] = ()) -> str:
    """Return label and errors of each, in brackets beside each what was expected."""
    rows = []
    for result in results:
        other = known(result.case.group, result.case.label)
        cells = [pair(result, name) for name in COLUMNS]
        rows.append([result.case.label, *bracketed_cells(cells, other)])
    return f"{title}\n\n" + markdown(("", *HEADS), [*first, *rows])


def report(results: Sequence[Result]) -> str:
    """Return the tables."""
    (four,) = results_of_label(results, "main", "4 PD + critic, payload")
    norms = [
        [name, f"{four.metric(key):.3g}", *known("norms", name)] for key, name in NORMS.items()
    ]
    long = [
        [r.case.label, pair(r, "error_rms"), *(known("long", r.case.label) or ("",))]
        for r in of_group(results, "long")
    ]
    return "\n".join((
        "Errors of joint 1 and 2, rad: rms, then the largest; in brackets as expected.\n",
        table("", of_group(results, "main")).lstrip(),
        table("Parts of the law", of_group(results, "parts")),
        "Largest values of case 4\n\n" + markdown(("", "here", "expected"), norms),
        table("Case 4, age of the torque in samples", of_group(results, "delays"),
              [["0", *(pair(four, name) for name in COLUMNS)]]),
        table("Case 4, quanta of angles, rates and torques", of_group(results, "quanta")),
        table("Case 4, seed of V1 and V2; expected of 0 to 3 at 8-10 s: "
              "0.0034-0.0067 0.0042-0.0069", of_group(results, "seeds")),
        "60 s, rms of 50-60 s\n\n" + markdown(("", "here", "expected"), long),
    ))  # fmt: skip


def draw(results: Sequence[Result], folder: Path) -> None:
    """Draw PD beside the critic under the payload, the parts of the law, and the weights."""
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
