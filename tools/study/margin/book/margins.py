"""`pcpc experiment margins`: measured against linearised open loops, on every plant.

Three linear plants of closed form first. Then each plant where it has a linear regime, what had to
be taken away for it said in its row, measured in bands, so that a line has enough signal over the
quanta of frames and sensors; then the rigs as they are, with why they have none. Writes results.md,
figures/deviation.png, and Bode and Nyquist plots of the barrel.
"""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.rig.reading import load_rig
from pcpc.plants import atb1000
from pcpc.plants.study import markdown
from pcpc.tools.start.rigs import find
from pcpc.tools.study.margin import linear, loops, measured, operating
from pcpc.tools.study.margin.book._linear_rig import PLANTS
from pcpc.tools.study.margin.commands import Question
from pcpc.tools.study.margin.find import margin_of
from pcpc.tools.study.margin.margins import margins
from pcpc.tools.terminal.progress import Progress

Vector = NDArray[np.float64]
_BARREL = f"@{Path(atb1000.__file__).with_name('linear.yaml')}"
_STILL = tuple(f"controller.amplitude_{i}_rad=0" for i in (1, 2))
_WIDTHS = ("arm.d_plus_Nm=0", "arm.d_minus_Nm=0", "arm.m_plus=1", "arm.m_minus=1")
_DRY = tuple(f"arm.{what}_{i}_Nm=0" for what in ("coulomb", "stiction") for i in (1, 2))
_CHAINS = ("chains.a_gap=0", "chains.b_gap=0", "chains.a_slope=1", "chains.b_slope=1")
_ROAD = ("car.road_m=0", "car.limits_on=0", "car.fc_N=0")
_BANDS = (  # the drive's mode at 48 Hz leaves the flanks if pushed hard; L is small above it
    (0.0, 3.0, 0.8), (3.0, 30.0, 0.8), (30.0, 90.0, 0.25), (90.0, 200.0, 1.0), (200.0, np.inf, 1.2),
)  # fmt: skip
_WHOLE = ((0.0, np.inf, 1.0),)


@dataclass(frozen=True)
class Case:
    """A rig where it is linear: settings, what they mean, amplitude, rest; bands in Hz."""

    rig: str
    controller: str
    settings: tuple[str, ...]
    without: str
    amplitude: float
    settle_s: float
    bands: tuple[tuple[float, float, float], ...] = _WHOLE


@dataclass(frozen=True)
class LoopComparison:
    """Lines f_hz (m,), the linearised L there, |measured/linearised - 1|, numbers of both."""

    f_hz: Vector
    linearised: NDArray[np.complex128]
    deviation: Vector
    gain_margin: float
    phase_margin_deg: float
    loop: str


CASES = {
    "probe": Case("probe", "proportional", (), "nothing", 0.02, 4.0),
    "backlash_pendulum": Case("backlash-pendulum-ideal", "pd", (), "gap", 5.0, 4.0),
    "backlash_map": Case("backlash-map-ideal", "pd", (), "gap", 1e-3, 40.0),
    "deadzone_arm": Case("deadzone-step", "pd", _WIDTHS, "deadzones", 10.0, 4.0),
    "deadzone_map": Case("fuzzy-d00", "pd", (), "deadzone", 0.05, 40.0),
    "map_chains": Case("two-gaps", "pd_slow", _CHAINS, "gaps", 0.01, 40.0),
    "friction_arm": Case("friction-a", "pd", _DRY, "dry friction", 10.0, 8.0),
    "payload_arm": Case("payload-none", "pd", (), "nothing", 10.0, 8.0),
    "quarter_car": Case("suspension-58", "no_fl", _ROAD, "road, stops, dry friction", 1e-4, 4.0),
    "telerobot": Case("telerobot-u0", "smith", ("controller.u_lsb_rad_s2=0", *_STILL),
                      "motion, quantum of u", 20.0, 6.0),
    "atb1000": Case("sin0.5", "pd", (_BARREL,), "play, friction, noise", 1.0, 4.0,
                    _BANDS),
}  # fmt: skip
CAUSES = (  # in one band: lines that are wrong with too little signal, or with too much
    ("atb1000", (0.25, 47.25, 499.75), (0.4, 1.0, 1.7)),
    ("friction_arm", (0.75, 2.75, 18.75), (1.0, 3.0, 10.0)),
)
AS_THEY_ARE = (
    ("backlash-pendulum", "pd"), ("backlash-map", "pd"), ("deadzone-step", "pd"),
    ("fuzzy-d03", "pd"), ("two-gaps", "pd_slow"), ("friction-a", "pd"), ("suspension-58", "pid"),
    ("telerobot-u0", "pd"), ("sin0.5", "pd"),
)  # fmt: skip


def run(folder: Path, progress: Progress, jobs: int | None) -> int:
    """Write results.md and the figures; return 0."""
    figures = folder / "figures"
    figures.mkdir()
    progress.show("margins: three linear plants")
    exact, found = [_exact(name) for name in PLANTS], dict[str, LoopComparison]()
    for name, case in CASES.items():
        progress.show(f"margins: {name}")
        found[name] = compared_loops(case)
    rows = [_row(name, case, found[name]) for name, case in CASES.items()]
    progress.show("margins: rigs as they are")
    whole = [_as_it_is(rig, controller) for rig, controller in AS_THEY_ARE]
    heads = ("plant", "loop of", "without", "lines", "largest", "at", "median", "gain", "phase")
    texts = [
        "# Margins, measured against linearised\n\n## Closed forms\n",
        markdown(("plant", "gain margin", "phase margin", "largest error of both"), exact),
        "\n## Plants where they are linear\n",
        markdown(heads, rows),
        "\n## The worst lines, in one band, over the amplitude\n",
        markdown(("plant", "amplitude", "line", "deviation"), _causes()),
        "\n## Rigs as they are\n",
        markdown(("rig", "controller", "linearised at rest"), whole),
    ]
    (folder / "results.md").write_text("\n".join(texts))
    draw(found, figures / "deviation.png")
    barrel = CASES["atb1000"]
    rig = load_rig(find(barrel.rig), barrel.controller, list(barrel.settings))
    one = margin_of(rig, Question(amplitude=1.0, settle_s=barrel.settle_s))
    one.save(figures)
    progress.close()
    return Exit.OK


