"""The study of the two-link arm with friction: five cases, six controllers, ten networks.

Figures are medians over the seeds of the network's first layer; in brackets, beside each, what an
independent implementation of the same equations gave.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from pcpc.plants.book.tables import (
    Column,
    Part,
    RunsTable,
    Sentence,
    Text,
    across,
    at,
    case_maker,
    controller_of,
    expected_figures,
    label_of,
    page,
)
from pcpc.plants.friction_arm.book.study_figures import draw_all
from pcpc.plants.study import Case, CaseResult

CHAPTER = 3
TITLE = "Chapter 3: the two-link arm with friction"
_case, known = case_maker(__file__, "friction-"), expected_figures(__file__)
NETWORKS = ("nn_standard", "nn_step", "nn_ramp", "nn_project", "nn_const")
SEEDS, FEW_SEEDS = range(1, 11), range(1, 6)
DRAWN = ("pd", "nn_standard", "nn_step", "nn_ramp", "nn_const")
RATES_HZ = (5000, 2000, 1000, 500, 250, 100, 50, 20, 10, 8)
QUANTA = {
    "none but the bus": (),
    "torque 0.1 N m": ("arm.torque_lsb_Nm=0.1",),
    "torque 1 N m": ("arm.torque_lsb_Nm=1.0",),
    "q 1e-4 and q' 1e-3": ("arm.position_lsb_rad=1e-4", "arm.rate_lsb_rad_s=1e-3"),
    "q 1e-3 and q' 1e-2": ("arm.position_lsb_rad=1e-3", "arm.rate_lsb_rad_s=1e-2"),
}
DELAYS = (0, 1, 2, 5)
GAINS = {
    "T 35 E 10": ("controller.t_rate=35.0", "controller.e_rate=10.0"),
    "T 10 E 10": ("controller.e_rate=10.0",),
    "T 10 E 100": ("controller.e_rate=100.0",),
}
GAINS_OF = {"nn_standard": ("T 35 E 10",), "nn_step": tuple(GAINS)}  # E is of the jump nodes only
NODES = (8, 12, 16)
STEPS_S = ("1e-3", "1e-4", "1e-5")
TRACES = (
    "executive:reference_1.q_d_rad", "executive:reference_2.q_d_rad",
    "plant:arm.q_1_rad", "plant:arm.q_2_rad", "plant:arm.acting_1_Nm", "plant:arm.acting_2_Nm",
    "error_1_rad", "error_2_rad", "plant:arm.rate_1_rad_s", "plant:arm.rate_2_rad_s",
    "executive:reference_1.q_d_rate_rad_s", "executive:reference_2.q_d_rate_rad_s",
    "executive:controller.norm_z", "executive:controller.tuning_gain_Nms_rad",
    "executive:controller.step_weight_1_Nm", "executive:controller.step_weight_2_Nm",
)  # fmt: skip


def _seed_cases(
    group: str, rig: str, controller: str, label: str, seeds: Sequence[int], *settings: str
) -> Iterator[Case]:
    for seed in seeds:
        drawn = f"controller.network_seed={seed}"
        yield _case(group, rig, controller, label, drawn, *settings)


def cases() -> Iterator[Case]:
    """Yield all runs of the study."""
    for rig in "abcde":
        yield _case(rig, rig, "pd", "pd")
        for controller in NETWORKS:
            yield from _seed_cases(rig, rig, controller, controller, SEEDS)
    for controller in ("nn_standard", "nn_step"):
        yield from _seed_cases("kz", "a", controller, controller, SEEDS, "controller.kz=0.0")
    kv = ("controller.kv_1_Nms_rad=23.0", "controller.kv_2_Nms_rad=23.0")
    yield _case("stiff pd", "a", "pd", "Kv 23", *kv)
    yield from _gains_and_nodes()
    yield from _sampling_cases()
    for rig in "abcd":
        for controller in DRAWN:
            yield _case("drawn", rig, controller, controller, traces=TRACES)
    for controller in ("nn_step", "nn_ramp", "nn_project", "nn_const"):
        yield _case(
            "zoom",
            "a",
            controller,
            controller,
            "duration_s=2.9",
            traces=TRACES,
            window_s=(0.0, 2.9),
        )


def _gains_and_nodes() -> Iterator[Case]:
    for controller, labels in GAINS_OF.items():
        for label in labels:
            yield from _seed_cases("gains", "a", controller, label, SEEDS, *GAINS[label])
        for nodes in NODES:
            setting = f"controller.nodes={nodes}.0"
            yield from _seed_cases("nodes", "a", controller, str(nodes), SEEDS, setting)


def _sampling_cases() -> Iterator[Case]:
    for controller in ("nn_standard", "nn_step", "nn_ramp"):
        for rate in RATES_HZ:
            setting = f"rate_hz={rate}.0"
            yield from _seed_cases("rates", "a", controller, str(rate), FEW_SEEDS, setting)
    for controller in ("nn_standard", "nn_step", "nn_ramp", "nn_project"):
        for label, settings in QUANTA.items():
            yield from _seed_cases("quanta", "a", controller, label, FEW_SEEDS, *settings)
    for delay in DELAYS:
        setting = f"arm.delay_samples={delay}.0"
        yield from _seed_cases("delays", "a", "nn_step", str(delay), FEW_SEEDS, setting)
    for step in STEPS_S:
        yield from _seed_cases("steps", "a", "nn_standard", step, range(1, 4), f"arm.step_s={step}")


EARLY, LATE = "early_error_abs_mean_{}_rad", "error_abs_mean_{}_rad"
OVERSHOOT_1 = "overshoot_1_rad"


def number(value: float) -> str:
    """Return four decimals below 10, else no decimal."""
    if not np.isfinite(value):
        return "-" if np.isnan(value) else "inf"
    return f"{value:.4f}" if abs(value) < 10.0 else f"{value:.0f}"


def median(head: str, metric: str, text: Text = number) -> Column:
    """Return a column of medians over the seeds."""
    return Column(head, metric, np.median, text)


def variation(head: str = "variation") -> Column:
    """Return the column of the torque's variation."""
    return median(head, "torque_variation_Nm_s", "{:.0f}")


