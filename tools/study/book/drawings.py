"""`pcpc experiment drawings`: each plant at a few instants of a run, as its drawing.py says.

figures/PLANT.png is figures/drawing.png of that plant's README. Its scenes are named in the file,
so that a test sees whether the picture is still what the plant's drawing makes of the run.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcpc import plants
from pcpc.drivers.errors import Exit
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.drawing import Drawing, load, settings_of
from pcpc.plants.judging import Judged
from pcpc.plants.scene import Scene
from pcpc.tools.terminal.progress import Progress

WIDE_IN, TITLE_IN, DPI = 12.0, 0.25, 80
KEY = "Description"  # of a PNG's text


def run(folder: Path, progress: Progress, jobs: int | None) -> int:
    """Write a picture of each plant that says of which run; return 0."""
    (folder / "figures").mkdir()
    names = []
    for file in sorted(Path(plants.__file__).parent.glob("*/drawing.py")):
        made = load(file)
        if made.figure is not None:
            progress.show(f"drawings: {file.parent.name}")
            names.append(f"figures/{file.parent.name}.png")
            draw(moments(made), made.figure.at_s, made.figure.columns, folder / names[-1])
    pictures = "\n\n".join(f"![{name}]({name})" for name in names)
    (folder / "results.md").write_text(f"# Plants at work\n\n{pictures}\n")
    progress.close()
    return Exit.OK


def moments(made: Drawing) -> list[Scene]:
    """Return the scenes of a drawing's own figure, of its run in virtual time."""
    assert made.figure is not None, "it has one"
    end = f"duration_s={max(made.figure.at_s) + 0.1!r}"
    rig = load_rig(made.file.parent / made.figure.rig, settings=[end])
    own = Judged(in_memory(rig), 1.0 / rig.config.rate_hz).run()
    columns, p = made.columns(own), settings_of(rig)
    rows = [int(np.argmin(np.abs(own.t_s - t))) for t in made.figure.at_s]
    return [made.scene({name: v[row] for name, v in columns.items()}, p) for row in rows]


def draw(scenes: Sequence[Scene], at_s: Sequence[float], columns: int, path: Path) -> None:
    """Write scenes side by side, each with its time."""
    from matplotlib.figure import Figure

    x0, y0, x1, y1 = scenes[0].bounds
    rows = -(-len(scenes) // columns)
    high = WIDE_IN / columns * (y1 - y0) / (x1 - x0) + TITLE_IN
    page = Figure(figsize=(WIDE_IN, rows * high), layout="constrained")
    axes = page.subplots(rows, columns, squeeze=False)
    for ax, scene, t in zip(axes.flat, scenes, at_s, strict=True):
        scene.paint(ax)
        ax.set_title(f"t = {t:g} s", fontsize=9)
    page.savefig(path, dpi=DPI, metadata={KEY: scene_hash(scenes)})


def scene_hash(scenes: Sequence[Scene]) -> str:
    """Return what stands for scenes: a hash of what they say."""
    told = json.dumps([scene.json() for scene in scenes])
    return hashlib.sha256(told.encode()).hexdigest()