def compared_loops(case: Case) -> LoopComparison:
    """Return both loops of a case, at the lines of all of its bands."""
    rig = operating.without_disturbances(
        load_rig(find(case.rig), case.controller, list(case.settings))
    )
    plans, rate = operating.plans_of(rig), rig.config.rate_hz
    cut, _ = loops.choose(rig, plans, None)
    held = operating.reference_values(plans, 0.0)
    model = linear.linearise(operating.at_rest(plans, held, case.settle_s), cut)
    f, seen = list[Vector](), list[NDArray[np.complex128]]()
    for low, high, share in case.bands:
        sines = measured.multisine(rate, rate / 4000.0, share * case.amplitude, 1, high, low)
        own = measured.measure(rig, cut, held, sines, case.settle_s)
        strong = own.coherence >= 0.9
        f.append(own.f_hz[strong])
        seen.append(own.response[strong])
    lines, response = np.concatenate(f), np.concatenate(seen)
    ours = model.response(lines)
    grid = np.unique(np.concatenate((np.geomspace(lines[0], 0.5 * rate, 600), lines)))
    numbers = margins(grid, model.response(grid), rate)
    deviation = np.abs(response / ours - 1.0)
    return LoopComparison(
        lines, ours, deviation, numbers.gain_margin, numbers.phase_margin_deg, cut.signal
    )


def _row(name: str, case: Case, found: LoopComparison) -> tuple[str, ...]:
    worst = int(np.argmax(found.deviation))
    return (
        f"{name}, {case.controller}", found.loop, case.without, str(len(found.f_hz)),
        f"{100.0 * found.deviation[worst]:.2g} %", f"{found.f_hz[worst]:.3g} Hz",
        f"{100.0 * np.median(found.deviation):.2g} %", f"{found.gain_margin:.4g}",
        f"{found.phase_margin_deg:.4g} deg" if np.isfinite(found.phase_margin_deg) else "any",
    )  # fmt: skip


def _exact(name: str) -> tuple[str, ...]:
    """Return a linear plant's margins and their error, by both methods, against the closed form."""
    plant = PLANTS[name]
    f = np.geomspace(0.1, 249.999, 100_000)
    exact = margins(f, plant.loop(f), 500.0)
    with tempfile.TemporaryDirectory() as folder:
        rig = load_rig(plant.write(Path(folder)), None, [])
        both = margin_of(rig, Question(amplitude=10.0, settle_s=2.0, lowest_hz=0.5))
    assert both.linearised is not None and both.measured is not None
    errors = [
        abs(getattr(one.margins, what) / getattr(exact, what) - 1.0)
        for one in (both.linearised, both.measured)
        for what in ("gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin")
    ]
    return (
        name, f"{exact.gain_margin:.4g}", f"{exact.phase_margin_deg:.4g} deg",
        f"{100.0 * max(errors):.2g} %",
    )  # fmt: skip


def _causes() -> list[tuple[str, ...]]:
    """Return deviations of single lines as the amplitude grows."""
    rows = list[tuple[str, ...]]()
    for name, lines, amplitudes in CAUSES:
        for amplitude in amplitudes:
            one = compared_loops(replace(CASES[name], amplitude=amplitude, bands=_WHOLE))
            for line in lines:
                at = int(np.argmin(np.abs(one.f_hz - line)))
                told = f"{one.f_hz[at]:.4g} Hz", f"{100.0 * one.deviation[at]:.2g} %"
                rows.append((name, f"{amplitude:g}", *told))
    return rows


def _as_it_is(rig: str, controller: str) -> tuple[str, ...]:
    """Return why a rig has no linear regime at rest, or what is said of it."""
    try:
        one = margin_of(load_rig(find(rig), controller, []), Question(method="linearised"))
        said = "; ".join(one.notes) or "as above"
    except UserError as error:
        said = str(error).partition("; ")[0]
    return rig, controller, said


def draw(found: dict[str, LoopComparison], path: Path) -> None:
    """Draw the deviation of every plant over the frequency, as a share of half the rate."""
    from matplotlib.figure import Figure

    figure: Any = Figure(figsize=(7.5, 5.0), dpi=110, layout="constrained")
    ax = figure.subplots()
    marks = "osv^<>DPX*h"
    told = np.concatenate([one.deviation for one in found.values()])
    lowest = 100.0 * float(told[told > 0.0].min(initial=1e-3))  # where no deviation is drawn, too
    for (name, one), mark in zip(found.items(), marks, strict=False):
        share, colour = one.f_hz / one.f_hz.max(), "black" if name == "atb1000" else None
        ax.loglog(
            share,
            np.maximum(100.0 * one.deviation, lowest),
            linestyle="none",
            marker=mark,
            markersize=3.5,
            label=name,
            color=colour,
        )
    ax.axhline(5.0, color="black", linewidth=0.8)
    ax.set(xlabel="frequency by half the sampling rate", ylabel="measured against linearised [%]")
    ax.set_title("Open loops, where the plants are linear; line: 5 %", fontsize=11)
    figure.legend(loc="outside lower center", fontsize=8, ncols=6, frameon=False)
    ax.grid(color="#D8D8D8", linewidth=0.5)
    ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)
