"""The study of the arm: PD and the dual network, twenty draws of it, ablations, delays, rates.

Errors are rms in rad over 3-5 s and 8-10 s. A draw is a `network_seed`, 0 to 19; how a draw turns
out depends on the last bit of every weight (README), so that only statistics mean anything.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.plants.book.tables import (
    Column,
    RunsTable,
    at,
    by_case,
    case_maker,
    expected_figures,
    grouped,
    joined,
    label_of,
    page,
    rig_name,
    true_count,
)
from pcpc.plants.deadzone_arm.book.study_figures import draw_beside, draw_seeds
from pcpc.plants.study import Case, CaseResult, of_group

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


def scenario_of(result: CaseResult) -> str:
    """Return `step` or `sine`."""
    return rig_name(result).removeprefix("deadzone-")


def errors(result: CaseResult) -> np.ndarray:
    """Return the four errors of a run, (4,); infinite where it diverged."""
    return np.array([result.metric(name) for name in COLUMNS])


def pd_errors(results: Sequence[CaseResult]) -> dict[str, np.ndarray]:
    """Return PD's four errors, (4,), by scenario."""
    return {scenario_of(r): errors(r) for r in of_group(results, "single") if label_of(r) == "pd"}


def error_cells(four: Sequence[float]) -> str:
    """Return the four errors: two joints, two windows."""
    return "{:.4f} {:.4f} \\| {:.4f} {:.4f}".format(*four)


def median_and_worst(values: Sequence[float]) -> str:
    """Return the text of both."""
    return f"{np.median(values):.2f}, {max(values):.2f}"


def joints(head: str, metric: str, digits: int) -> Column:
    """Return a column of both joints."""
    return Column(head, metric, text=f"{{:.{digits}f}}", between=" ")


ERRORS = Column("here", errors, text=error_cells)
SINGLE_RUNS = RunsTable(
    "single",
    (ERRORS, Column("expected", 0)),
    rows={"PD, and seed 11 with": joined(label_of, scenario_of)},
)
TRANSIENT = RunsTable(
    "single",
    (
        *at(
            scenario_of, "step", joints("step: settled s", "settle_{}_s", 2),
            joints("overshoot rad", "overshoot_{}_rad", 3),
            joints("hang-off rad", "error_bias_{}_rad", 4),
        ),
        *at(
            scenario_of, "sine", joints("sine: 0-1.5 s", "start_error_rms_{}_rad", 4),
            joints("1.5-3 s", "adapted_error_rms_{}_rad", 4),
        ),
    ),
)  # fmt: skip


def report(results: Sequence[CaseResult]) -> str:
    """Return the tables."""
    base = pd_errors(results)

    def better(head: str, more: np.ufunc, least: float, of: Any, text: str) -> Column:
        """Return a column of the runs all of whose errors are so many times below PD's."""
        return Column(
            head,
            lambda r: more(base[scenario_of(r)] / errors(r), least).all(),
            of,
            text,
        )

    started = [r for r in results if label_of(r) in ("pd", "no delay", "1 sample")]
    drawn = (
        replace(ERRORS, head="median", of=partial(np.median, axis=0)),
        replace(ERRORS, head="90th percentile", of=partial(np.percentile, q=90, axis=0)),
        better("better than PD", np.greater, 1, np.mean, "{:.2f}"),
        better("5 times better", np.greater_equal, 5, np.mean, "{:.2f}"),
        *at(
            scenario_of,
            "step",
            Column("overshoot: median, worst", "overshoot_1_rad", median_and_worst),
        ),
        Column("ended by the guard", "diverged", true_count),
    )
    fresh = (
        better("better than PD", np.greater, 1, true_count, ""),
        better("5 times better", np.greater, 5, true_count, ""),
    )
    draw_of = joined(label_of, scenario_of)
    parts = (
        "Errors: rms in rad, joint 1 joint 2 over 3-5 s | joint 1 joint 2 over 8-10 s.\n",
        SINGLE_RUNS,
        TRANSIENT.markdown(started, known),
        "\nTwenty draws of the networks:\n",
        RunsTable("seeds", drawn, rows={"20 seeds (expected)": draw_of}),
        "\nFresh draws of the rig, of 40 each, in all four windows:\n",
        RunsTable("fresh", fresh, rows={"": lambda r: f"seeds {draw_of(r)}"}),
    )
    return page(results, parts, known)


def draw(results: Sequence[CaseResult], folder: Path) -> None:
    """Draw PD beside the network on both rigs, and all draws of the main variants."""
    single = by_case(results, "single")
    for scenario in SCENARIOS:
        rig = f"deadzone-{scenario}"
        pair = [single[rig, "pd", "pd"], single[rig, "nn", "no delay"]]
        draw_beside(pair, folder / f"{rig}.png")
    drawn = grouped(of_group(results, "seeds"), label_of, scenario_of)
    found = {names: np.array([errors(run) for run in runs]) for names, runs in drawn.items()}
    draw_seeds(found, pd_errors(results), folder / "deadzone-seeds.png")
