"""The study of the pendulum behind backlash: three cases, delay, rates, seeds, where gain is from.

1 kHz and network seed 1 unless a table says otherwise. Tuning is chaotic: a repeat changes one gain
by a few parts in 1e11, and what differs between repeats is not a property of the law.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from pcpc.plants.backlash_pendulum.book.study_figures import draw_attribution, draw_cases
from pcpc.plants.book.tables import (
    Column,
    RunsTable,
    Sentence,
    across,
    at,
    by_label,
    case_maker,
    controller_of,
    expected_figures,
    group_of,
    label_of,
    page,
    part,
    rig_name,
    share,
    span,
)
from pcpc.plants.study import Case, CaseResult

CHAPTER = 5
TITLE = "Chapter 5.2: a pendulum behind backlash"
_case, known = case_maker(__file__), expected_figures(__file__)
MAIN, LATE, IDEAL = "backlash-pendulum", "backlash-pendulum-late", "backlash-pendulum-ideal"
LAWS = ("pd", "robust", "nn")
REPEATS, SEEDS = 12, 10

TRACES = (
    "error_rad", "torque_error_Nm", "plant:pendulum.torque_Nm", "plant:pendulum.acting_Nm",
    "executive:controller.tau_d_Nm", "executive:controller.norm_w",
    "executive:controller.network_Nm_s", "executive:controller.robust_Nm_s",
)  # fmt: skip

VARIED: dict[str, tuple[str, ...]] = {
    "1 sample late": ("pendulum.delay_samples=1.0",),
    "2 samples late": ("pendulum.delay_samples=2.0",),
    "3 samples late": ("pendulum.delay_samples=3.0",),
    "500 Hz": ("rate_hz=500.0",),
    "200 Hz": ("rate_hz=200.0",),
}
HALF, LIGHT, INVERTED = (
    ("pendulum.mass_kg=0.5", "controller.model_gravity_Nm=12.2625"),
    ("pendulum.mass_kg=0.16", "controller.model_gravity_Nm=3.924"),
    ("pendulum.gravity_m_s2=-9.81", "controller.model_gravity_Nm=-24.525"),
)
MODELS: dict[str, tuple[str, ...]] = {
    "as specified": (),
    "m g a halved": HALF,
    "g/a": LIGHT,
    "sign of sin reversed": INVERTED,
}
NO_LAYER = ("controller.layer_Nm=0.0", "controller.layer_ratio=1e30", "controller.u_max_Nm=1e9")
ATTRIBUTION = {  # label: law, settings
    "PD, Kb = 15": ("pd",),
    "network without robust term": ("nn", "controller.robust_on=0.0"),
    "robust term alone, Z_M = 1": ("robust",),
    "robust term alone, Z_M = 11": ("robust", "controller.z_bound=11.0"),
    "robust term alone, Z_M = 25": ("robust", "controller.z_bound=25.0"),
    **{f"PD, Kb = {kb}": ("pd", f"controller.kb_per_s={kb}.0") for kb in (50, 100, 200, 400)},
    "all of case 3": ("nn",),
}


def repeat(i: int) -> str:
    """Return the setting that makes a run the `i`-th repeat: beyond every digit of a table."""
    return f"controller.filter_rad_s={100.0 + 1e-9 * i!r}"


def late(samples: int) -> str:
    """Return the setting for so many samples of delay."""
    return f"pendulum.delay_samples={float(samples)}"


def seed_setting(seed: int) -> str:
    """Return the setting that draws a first layer."""
    return f"controller.network_seed={float(seed)}"


def cases() -> Iterator[Case]:
    """Yield all runs."""
    for rig in (IDEAL, MAIN, LATE):
        for law in LAWS:
            yield _case("main", rig, law, f"{rig} {law}", traces=TRACES)
    for label, settings in VARIED.items():
        for i in range(REPEATS):
            yield _case("varied", MAIN, "nn", label, *settings, repeat(i))
    for samples in range(4):
        for seed in range(SEEDS):
            drawn = (late(samples), seed_setting(seed))
            yield _case("seeds", MAIN, "nn", str(samples), *drawn)
            minute = ("duration_s=60.0", *drawn)
            yield _case("minute", MAIN, "nn", str(samples), *minute, window_s=(2.0, 60.0))
    lsb = (
        "position_lsb_rad=1e-4",
        "rate_lsb_rad_s=1e-2",
        "torque_lsb_Nm=1e-2",
        "command_lsb_Nm=1e-2",
    )
    yield _case("coarse", MAIN, "nn", "coarse sensors", *(f"pendulum.{one}" for one in lsb))
    for label, (law, *own) in ATTRIBUTION.items():
        for samples in (0, 3):
            yield _case("attribution", MAIN, law, f"{label} {samples}", *own, late(samples))
    yield from layers()
    for label, settings in MODELS.items():
        for law, samples in (("pd", 0), ("robust", 0), ("nn", 0), ("nn", 1)):
            yield _case("model", MAIN, law, f"{label} {law} {samples}", *settings, late(samples))
    for filter_rad_s in (20.0, 50.0, 200.0, 300.0):
        yield _case("filter", MAIN, "nn", "", f"controller.filter_rad_s={filter_rad_s}")


def layers() -> Iterator[Case]:
    """Yield the boundary layers that are too thin, fixed, or too steep for the delay."""
    for i in range(REPEATS):
        yield _case("layer", MAIN, "nn", "none (sgn), 0", *NO_LAYER, repeat(i))
    for width in (0.2, 0.3, 0.5):
        fixed = (f"controller.layer_Nm={width}", "controller.layer_ratio=1e30")
        for samples in (0, 1):
            for seed in range(SEEDS):
                drawn = (late(samples), seed_setting(seed))
                yield _case("layer", MAIN, "nn", f"fixed {width}, {samples}", *fixed, *drawn)
    for ratio in (0.15, 0.20, 0.25, 0.40):
        for seed in range(SEEDS):
            drawn = (late(3), seed_setting(seed))
            steep = f"controller.layer_ratio={ratio}"
            yield _case("layer", MAIN, "nn", f"rho = {ratio:.2f}, 3", steep, *drawn)


def mrad(value: float) -> str:
    """Return the text of an angle or a rate."""
    return f"{1e3 * value:.1f}"


RMS, LARGEST, TORQUE = "error_rms_rad", "error_max_rad", "torque_error_rms_Nm"
TABLES = (
    RunsTable(
        "main",
        (
            Column("rms e1", RMS, text=mrad),
            Column("max e1", LARGEST, text=mrad),
            Column("rms e2", "rate_error_rms_rad_s", text=mrad),
            Column("rms tt", TORQUE, text="{:.3f}"),
            Column("rms e1 0.5-2 s", "transient_error_rms_rad", text=mrad),
            Column("last abs(e1) > 10", "settled_s", text="{:.2f}"),
            Column("max abs(u)", "command_max_Nm", text="{:.1f}"),
        ),
        "mrad, mrad/s, N m, s over 2 to 20 s; in brackets an independent implementation without a "
        "bus.",
        {"rig": rig_name, "law": controller_of},
    ),
    RunsTable(
        ("varied", "coarse"),
        (
            Column("rms e1", RMS, span, mrad), Column("independent", 0),
            Column("max e1", LARGEST, span, mrad), Column("independent", 1),
        ),
        f"Delay and rate: ranges over {REPEATS} repeats. Coarse: 1e-4 rad, 1e-2 rad/s, N m.",
        {"nn": label_of},
    ),
    RunsTable(
        ("seeds", "minute"),
        (
            *at(
                group_of,
                "seeds",
                Column("median rms e1", RMS, np.median, mrad),
                Column("worst", RMS, max, mrad),
                Column("independent", 0),
                Column("worst last abs(e1) > 10", "settled_s", max, "{:.2f}"),
            ),
            *at(group_of, "minute", Column("worst in 60 s", RMS, max, mrad)),
            *at(
                group_of,
                "seeds",
                Column("largest abs(W)", "norm_w_max", max, "{:.0f}"),
                Column("worst rms tt", TORQUE, max, "{:.2f}"),
            ),
        ),
        f"nn over {SEEDS} seeds of V.",
        {"samples late": label_of},
    ),
    RunsTable(
        "attribution",
        (
            *at(
                part(1),
                0,
                Column("rms e1", RMS, text=mrad),
                Column("independent", 0),
                Column("rms tt", TORQUE, text="{:.2f}"),
            ),
            *at(part(1), 3, Column("rms e1, 3 samples late", RMS, text=mrad)),
        ),
        "Where the gain comes from.",
        {"law": part(0)},
    ),
    RunsTable(
        "layer",
        (
            Column("latched off", "diverged", share),
            Column("rms e1", RMS, span, mrad),
            Column("rms tt", TORQUE, span, "{:.1f}"),
            Column("max abs(u)", "command_max_Nm", span, "{:.0f}"),
        ),
        "Boundary layers; without one the guard on u was raised to 1e9 N m.",
        {"layer": part(0, ", "), "samples late": part(1, ", ")},
    ),
    RunsTable(
        "model",
        across(
            lambda result: " ".join(label_of(result).split()[-2:]),
            {"pd 0": "pd", "robust 0": "robust", "nn 0": "nn", "nn 1": "nn, 1 sample late"},
            Column("{}", RMS, text=mrad),
        ),
        "The book's equation of motion is lost; the law knows the one in use.",
        {"right side of the plant": part(0, " ", 2)},
    ),
    Sentence(
        "filter",
        [Column("", RMS, span, mrad)],
        "nn with a filter of 20 to 300 rad/s: rms e1 {} mrad.\n",
    ),
)  # fmt: skip


def report(results: Sequence[CaseResult]) -> str:
    """Return the tables."""
    return page(results, TABLES, known)


def draw(results: Sequence[CaseResult], folder: Path) -> None:
    """Draw the three cases beside each other, and where the gain comes from."""
    main, parts = (by_label(results, group) for group in ("main", "attribution"))
    draw_cases([main[f"{MAIN} {law}"] for law in LAWS], folder / "backlash-pendulum.png")
    gains = {label: parts[f"{label} 0"] for label in ATTRIBUTION}
    draw_attribution(gains, folder / "backlash-pendulum-gain.png")
