"""The study of the quarter car: three roads, seven struts; delay, forgetting, quanta, causes.

In brackets, beside each figure, what an independent implementation of the same equations gave.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcpc.executive.rig.reading import load_rig
from pcpc.plants.book.tables import (
    Column,
    Part,
    RunsTable,
    Sentence,
    across,
    bracketed_cells,
    case_maker,
    controller_of,
    expected_figures,
    label_of,
    page,
)
from pcpc.plants.quarter_car.book import bode
from pcpc.plants.quarter_car.book.study_figures import ROADS, draw_all, road_of
from pcpc.plants.study import Case, CaseResult, markdown

CHAPTER = 6
TITLE = "Chapter 6: quarter car with a hydraulic strut"
RIGS = Path(__file__).resolve().parents[1] / "rigs"
case, known = case_maker(__file__, "suspension-"), expected_figures(__file__)
DELAYS, PID_DELAYS, KAPS, KICK = (1, 2, 3, 5), (0, 1, 2, 3), (1, 10, 300), ("pid", "fl", "no_fl")
BODE_RAD_S = (2.0, 5.0, 7.6, 8.0, 20.0, 40.0, 56.75, 58.0, 100.0, 150.0, 300.0)
STRUTS = {  # label: controller, settings
    "passive, no stops": ("outer", ("car.strut=0.0", "car.limits_on=0.0")),
    "passive": ("outer", ("car.strut=0.0",)),
    "pid": ("pid", ()),
    "fl": ("fl", ()),
    "no_fl": ("no_fl", ()),
    "ideal force": ("outer", ("car.strut=2.0",)),
    "valve closed": ("outer", ()),
}
QUANTA = ("car.rate_lsb_m_s=1e-3", "car.extension_lsb_m=1e-5", "car.pressure_lsb_Pa=2e3",
          "car.spool_lsb_m=1e-7")  # fmt: skip
FASTER = ("controller.exact_drift=1.0", "controller.tf_s=0.0005", "controller.lam_per_s=400.0",
          "controller.k1_per_s=200.0")  # fmt: skip
CAUSES = {
    "fl": (),
    "exact drift": ("controller.exact_drift=1.0",),
    "exact drift, faster": FASTER,
    "exact drift, faster, 2 samples late": (*FASTER, "car.delay_samples=2.0"),
}
STEPS_S = ("1e-4", "5e-5", "2.5e-5", "1.25e-5")
TRACES = (
    "plant:car.body_rate_m_s", "plant:car.extension_m", "plant:car.strut_N",
    "plant:car.spool_m", "executive:controller.desired_N", "executive:controller.ef_N",
    "executive:controller.norm_theta_m",
)  # fmt: skip


def _case(group: str, road: int | str, controller: str, label: str, *settings: str) -> Case:
    return case(group, str(road), controller, label, *settings, traces=TRACES)


def cases() -> Iterator[Case]:
    """Yield all runs of the study."""
    for road in ROADS:
        for label, (controller, settings) in STRUTS.items():
            yield _case("table", road, controller, label, *settings)
        for label in ("passive", "pid", "fl"):  # with every sample; the table's keep every fourth
            controller, settings = STRUTS[label]
            short = ("duration_s=2.9", "evaluation.window_s=[2.0,2.9]") if road > 8 else ()
            yield _case("close", road, controller, label, *settings, *short)
        preloaded = ("car.strut=0.0", "car.gravity_m_s2=0.0")
        yield _case("preloaded", road, "outer", str(road), *preloaded)
        for delay in DELAYS:
            yield _case("delay", road, "fl", str(delay), f"car.delay_samples={delay}.0")
        for kap in KAPS:
            yield _case("kap", road, "fl", str(kap), f"controller.kap_per_m={kap}.0")
        yield _case("quanta", road, "fl", "coarse", *QUANTA)
        for step in STEPS_S:
            for label in ("passive", "pid", "fl", "no_fl"):
                controller, settings = STRUTS[label]
                yield _case("steps", road, controller, label, *settings, f"car.step_s={step}")
    for controller in KICK:
        yield _case("kick", "kick", controller, controller)
    for delay in PID_DELAYS:
        yield _case("pid delay", 8, "pid", str(delay), f"car.delay_samples={delay}.0")
    yield _case("long", 58, "fl", "30 s", "duration_s=30.0", "evaluation.window_s=[3.0,30.0]")
    for label, settings in CAUSES.items():
        yield _case("causes", 150, "fl", label, *settings)


def draw(results: Sequence[CaseResult], folder: Path) -> None:
    """Draw roads, forces, the kick, the bars and the frequency responses."""
    draw_all(results, folder, *nominal())


def nominal() -> tuple[Mapping[str, float], Mapping[str, float]]:
    """Return the settings of the car and of the outer loop."""
    nodes = load_rig(RIGS / "suspension-8.yaml", "outer").nodes()
    (car,) = (b.settings for b in nodes["plant"].blocks if b.name == "car")
    (law,) = (b.settings for b in nodes["executive"].blocks if b.name == "controller")
    return car, law


def shown_speed(value: float) -> str:
    """Return the text of a speed."""
    return f"{value:.4f}".removeprefix("0")


def shown_force(value: float) -> str:
    """Return the text of a force error; "" of a strut without one."""
    return "" if np.isnan(value) else f"{value:.0f}"


def shown_spool(value: float) -> str:
    """Return the text of the largest magnitude of the spool; "" of a strut without one."""
    return f"{1e3 * value:.3f}" if value > 0.0 else ""


def shown_oscillation(value: float) -> str:
    """Return the text of a frequency."""
    return "none" if np.isnan(value) else f"{value:.1f}"


def travel(result: CaseResult) -> str:
    """Return the ends of a strut's travel."""
    low, high = (result.metric(f"extension_{end}_m") for end in ("min", "max"))
    return f"{low:.3f} to {high:.3f}".replace("0.", ".")


