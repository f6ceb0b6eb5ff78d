"""The study of the pendulum behind backlash: three cases, delay, rates, seeds, where gain is from.

1 kHz and network seed 1 unless a table says otherwise. Tuning is chaotic: a repeat changes one gain
by a few parts in 1e11, and what differs between repeats is not a property of the law.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from pcpc.plants.backlash_pendulum.book.study_figures import draw_attribution, draw_cases
from pcpc.plants.book.tables import (
    bracketed_cells,
    case_maker,
    expected_figures,
    labels,
    least_to_largest,
    results_of_label,
    rig_name,
)
from pcpc.plants.study import Case, Result, markdown, of_group

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


def in_mrad(result: Result, name: str) -> float:
    """Return a metric as the tables show it: angles and rates in mrad, mrad/s."""
    return (1e3 if "_rad" in name else 1.0) * result.metric(name)


def span(results: Sequence[Result], name: str, digits: int = 1) -> str:
    """Return `least-largest` of a metric, or one number where they print alike."""
    return least_to_largest(results, lambda r: in_mrad(r, name), lambda v: f"{v:.{digits}f}")


def report(results: Sequence[Result]) -> str:
    """Return the tables."""
    return "\n".join(
        (_main(results), _variation_table(results), _seeds(results), _attribution(results),
         _layers(results), _models(results))
    )  # fmt: skip


def _main(results: Sequence[Result]) -> str:
    figures = (
        ("error_rms_rad", 1), ("error_max_rad", 1), ("rate_error_rms_rad_s", 1),
        ("torque_error_rms_Nm", 3), ("transient_error_rms_rad", 1),
    )  # fmt: skip
    rows = []
    for result in of_group(results, "main"):
        rig, law = rig_name(result), result.case.controller
        cells = [f"{in_mrad(result, name):.{digits}f}" for name, digits in figures]
        pairs = bracketed_cells(cells, known("main", rig, law))
        rest = [f"{result.metric('settled_s'):.2f}", f"{result.metric('command_max_Nm'):.1f}"]
        rows.append([rig, law, *pairs, *rest])
    head = ("rig", "law", "rms e1", "max e1", "rms e2", "rms tt", "rms e1 0.5-2 s",
            "last abs(e1) > 10", "max abs(u)")  # fmt: skip
    return (
        "mrad, mrad/s, N m, s over 2 to 20 s; in brackets an independent implementation without a "
        "bus.\n\n" + markdown(head, rows)
    )


def _variation_table(results: Sequence[Result]) -> str:
    rows = []
    for label in (*VARIED, "coarse sensors"):
        found = results_of_label(results, "varied" if label in VARIED else "coarse", label)
        rms, largest = known("varied", label)
        pair = (span(found, "error_rms_rad"), rms, span(found, "error_max_rad"), largest)
        rows.append([label, *pair])
    head = ("nn", "rms e1", "independent", "max e1", "independent")
    return (
        f"Delay and rate: ranges over {REPEATS} repeats. Coarse: 1e-4 rad, 1e-2 rad/s, N m.\n\n"
        + markdown(head, rows)
    )


def _seeds(results: Sequence[Result]) -> str:
    rows = []
    for samples in range(4):
        runs, minutes = (
            results_of_label(results, group, str(samples)) for group in ("seeds", "minute")
        )
        values = [in_mrad(result, "error_rms_rad") for result in runs]
        settled = [result.metric("settled_s") for result in runs]
        rows.append([
            str(samples), f"{np.median(values):.1f}", f"{max(values):.1f}",
            *known("seeds", samples),
            f"{max(settled):.2f}", f"{max(in_mrad(r, 'error_rms_rad') for r in minutes):.1f}",
            f"{max(r.metric('norm_w_max') for r in runs):.0f}",
            f"{max(r.metric('torque_error_rms_Nm') for r in runs):.2f}",
        ])  # fmt: skip
    head = ("samples late", "median rms e1", "worst", "independent", "worst last abs(e1) > 10",
            "worst in 60 s", "largest abs(W)", "worst rms tt")  # fmt: skip
    return f"nn over {SEEDS} seeds of V.\n\n" + markdown(head, rows)


def _attribution(results: Sequence[Result]) -> str:
    rows = []
    for label in ATTRIBUTION:
        now = results_of_label(results, "attribution", f"{label} 0")
        later = results_of_label(results, "attribution", f"{label} 3")
        tt = span(now, "torque_error_rms_Nm", 2)
        (there,) = known("attribution", label) or ("",)
        rows.append([label, span(now, "error_rms_rad"), there, tt, span(later, "error_rms_rad")])
    head = ("law", "rms e1", "independent", "rms tt", "rms e1, 3 samples late")
    return "Where the gain comes from.\n\n" + markdown(head, rows)


def _layers(results: Sequence[Result]) -> str:
    rows = []
    for label in labels(results, "layer"):
        runs = results_of_label(results, "layer", label)
        cut = sum(result.metric("diverged") > 0.5 for result in runs)
        width, samples = label.rsplit(", ", 1)
        rows.append([
            width, samples, f"{cut} of {len(runs)}", span(runs, "error_rms_rad"),
            span(runs, "torque_error_rms_Nm"), span(runs, "command_max_Nm", 0),
        ])  # fmt: skip
    head = ("layer", "samples late", "latched off", "rms e1", "rms tt", "max abs(u)")
    return "Boundary layers; without one the guard on u was raised to 1e9 N m.\n\n" + markdown(
        head, rows
    )


def _models(results: Sequence[Result]) -> str:
    rows = []
    for label in MODELS:
        kinds = ("pd 0", "robust 0", "nn 0", "nn 1")
        values = [
            span(results_of_label(results, "model", f"{label} {kind}"), "error_rms_rad")
            for kind in kinds
        ]
        rows.append([label, *values])
    filters = span(of_group(results, "filter"), "error_rms_rad")
    head = ("right side of the plant", "pd", "robust", "nn", "nn, 1 sample late")
    return (
        "The book's equation of motion is lost; the law knows the one in use.\n\n"
        + markdown(head, rows)
        + f"\nnn with a filter of 20 to 300 rad/s: rms e1 {filters} mrad.\n"
    )


def draw(results: Sequence[Result], folder: Path) -> None:
    """Draw the three cases beside each other, and where the gain comes from."""
    main = {r.case.label: r for r in of_group(results, "main")}
    draw_cases([main[f"{MAIN} {law}"] for law in LAWS], folder / "backlash-pendulum.png")
    gains = {
        label: results_of_label(results, "attribution", f"{label} 0")[0] for label in ATTRIBUTION
    }
    draw_attribution(gains, folder / "backlash-pendulum-gain.png")
