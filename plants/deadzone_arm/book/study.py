"""The study of the arm: PD and the dual network, twenty draws of it, ablations, delays, rates.

Errors are rms in rad over 3-5 s and 8-10 s. A draw is a `network_seed`, 0 to 19; how a draw turns
out depends on the last bit of every weight (README), so that only statistics mean anything.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from pcpc.plants.book.tables import bracketed_cells, case_maker, expected_figures, rig_name
from pcpc.plants.deadzone_arm.book.study_figures import draw_beside, draw_seeds
from pcpc.plants.study import Case, Result, markdown, of_group

CHAPTER = 4
TITLE = "Chapter 4.2: deadzone compensation with two neural networks"
_case, known = case_maker(__file__, "deadzone-"), expected_figures(__file__)
SCENARIOS = ("step", "sine")
SEEDS = range(20)
FRESH = (range(20, 60), range(100, 140), range(1000, 1040))  # seen by no choice of a number
COLUMNS = ("early_error_rms_1_rad", "early_error_rms_2_rad", "error_rms_1_rad", "error_rms_2_rad")
TRACES = (
    "executive:reference_1.q_d_rad", "plant:arm.q_1_rad", "plant:arm.q_2_rad",
    "executive:controller.torque_1_Nm", "executive:controller.torque_2_Nm", "plant:arm.acting_1_Nm",
    "plant:arm.acting_2_Nm", "error_1_rad", "error_2_rad",
    "executive:controller.slope_1", "executive:controller.slope_2",
)  # fmt: skip
SINGLE: dict[str, tuple[str, ...]] = {  # of `nn`, seed 11
    "no delay": (),
    "1 sample": ("arm.delay_samples=1.0",),
    "2 samples": ("arm.delay_samples=2.0",),
    "coarse signals": (
        "arm.position_lsb_rad=1e-5",
        "arm.rate_lsb_rad_s=1e-3",
        "arm.torque_lsb_Nm=0.01",
    ),
}
DRAWN: dict[str, tuple[str, ...]] = {  # of `nn`, all seeds
    "rig": (),
    "rig + 1 sample": ("arm.delay_samples=1.0",),
    "rig + 2 samples": ("arm.delay_samples=2.0",),
    "rig at 2 kHz": ("rate_hz=2000.0",),
    "rig at 500 Hz": ("rate_hz=500.0",),
    "u_max 100 N m": ("controller.u_max_Nm=100.0",),
    "u_max 60 N m": ("controller.u_max_Nm=60.0",),
    "L = 40": ("controller.nodes=40.0",),
    "no jump nodes": ("controller.jumps_on=0.0",),
    "S = 0": ("controller.s_rate=0.0",),
    "S = 240": ("controller.s_rate=240.0",),
    "random signs S = 24": ("controller.positive_slope=0.0",),
    "random signs S = 0": ("controller.positive_slope=0.0", "controller.s_rate=0.0"),
    "as in the book": ("controller.positive_slope=0.0", "controller.s_rate=240.0"),
}
STEP_ONLY = ("u_max 100 N m", "u_max 60 N m")  # the sine asks for 82 N m


Runs = Mapping[tuple[str, str], list[Result]]


def cases() -> Iterator[Case]:
    """Yield all runs of the study."""
    for scenario in SCENARIOS:
        yield _case("single", scenario, "pd", "pd", traces=TRACES)
        for label, settings in SINGLE.items():
            traces = TRACES if label == "no delay" else ()
            yield _case("single", scenario, "nn", label, *settings, traces=traces)
        for label, settings in DRAWN.items():
            if scenario == "sine" and label in STEP_ONLY:
                continue
            for seed in SEEDS:
                drawn = f"controller.network_seed={seed}.0"
                yield _case("seeds", scenario, "nn", label, *settings, drawn)
        for seeds in FRESH:
            label = f"{seeds[0]} to {seeds[-1]}"
            for seed in seeds:
                yield _case("fresh", scenario, "nn", label, f"controller.network_seed={seed}.0")


def scenario_of(result: Result) -> str:
    """Return `step` or `sine`."""
    return rig_name(result).removeprefix("deadzone-")


def groups(results: Iterable[Result]) -> dict[tuple[str, str], list[Result]]:
    """Return results by (label, scenario), in the order of the cases."""
    found: dict[tuple[str, str], list[Result]] = {}
    for result in results:
        found.setdefault((result.case.label, scenario_of(result)), []).append(result)
    return found


def values(drawn: Sequence[Result]) -> np.ndarray:
    """Return the four errors of each run, (runs, 4); infinite where one diverged."""
    return np.array([[result.metric(name) for name in COLUMNS] for result in drawn])


def error_cells(four: Sequence[float]) -> str:
    """Return the four errors: two joints, two windows."""
    return "{:.4f} {:.4f} \\| {:.4f} {:.4f}".format(*four)


def report(results: Sequence[Result]) -> str:
    """Return the tables."""
    single = groups(of_group(results, "single"))
    base = {scenario: values(single["pd", scenario])[0] for scenario in SCENARIOS}
    parts = [
        "Errors: rms in rad, joint 1 joint 2 over 3-5 s | joint 1 joint 2 over 8-10 s.\n",
        single_table(single),
        transient_table(single),
        "\nTwenty draws of the networks:\n",
        seeds_table(groups(of_group(results, "seeds")), base),
        "\nFresh draws of the rig, of 40 each, in all four windows:\n",
        fresh_table(groups(of_group(results, "fresh")), base),
    ]
    return "\n".join(parts)


def single_table(single: Runs) -> str:
    """Return the errors of PD and of seed 11."""
    rows = [
        [
            f"{label}, {scenario}",
            error_cells(values(drawn)[0]),
            *(known("single", label, scenario) or ("",)),
        ]
        for (label, scenario), drawn in single.items()
    ]
    return markdown(("PD, and seed 11 with", "here", "expected"), rows)


def transient_table(single: Runs) -> str:
    """Return what happens at the start, PD and seed 11."""
    rows = []
    for label in ("pd", "no delay", "1 sample"):
        step, sine = single[label, "step"][0], single[label, "sine"][0]
        each = [
            " ".join(form.format(of.metric(name.format(joint))) for joint in (1, 2))
            for of, name, form in (
                (step, "settle_{}_s", "{:.2f}"), (step, "overshoot_{}_rad", "{:.3f}"),
                (step, "error_bias_{}_rad", "{:.4f}"),
                (sine, "start_error_rms_{}_rad", "{:.4f}"),
                (sine, "adapted_error_rms_{}_rad", "{:.4f}"),
            )
        ]  # fmt: skip
        rows.append([label, *each])
    head = ("", "step: settled s", "overshoot rad", "hang-off rad", "sine: 0-1.5 s", "1.5-3 s")
    return markdown(head, rows)


def seeds_table(drawn: Runs, base: Mapping[str, np.ndarray]) -> str:
    """Return medians, 90th percentiles, shares better than PD and the overshoot.

    `base`: PD's four errors, (4,), by scenario.
    """
    rows = []
    for (label, scenario), runs in drawn.items():
        found = values(runs)
        times = base[scenario] / found
        overshoot = [run.metric("overshoot_1_rad") for run in runs]
        over = f"{np.median(overshoot):.2f}, {max(overshoot):.2f}" if scenario == "step" else ""
        cells = (
            error_cells(np.median(found, axis=0)),
            error_cells(np.percentile(found, 90, axis=0)),
            f"{np.mean((times > 1).all(axis=1)):.2f}",
            f"{np.mean((times >= 5).all(axis=1)):.2f}",
        )
        ended = str(sum(run.metric("diverged") > 0.5 for run in runs))
        known_cells = bracketed_cells(cells, known("seeds", label, scenario))
        rows.append([f"{label}, {scenario}", *known_cells, over, ended])
    head = ("20 seeds (expected)", "median", "90th percentile", "better than PD", "5 times better",
            "overshoot: median, worst", "ended by the guard")  # fmt: skip
    return markdown(head, rows)


def fresh_table(drawn: Runs, base: Mapping[str, np.ndarray]) -> str:
    """Return how many of the fresh draws are better than PD, and five times better.

    `base`: PD's four errors, (4,), by scenario.
    """
    rows = []
    for (label, scenario), runs in drawn.items():
        times = base[scenario] / values(runs)
        counts = [str(np.sum((times > least).all(axis=1))) for least in (1, 5)]
        rows.append([f"seeds {label}, {scenario}", *counts])
    return markdown(("", "better than PD", "5 times better"), rows)


def draw(results: Sequence[Result], folder: Path) -> None:
    """Draw PD beside the network on both rigs, and all draws of the main variants."""
    single = groups(of_group(results, "single"))
    for scenario in SCENARIOS:
        pair = [single["pd", scenario][0], single["no delay", scenario][0]]
        draw_beside(pair, folder / f"deadzone-{scenario}.png")
    base = {scenario: values(single["pd", scenario])[0] for scenario in SCENARIOS}
    found = {k: values(runs) for k, runs in groups(of_group(results, "seeds")).items()}
    draw_seeds(found, base, folder / "deadzone-seeds.png")
