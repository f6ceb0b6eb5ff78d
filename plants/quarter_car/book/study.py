"""The study of the quarter car: three roads, seven struts; delay, forgetting, quanta, causes.

In brackets, beside each figure, what an independent implementation of the same equations gave.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from pcpc.executive.rig.reading import load_rig
from pcpc.plants.book.tables import bracketed_cells, case_maker, expected_figures, labels, rig_name
from pcpc.plants.quarter_car.book import bode
from pcpc.plants.quarter_car.book.study_figures import ROADS, draw_all
from pcpc.plants.study import Case, Result, markdown, of_group

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


def draw(results: Sequence[Result], folder: Path) -> None:
    """Draw roads, forces, the kick, the bars and the frequency responses."""
    draw_all(results, folder, *nominal())


def nominal() -> tuple[Mapping[str, float], Mapping[str, float]]:
    """Return the settings of the car and of the outer loop."""
    nodes = load_rig(RIGS / "suspension-8.yaml", "outer").nodes()
    (car,) = (b.settings for b in nodes["plant"].blocks if b.name == "car")
    (law,) = (b.settings for b in nodes["executive"].blocks if b.name == "controller")
    return car, law


def _speed(value: float) -> str:
    return f"{value:.4f}".removeprefix("0")


def _number(value: float) -> str:
    return "none" if np.isnan(value) else f"{value:.1f}"


def _travel(result: Result) -> str:
    low, high = (result.metric(f"extension_{end}_m") for end in ("min", "max"))
    return f"{low:.3f} to {high:.3f}".replace("0.", ".")


def _row(result: Result) -> list[str]:
    """Return the cells of the main table; "" where a strut has no such figure."""
    ef, spool = result.metric("force_error_rms_N"), 1e3 * result.metric("spool_max_m")
    return [
        _speed(result.metric("speed_rms_m_s")),
        _speed(result.metric("speed_max_m_s")),
        f"{result.metric('acceleration_rms_m_s2'):.2f}",
        _travel(result),
        "" if np.isnan(ef) else f"{ef:.0f}",
        f"{spool:.3f}" if spool > 0.0 else "",
    ]


def report(results: Sequence[Result]) -> str:
    """Return the tables."""
    rows = []
    ordered = sorted(of_group(results, "table"), key=lambda r: [*STRUTS].index(r.case.label))
    for result in ordered:
        label, road = result.case.label, _road(result)
        rows.append([label, road, *bracketed_cells(_row(result), known("table", label, road))])
    head = ("strut", "rad/s", "v_rms m/s", "v_max m/s", "a_rms m/s2", "extension m", "ef_rms N",
            "spool mm")  # fmt: skip
    text = (
        "6 s at 1 kHz, figures of 3 to 6 s; v and a of the body, spool: its largest magnitude. In "
        "brackets the figures of an independent implementation of the same equations.\n\n"
    )
    text += markdown(head, rows)
    parts = (_preload_table, _kick, _robust, _pid_delay, _long, _causes, _steps)
    return "\n".join([text, *(part(results) for part in parts), _bode()])


def _road(result: Result) -> str:
    return rig_name(result).rpartition("-")[2]


def _preload_table(results: Sequence[Result]) -> str:
    own = of_group(results, "preloaded")
    found = [_speed(r.metric("speed_rms_m_s")) for r in own]
    cells = bracketed_cells(found, ["".join(known("preloaded", _road(r))) for r in own])
    title = (
        "Passive, preloaded so that it rests at mid stroke, stops on: v_rms (computed with g = 0)"
    )
    return f"{title}\n\n" + markdown([f"{road} rad/s" for road in ROADS], [cells])


def _kick(results: Sequence[Result]) -> str:
    rows = []
    for result in of_group(results, "kick"):
        cells = (
            f"{result.metric('speed_rms_m_s'):.3g}",
            f"{1e3 * result.metric('spool_max_m'):.2g}",
            _number(result.metric("oscillation_rad_s")),
        )
        name = result.case.controller
        rows.append([name, *bracketed_cells(cells, known("kick", name))])
    head = ("", "v_rms m/s", "spool mm", "oscillation rad/s")
    return "Flat road, body kicked with 0.05 m/s, 3 to 6 s\n\n" + markdown(head, rows)


def _robust(results: Sequence[Result]) -> str:
    parts = []
    for group, title in (
        ("delay", "fl, command late by so many samples: v_rms"),
        ("kap", "fl, other kap (100 in the rigs): v_rms"),
        ("quanta", "fl, sensors of 1 mm/s, 10 um, 2 kPa, 0.1 um: v_rms"),
    ):
        own = of_group(results, group)
        rows = []
        for label in labels(own, group):
            values = [_speed(r.metric("speed_rms_m_s")) for r in own if r.case.label == label]
            rows.append([label, *bracketed_cells(values, known(group, label))])
        parts.append(f"{title}\n\n" + markdown(("", *(f"{w} rad/s" for w in ROADS)), rows))
    return "\n".join(parts)


def _pid_delay(results: Sequence[Result]) -> str:
    own = of_group(results, "pid delay")
    found = [f"{r.metric('acceleration_rms_m_s2'):.2f}" for r in own]
    cells = bracketed_cells(found, [known("pid delay", r.case.label)[0] for r in own])
    head = [f"{r.case.label} samples" for r in own]
    return "pid at 8 rad/s, command late: a_rms\n\n" + markdown(head, [cells])


def _long(results: Sequence[Result]) -> str:
    (run,) = of_group(results, "long")
    values = [f"{1e3 * run.metric(name):.2f}" for name in ("theta_norm_max_m", "theta_max_m")]
    norm, largest = bracketed_cells(values, known("long", run.case.label))
    return f"fl, 30 s at 58 rad/s: norm of Th at most {norm} mm, largest entry {largest} mm\n"


def _causes(results: Sequence[Result]) -> str:
    rows = []
    for result in of_group(results, "causes"):
        cells = (
            f"{result.metric('force_error_rms_N'):.0f}",
            f"{result.metric('force_correlation'):.2f}",
            _speed(result.metric("speed_rms_m_s")),
        )
        rows.append(
            [result.case.label, *bracketed_cells(cells, known("causes", result.case.label))]
        )
    head = ("", "ef_rms N", "correlation of F with Fd", "v_rms m/s")
    title = "Why the strut does not follow Fd at 150 rad/s; faster: tf 0.5 ms, lam 400/s, k1 200/s"
    return f"{title}\n\n" + markdown(head, rows)


def _steps(results: Sequence[Result]) -> str:
    own = of_group(results, "steps")
    rows = []
    for label in ("passive", "pid", "fl", "no_fl"):
        for road in ROADS:
            runs = [r for r in own if r.case.label == label and _road(r) == str(road)]
            rows.append([label, str(road), *(f"{r.metric('speed_rms_m_s'):.5f}" for r in runs)])
    return "Integration step: v_rms\n\n" + markdown(("", "rad/s", *STEPS_S), rows)


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
