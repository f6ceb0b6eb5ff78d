"""The figures of the study: speeds on three roads, forces, the kick, bars, frequency responses."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.plants.book.figures import (
    columns,
    draw_lines,
    dress,
    legend_below,
    name_rows,
    reference,
    save,
    times,
)
from pcpc.plants.book.tables import by_label, rig_name
from pcpc.plants.pages import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    Line,
    Panel,
    sheet,
)
from pcpc.plants.quarter_car.book import bode
from pcpc.plants.study import CaseResult, of_group

NAMES = {
    "passive, no stops": "passive, no stops", "passive": "passive", "pid": "PID",
    "fl": "fuzzy backstepping", "no_fl": "backstepping, no fuzzy system",
    "ideal force": "ideal force", "valve closed": "valve closed",
}  # fmt: skip
COLOURS = {
    "passive, no stops": SKY, "passive": GREY, "pid": VERMILION, "fl": BLUE, "no_fl": PURPLE,
    "ideal force": GREEN, "valve closed": ORANGE,
}  # fmt: skip
ROADS = (8, 58, 150)  # rad/s
SHOWN = ("passive", "pid", "fl")
SPAN_S = {8: 3.0, 58: 0.8, 150: 0.4}  # the last so many seconds


def draw_all(
    results: Sequence[CaseResult],
    folder: Path,
    car: Mapping[str, float],
    gains: Mapping[str, float],
) -> None:
    """Draw all figures of `results` into the folder."""
    table = of_group(results, "table")
    runs = {(r.case.label, road_of(r)): r for r in table}
    close = {(r.case.label, road_of(r)): r.traces for r in of_group(results, "close")}
    _motion(runs, close, folder / "motion.png")
    _forces(runs, close, folder / "forces.png")
    _bars(runs, folder / "bars.png")
    _kick(results, folder / "kick.png")
    _responses(car, gains, folder / "bode.png")


def road_of(result: CaseResult) -> int:
    """Return the road's frequency, rad/s."""
    return int(rig_name(result).rpartition("-")[2])


Runs = Mapping[tuple[str, int], CaseResult]
Close = Mapping[tuple[str, int], Mapping[str, Any]]


def _late(x: Mapping[str, Any], road: int) -> Mapping[str, Any]:
    """Return the traces of a road's last seconds."""
    late = x["t"] >= x["t"][-1] - SPAN_S[road]
    return {name: values[late] for name, values in x.items()}


def _motion(runs: Runs, close: Close, path: Path) -> None:
    """Draw body speed and strut travel of passive, PID and fuzzy backstepping on every road."""
    rows = len(SHOWN)
    shares: dict[str, Any] = {"sharex": "col", "sharey": "row", "height_ratios": (4, 2) * rows}
    figure, axes = sheet((12.0, 10.0), 110, 2 * rows, len(ROADS), **shares)
    for i, label in enumerate(SHOWN):
        for j, road in enumerate(ROADS):
            speed, travel = axes[2 * i : 2 * i + 2, j]
            x, run = _late(close[label, road], road), runs[label, road]
            draw_lines(speed, [Line("plant:car.body_rate_m_s", "", COLOURS[label], 1.0)], x)
            mm = times(1e3, "plant:car.extension_m")
            draw_lines(travel, [Line(mm, "", COLOURS[label], 1.0)], x)
            stop_mm = 1e3 * run.settings["car.stop_m"]
            for side in (-1.0, 1.0):
                travel.axhline(side * stop_mm, color=BLACK, linewidth=0.7, linestyle="--")
            text = (
                f"{NAMES[label]}: {run.metrics['speed_rms_m_s']:.4f} m/s, "
                f"{run.metrics['acceleration_rms_m_s2']:.2f} m/s² rms"
            )
            above = "" if i else f"{road} rad/s\n"
            speed.set_title(f"{above}{text}", fontsize=9, loc="left")
            speed.set_ylim(-0.8, 0.8)
            travel.set_ylim(-140.0, 140.0)
    name_rows(axes, ("body [m/s]", "strut [mm]") * rows, "time [s]")
    title = "Body speed and strut travel, stops dashed; each rms is over 3 to 6 s"
    _finish(figure, axes, title, path)


def _forces(runs: Runs, close: Close, path: Path) -> None:
    """Draw desired and actual strut force of PID and fuzzy backstepping, and the valve."""
    figure, axes = sheet((12.0, 8.5), 110, 4, len(ROADS), sharex="col", height_ratios=(4, 2, 4, 2))
    for i, label in enumerate(("pid", "fl")):
        for j, road in enumerate(ROADS):
            x, (force, valve) = _late(close[label, road], road), axes[2 * i : 2 * i + 2, j]
            wanted = reference(times(1e-3, "executive:controller.desired_N"), "desired")
            strut = Line(times(1e-3, "plant:car.strut_N"), "strut", COLOURS[label], 1.0)
            draw_lines(force, (wanted, strut), x)
            mm = times(1e3, "plant:car.spool_m")
            draw_lines(valve, [Line(mm, "", COLOURS[label], 1.0)], x)
            metrics = runs[label, road].metrics
            text = f"{NAMES[label]}, {road} rad/s\nerror {metrics['force_error_rms_N']:.0f} N rms, "
            text += f"correlation {metrics['force_correlation']:.2f}"
            force.set_title(text, fontsize=9, loc="left")
    for column in axes.T:
        for row in (0, 1):  # PID and FL on the same scale
            ends = [ax.get_ylim() for ax in column[row::2]]
            for ax in column[row::2]:
                ax.set_ylim(min(e[0] for e in ends), max(e[1] for e in ends))
    name_rows(axes, ("force [kN]", "spool [mm]") * 2, "time [s]")
    place: dict[str, Any] = {"bbox_to_anchor": (1.03, 1.08), "borderaxespad": 0.0}
    for ax in axes[::2, 0]:
        ax.legend(frameon=False, fontsize=8, ncols=2, loc="lower right", **place)
    title = "Force loop: PID above, fuzzy backstepping below; one scale a column"
    _finish(figure, axes, title, path)


