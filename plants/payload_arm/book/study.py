"""The study of the arm with a payload: PD beside the adaptive critic, what each part of it does.

Errors are rms in rad of joint 1 and 2; nothing is drawn but the fixed first layers, so that a
figure is one run. In brackets what an independent implementation gave, where it did.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from pcpc.plants.book.tables import (
    Column,
    RunsTable,
    at,
    by_label,
    case_maker,
    expected_figures,
    label_of,
    page,
)
from pcpc.plants.payload_arm.book.study_figures import draw_beside, draw_long, draw_parts
from pcpc.plants.study import Case, CaseResult, of_group

CHAPTER = 7
TITLE = "Chapter 7: adaptive critic on the two-link arm"
_case, known = case_maker(__file__, "payload-"), expected_figures(__file__)
COLUMNS = {  # metric: head
    "early_error_rms": "3-5 s", "payload_error_rms": "5-7 s", "error_rms": "8-10 s",
    "error_max": "largest 8-10 s", "after_error_max": "largest 5-8 s",
}  # fmt: skip
TRACES = (
    "executive:reference_1.q_d_rad", "executive:reference_2.q_d_rad",
    "plant:arm.q_1_rad", "plant:arm.q_2_rad", "plant:arm.acting_1_Nm", "plant:arm.acting_2_Nm",
    "plant:arm.outer_mass_kg", "error_1_rad", "error_2_rad",
)  # fmt: skip
NETWORK_TRACES = (
    *TRACES, "critic", "executive:controller.norm_w1", "executive:controller.norm_w2",
    "executive:controller.norm_rho",
)  # fmt: skip
CASE_4 = "4 PD + critic, payload"
MAIN = {  # label: rig, controller
    "1 PD": ("none", "pd"),
    "2 PD + critic": ("none", "critic"),
    "3 PD, payload": ("on", "pd"),
    CASE_4: ("on", "critic"),
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
    "norm of R": "critic_max",
    "norm of W1": "w1_max",
    "norm of W2": "w2_max",
    "norm of rho": "rho_max",
    "torque N m": "torque_peak_Nm",
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


def errors(group: str, title: str = "") -> RunsTable:
    """Return the table of the errors of a group."""
    columns = [Column(head, f"{name}_{{}}_rad", between=" ") for name, head in COLUMNS.items()]
    return RunsTable(group, columns, title)


def delays(results: Sequence[CaseResult]) -> str:
    """Return the table of the torque's age, which is 0 in case 4."""
    four = by_label(results, "main")[CASE_4]
    now = replace(four, case=replace(four.case, group="delays", label="0"))
    return errors("delays", "Case 4, age of the torque in samples").markdown([now, *results], known)


TABLES = (
    "Errors of joint 1 and 2, rad: rms, then the largest; in brackets as expected.\n",
    errors("main"),
    errors("parts", "Parts of the law"),
    RunsTable(
        ("norms", "main"),
        at(label_of, CASE_4, Column("here", "", text="{:.3g}"), Column("expected", 0)),
        "Largest values of case 4",
        metrics=NORMS,
    ),
    delays,
    errors("quanta", "Case 4, quanta of angles, rates and torques"),
    errors("seeds", "Case 4, seed of V1 and V2; expected of 0 to 3 at 8-10 s: "
           "0.0034-0.0067 0.0042-0.0069"),
    RunsTable("long", (Column("here", "error_rms_{}_rad", between=" "), Column("expected", 0)),
          "60 s, rms of 50-60 s"),
)  # fmt: skip


def report(results: Sequence[CaseResult]) -> str:
    """Return the tables."""
    return page(results, TABLES, known)


def draw(results: Sequence[CaseResult], folder: Path) -> None:
    """Draw PD beside the critic under the payload, the parts of the law, and the weights."""
    main, parts, long = (by_label(results, group) for group in ("main", "parts", "long"))
    beside = ("3 PD, payload", "PD + robust term, payload", CASE_4)
    draw_beside([main[label] for label in beside], folder / "payload-beside.png")
    shown = {
        "PD": main["3 PD, payload"],
        "PD, robust term": main["PD + robust term, payload"],
        "PD, robust term, critic": parts["4 critic alone, no action network"],
        "PD, action network, critic": parts["4 without robust term, kz 0"],
        "PD, robust term, action network": parts["4 critic asleep, beta 0"],
        "PD, robust term, integrator": parts["4 integrator, no critic"],
        "all: PD, robust term, action network, critic": main[CASE_4],
        "all, beta 15": parts["4 beta 15"],
        "all, beta 30": parts["4 beta 30"],
    }
    draw_parts(shown, of_group(results, "seeds"), folder / "payload-parts.png")
    draw_long(long["case 4"], folder / "payload-long.png")
