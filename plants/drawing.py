"""How a plant is drawn while it moves: the contract of a drawing.py.

    from pcpc.plants.drawing import *       # the shapes, plants/scene.py

    NEEDS = {"angle": "plant:motor.angle_rad", "wanted": "executive:reference.q_d_rad"}
    FIGURE = Figure("rig.yaml", at_s=(0.1, 0.13, 0.2, 0.5))     # of the README; may be left out

    def scene(now, p):
        tip = polar((0.0, 0.0), 1.0, now["angle"])
        return Scene((-1.2, -1.2, 1.2, 1.2), line([(0.0, 0.0), tip], "moving", 4), note="...")

NEEDS   short names, and the variables behind them, as in a log or a live table: `NODE:NAME`, or
        `NAME` alone: the executive's, else that of the node that has it
now     their values at one instant, NaN for what is not known, and `t`, the time in s
p       the settings of the plant's blocks by name, as the rig gives them

A page of `pcpc generate web` has the scene written down with `now` and `p` open: the functions of
`math`, `max`, `min`, `abs` and numpy's operators are; float(p["length_m"]) takes the rig's value.

A rig's drawing is the drawing.py beside its evaluation, or beside the rig file if it has none. The
pages of `pcpc host` and `pcpc generate web`, `pcpc log plot --moving` and the README's figure are
painted from the same scenes.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcpc.executive.errors import RigError
from pcpc.executive.log.reader import Log
from pcpc.executive.own_laws.law_errors import cause
from pcpc.executive.rig.reading import Rig
from pcpc.plants.declared import declared
from pcpc.plants.judging import Run, Vector, effective_rig
from pcpc.plants.scene import (
    Plane,
    Point,
    Scene,
    Shape,
    Shapes,
    area,
    arrow,
    box,
    disc,
    gauge,
    ground,
    line,
    link,
    polar,
    slot,
    spring,
    text,
    turn,
)

__all__ = [  # the vocabulary of a drawing.py, which takes it whole: `import *`
    "Figure", "Now", "Plane", "Point", "Scene", "Settings", "Shape", "Shapes", "area", "arrow",
    "box", "disc", "gauge", "ground", "line", "link", "polar", "slot", "spring", "text", "turn",
]  # fmt: skip

Now = Mapping[str, float]
Settings = Mapping[str, float]


class DrawingError(RigError):
    """A drawing failed: where and why, in one line."""


@dataclass(frozen=True)
class Figure:
    """Of which run, and of which instants of it, the README shows the plant."""

    rig: str  # beside drawing.py
    at_s: Sequence[float]
    columns: int = 4


@dataclass(frozen=True)
class Drawing:
    """A plant's drawing.py."""

    file: Path
    needs: Mapping[str, str]
    figure: Figure | None
    _scene: Callable[[Now, Settings], Scene]

    def scene(self, now: Now, p: Settings) -> Scene:
        """Return the scene of an instant; `now`: values by short name, and `t`. DrawingError."""
        values = {name: float(now.get(name, math.nan)) for name in (*self.needs, "t")}
        values = {name: v if math.isfinite(v) else math.nan for name, v in values.items()}
        absent = [name for name in self.needs if math.isnan(values[name])]
        drawn = self.raw_scene(values, p)
        if absent or drawn.lacks:
            x0, _, x1, y1 = drawn.bounds
            words = f"no data: {', '.join(absent)}" if absent else "no data"
            drawn.add(text((0.5 * (x0 + x1), y1 - 0.04 * drawn.side), words))
        return drawn

    def raw_scene(self, now: Now, p: Settings) -> Scene:
        """Return what the drawing.py makes of values as they are. DrawingError."""
        try:
            drawn = self._scene(now, p)
            if not isinstance(drawn, Scene):
                raise TypeError(f"scene returned {type(drawn).__name__}, expected a Scene")
        except (Exception, SystemExit) as error:
            raise DrawingError(cause(error)) from None
        return drawn

    def columns(self, run: Run) -> dict[str, Vector]:
        """Return the values of a run by short name, a value a cycle, and `t`. Each (n,)."""
        return {name: run.get(source) for name, source in self.needs.items()} | {"t": run.t_s}


def drawing_of(rig: Rig) -> Drawing | None:
    """Return the drawing of a rig, None if it has none; DrawingError. It runs its Python."""
    return None if rig.drawing is None else load(rig.drawing)


def load(file: Path) -> Drawing:
    """Return what a drawing.py says; DrawingError for what is wrong, with its line."""
    module = declared(file, DrawingError)
    needs: Any = getattr(module, "NEEDS", None)
    scene = getattr(module, "scene", None)
    if not callable(scene):
        raise DrawingError(f"{file}: no function scene(now, p)")
    named = isinstance(needs, dict) and all(isinstance(v, str) for kv in needs.items() for v in kv)
    if not named or "t" in needs:
        what = 'expected NEEDS = {"short name": "NODE:NAME", ...}, with any short name but t'
        raise DrawingError(f"{file}: {what}")
    return Drawing(file, needs, getattr(module, "FIGURE", None), scene)


def settings_of(rig: Rig) -> dict[str, float]:
    """Return the settings of a rig's plant, which its scenes are drawn with; RigError."""
    blocks = rig.nodes()["plant"].blocks
    return {name: value for block in blocks for name, value in block.settings.items()}


def settings_of_log(log: Log) -> dict[str, float]:
    """Return the same of a log, which holds them."""
    blocks = effective_rig(log).get("plant", {}).get("blocks", {}).values()
    return {name: value for block in blocks for name, value in block["parameters"].items()}