def _bars(runs: Runs, path: Path) -> None:
    """Draw rms speed and acceleration of all struts on all roads."""
    figure, axes = sheet((12.0, 6.5), 110, 2, len(ROADS), sharex="col")
    for row, metric, form in (
        (0, "speed_rms_m_s", "{:.4f}"),
        (1, "acceleration_rms_m_s2", "{:.2f}"),
    ):
        for ax, road in zip(axes[row], ROADS, strict=True):
            values = [runs[label, road].metrics[metric] for label in NAMES]
            colours = [COLOURS[label] for label in NAMES]
            bars = ax.bar(range(len(NAMES)), values, color=colours, label=[*NAMES.values()])
            ax.bar_label(bars, [form.format(v) for v in values], fontsize=7.5, padding=1)
            ax.set_xticks([])
            ax.margins(y=0.12)
            if row == 0:
                ax.set_title(f"{road} rad/s", fontsize=10)
    name_rows(axes, ("body speed, rms [m/s]", "body acceleration, rms [m/s²]"))
    legend_below(figure, axes[0, 0], 4)
    _finish(figure, axes, "Every strut on every road, 3 to 6 s", path)


def _kicked(result: CaseResult) -> str:
    """Return what a kicked body does."""
    metrics = result.metrics
    text = f"{NAMES[result.case.controller]}: {metrics['speed_rms_m_s']:.2g} m/s rms from 3 s on"
    if "oscillation_rad_s" in metrics:
        text += f", at {metrics['oscillation_rad_s']:.1f} rad/s"
    return text


def _kick(results: Sequence[CaseResult], path: Path) -> None:
    """Draw the kicked body with PID in the left column, fuzzy backstepping in the right."""
    kicks = by_label(results, "kick")
    panels = [
        Panel(label, [Line(times(scale, source), "", "", 0.9)])
        for label, scale, source in (
            ("body speed [m/s]", 1.0, "plant:car.body_rate_m_s"),
            ("force error [kN]", 1e-3, "executive:controller.ef_N"),
            ("spool [mm]", 1e3, "plant:car.spool_m"),
        )
    ]
    figure, axes = columns(
        [kicks["pid"], kicks["fl"]], panels, (None,) * 3, (11.0, 7.0), _kicked, COLOURS, left=10.0,
        dpi=110, sharey="row",
    )  # fmt: skip
    _finish(figure, axes, "Flat road, the body kicked with 0.05 m/s", path)


def _responses(car: Mapping[str, float], gains: Mapping[str, float], path: Path) -> None:
    """Draw the linear responses with their invariant point."""
    figure, axes = sheet((9.0, 5.5), 110, 1, 1, squeeze=False)
    ax, w = axes[0, 0], np.geomspace(1.0, 500.0, 1500)
    for law, colour, style, label in (
        ("passive", BLACK, "-", "passive, Bs and Ks at all frequencies"),
        ("filtered", BLUE, ":", "filtered: Bs below, Ks above the wheel's frequency"),
        ("full", VERMILION, "--", "filtered, with skyhook and ride height"),
    ):
        gain = bode.response_db(law, w, car, gains)
        ax.semilogx(w, gain, color=colour, linestyle=style, linewidth=1.4, label=label)
    w0 = float(np.sqrt(car["kt_N_m"] / car["mu_kg"]))
    gain_db = float(bode.response_db("passive", np.array([w0]), car, gains)[0])
    ax.plot([w0], [gain_db], "o", color=GREEN, zorder=5)
    text = f"{gain_db:.2f} dB at {w0:.2f} rad/s,\nwhatever the strut does"
    arrow = {"arrowstyle": "-", "color": GREY}
    ax.annotate(text, (w0, gain_db), (9.0, 54.0), fontsize=9, arrowprops=arrow)
    for road in ROADS:
        ax.axvline(road, color=GREY, linewidth=0.7, linestyle="-.")
        ax.text(road * 1.03, 63.5, f"{road}", color=GREY, fontsize=8)
    ax.set(xlabel="road frequency [rad/s]", xlim=(1.0, 500.0), ylim=(0.0, 66.0))
    ax.set_ylabel("body acceleration per road [dB re 1/s²]")
    ax.legend(framealpha=1.0, edgecolor="white", fontsize=9, loc="lower center")
    _finish(figure, axes, "Linear quarter car: no friction, no stops, ideal strut", path)


def _finish(figure: Any, axes: Any, title: str, path: Path) -> None:
    dress(axes.flat, 8, below=True)
    save(figure, path, title)