def peak(head: str = "peak") -> Column:
    """Return the column of the largest torque of all seeds."""
    return Column(head, "torque_peak_Nm", np.max, "{:.0f}")


def drawn(result: CaseResult) -> bool:
    """Return whether a result is of a network, whose first layer is drawn."""
    return controller_of(result) in NETWORKS


ERRORS = (median("4 to 5 s", EARLY), median("9 to 10 s", LATE))
HELD = (
    *ERRORS,
    *at(
        drawn, True,
        Column("worst seed, 9 to 10 s", LATE, np.max, number, absent="-"),
        Column("overshoot", "overshoot_{}_rad", np.median, number, absent="-"),
    ),
    peak(), variation(),
)  # fmt: skip
BY_LAW = {"": controller_of}
OF_STEP = ("nn_step",)
TABLES: tuple[Part, ...] = (
    "Joint 1 / joint 2; rad, N m, N m/s. Medians over the seeds 1 to 10 of the first layer; in "
    "brackets the figures of an independent implementation of the same equations. Errors are "
    "means of |e|; overshoot is beyond the target; variation is the sum of |tau_k - tau_k-1| "
    "of both joints per second; the peak torque is that of all seeds.\n",
    RunsTable("a", HELD, "Case A: unit step under gravity", BY_LAW),
    RunsTable("b", HELD, "Case B: unit step without gravity", BY_LAW),
    RunsTable("d", HELD, "Case D: LuGre friction, unit step under gravity", BY_LAW),
    RunsTable("e", HELD, "Case E: stiction a1 = 10 N m, unit step under gravity", BY_LAW),
    RunsTable("kz", HELD, "Case A without the robust term, Kz = 0", BY_LAW),
    RunsTable(
        "c",
        (
            median("rms, 10 to 20 s", "error_rms_{}_rad"),
            median("largest, 10 to 20 s", "error_max_{}_rad"),
            variation(),
        ),
        "Case C: tracking sin t, cos t",
        BY_LAW,
    ),
    Sentence(
        "stiff pd",
        ERRORS[1:],
        "PD with the damping that the robust term adds, Kv = 23, case A: {}\n",
    ),
    *(
        RunsTable(
            group,
            (*ERRORS, peak("peak torque")),
            title,
            {"": label_of, "law": controller_of},
        )
        for group, title in (
            ("gains", "Tuning gains instead of T 10 E 35, with S = 10, case A"),
            ("nodes", "Hidden nodes instead of 10, case A"),
        )
    ),
    RunsTable(
        "rates",
        (
            *across(controller_of, ("nn_standard", "nn_step"), median("{}, 9 to 10 s", LATE)),
            *across(controller_of, ("nn_step", "nn_ramp"), variation("{} variation")),
            *across(controller_of, OF_STEP, median("{} overshoot 1", OVERSHOOT_1)),
            *across(
                controller_of, OF_STEP,
                median("{} median T G", "tuning_gain_median_Nms_rad", "{:.3g}"),
            ),
        ),
        "Sampling rate, case A, medians over 5 seeds; Kv is 20",
        {"Hz": label_of},
    ),
    RunsTable(
        "quanta",
        (ERRORS[1], Column("worst of 5 seeds", LATE, np.max, number), variation()),
        "Quantisation, case A",
        {"quantum": label_of, "law": controller_of},
    ),
    RunsTable(
        "delays",
        (ERRORS[1], median("overshoot 1", OVERSHOOT_1)),
        "Delay of the torque in samples, case A, nn_step, medians over 5 seeds",
        {"samples": label_of},
    ),
    RunsTable(
        "steps",
        ERRORS,
        "Integration step, case A, nn_standard, medians over 3 seeds",
        {"step [s]": label_of},
    ),
)  # fmt: skip


def report(results: Sequence[CaseResult]) -> str:
    """Return the tables."""
    return page(results, TABLES, known)


def draw(results: Sequence[CaseResult], folder: Path) -> None:
    """Draw cases A to D, phase planes, the chatter of the step node and the step weights."""
    draw_all(results, folder)
