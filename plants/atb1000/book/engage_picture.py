"""The README's picture: the rig `engage` in virtual time, for light and for dark pages.

    python -m pcpc.plants.atb1000.book.engage_picture docs/figures

writes engage-light.png and engage-dark.png, with type that is legible at a width of 400 pixels.
"""

import sys
from pathlib import Path

import numpy as np

from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.atb1000.evaluation import EVALUATION
from pcpc.plants.drawing import load, settings_of
from pcpc.plants.judging import Judged, Run
from pcpc.plants.scene import Shape

PLANT = Path(__file__).parents[1]
SWITCH_S = 4.0  # of the rig's schedule
PAPER = {  # background, ink, grid, PD, network
    "light": ("#ffffff", "#1f2328", "#d1d9e0", "#c2410c", "#0969da"),
    "dark": ("#0d1117", "#e6edf3", "#3d444d", "#ff9d5c", "#58a6ff"),
}
FILLED = {"ground": 0.0, "body": 0.25, "moving": 0.6, "magnified": 0.0}  # the roles that are drawn
CURVES = (  # signal, scale, lowest and highest value shown, title
    ("muzzle_error_rad", 1e3, -3.0, 7.0, "muzzle error  [mrad]"),
    ("executive:controller.motor_torque_Nm", 1.0, -0.12, 0.22, "motor moment  [N m]"),
)


def draw(run: Run, barrel: list[Shape], theme: str, path: Path) -> None:
    """Write the picture in the colours of a theme."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Polygon

    back, ink, grid, before, behind = PAPER[theme]
    page = Figure(figsize=(8.0, 7.6), facecolor=back, layout="constrained")
    top, *plots = page.subplots(3, 1, height_ratios=(1.0, 1.4, 1.3))
    for shape in barrel:
        colour, wide = (before, 5.0) if shape.role == "magnified" else (ink, 2.0)
        look = {"facecolor": (ink, FILLED[shape.role]), "edgecolor": colour, "linewidth": wide}
        if shape.kind == "disc":
            top.add_patch(Circle((shape.xy[0], shape.xy[1]), shape.xy[2], **look))
        else:
            top.add_patch(Polygon(shape.points, closed=shape.kind == "area", **look))
    top.set(xlim=(-0.9, 2.7), ylim=(-0.52, 0.36), aspect="equal")
    top.set_axis_off()
    top.text(1.35, 0.03, "barrel,\nbending x 40", color=before, fontsize=22, va="center")
    for ax, (name, scale, low, high, title) in zip(plots, CURVES, strict=True):
        for part, colour in ((run.t_s < SWITCH_S, before), (run.t_s >= SWITCH_S, behind)):
            ax.plot(run.t_s[part], scale * run[name][part], color=colour, linewidth=2.2)
        ax.axvline(SWITCH_S, color=ink, linewidth=2.2, linestyle=(0, (4, 3)))
        ax.set_title(title, loc="left", color=ink, fontsize=24)
        ax.set(facecolor="none", xlim=(0.0, 9.0), ylim=(low, high), xticks=range(0, 10, 2))
        ax.locator_params(axis="y", nbins=4)
        ax.tick_params(colors=ink, labelsize=22, length=0, pad=8)
        ax.grid(color=grid, linewidth=1.0)
        ax.spines[:].set_visible(False)
    plots[0].set_xticklabels([])
    style = {"fontsize": 26, "va": "top"}
    plots[0].text(SWITCH_S - 0.2, 6.6, "PD", color=before, ha="right", **style)
    plots[0].text(SWITCH_S + 0.2, 6.6, "network engaged", color=behind, **style)
    plots[1].set_xlabel("time  [s]", color=ink, fontsize=22)
    page.savefig(path, dpi=100)


def main(folder: Path) -> None:
    """Run the rig once; draw the barrel where it is bent most."""
    rig, made = load_rig(PLANT / "rigs" / "engage.yaml"), load(PLANT / "drawing.py")
    run = Judged(in_memory(rig), 1.0 / rig.config.rate_hz, signals=EVALUATION.signals).run()
    columns = made.columns(run)
    row = int(np.argmax(np.abs(columns["q1"])))
    scene = made.scene({name: values[row] for name, values in columns.items()}, settings_of(rig))
    shapes = [one for one in scene.shapes if one.role in FILLED and one.xy[0] < 0.8]
    for theme in PAPER:
        draw(run, shapes, theme, folder / f"engage-{theme}.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