def step_s(result: CaseResult) -> str:
    """Return the integration step of a result."""
    return result.case.settings[-1].partition("=")[2]


SPEED = Column("v_rms m/s", "speed_rms_m_s", text=shown_speed)
FORCE = Column("ef_rms N", "force_error_rms_N", text=shown_force)
ON_ROADS = across(road_of, ROADS, replace(SPEED, head="{} rad/s"))
ACCELERATION = Column("a_rms m/s2", "acceleration_rms_m_s2", text="{:.2f}")
MM = Column("", "", text=lambda value: f"{1e3 * value:.2f}")
TABLES: tuple[Part, ...] = (
    RunsTable(
        "table",
        (
            SPEED, Column("v_max m/s", "speed_max_m_s", text=shown_speed), ACCELERATION,
            Column("extension m", travel), FORCE,
            Column("spool mm", "spool_max_m", text=shown_spool),
        ),
        "6 s at 1 kHz, figures of 3 to 6 s; v and a of the body, spool: its largest magnitude. In "
        "brackets the figures of an independent implementation of the same equations.",
        {"strut": label_of, "rad/s": road_of},
        nested=True,
    ),
    RunsTable(
        "preloaded",
        ON_ROADS,
        "Passive, preloaded so that it rests at mid stroke, stops on: v_rms (computed with g = 0)",
        rows={},
    ),
    RunsTable(
        "kick",
        (
            replace(SPEED, text="{:.3g}"),
            Column("spool mm", "spool_max_m", text=lambda value: f"{1e3 * value:.2g}"),
            Column("oscillation rad/s", "oscillation_rad_s", text=shown_oscillation),
        ),
        "Flat road, body kicked with 0.05 m/s, 3 to 6 s",
        {"": controller_of},
    ),
    RunsTable("delay", ON_ROADS, "fl, command late by so many samples: v_rms"),
    RunsTable("kap", ON_ROADS, "fl, other kap (100 in the rigs): v_rms"),
    RunsTable("quanta", ON_ROADS, "fl, sensors of 1 mm/s, 10 um, 2 kPa, 0.1 um: v_rms"),
    RunsTable(
        "pid delay",
        across(label_of, PID_DELAYS, replace(ACCELERATION, head="{} samples")),
        "pid at 8 rad/s, command late: a_rms",
        rows={},
    ),
    Sentence(
        "long",
        (replace(MM, source="theta_norm_max_m"), replace(MM, source="theta_max_m")),
        "fl, 30 s at 58 rad/s: norm of Th at most {} mm, largest entry {} mm\n",
    ),
    RunsTable(
        "causes",
        (
            replace(FORCE, text="{:.0f}"),
            Column("correlation of F with Fd", "force_correlation", text="{:.2f}"),
            SPEED,
        ),
        "Why the strut does not follow Fd at 150 rad/s; faster: tf 0.5 ms, lam 400/s, k1 200/s",
    ),
    RunsTable(
        "steps",
        across(step_s, STEPS_S, Column("{}", "speed_rms_m_s", text="{:.5f}")),
        "Integration step: v_rms",
        {"": label_of, "rad/s": road_of},
        nested=True,
    ),
)  # fmt: skip


def report(results: Sequence[CaseResult]) -> str:
    """Return the tables."""
    return page(results, (*TABLES, _bode()), known)


def _bode() -> str:
    car, gains = nominal()
    rows = []
    for law in bode.LAWS:
        found = bode.response_db(law, np.array(BODE_RAD_S), car, gains)
        at, height = bode.peak(law, 40.0, 90.0, car, gains)
        cells = [*(f"{value:.2f}" for value in found), f"{height:.1f} at {at:.1f}"]
        peak = " at ".join(known("peak", law))
        rows.append([law, *bracketed_cells(cells, [*known("bode", law), peak])])
    head = ("dB re 1/s2", *(f"{v:g}" for v in BODE_RAD_S), "peak")
    return "Linear: road to body acceleration\n\n" + markdown(head, rows)
