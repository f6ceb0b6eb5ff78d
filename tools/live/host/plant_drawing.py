"""The plant of a run as its drawing.py draws it, for the page: a scene at one cycle."""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.rig import yamlfile
from pcpc.plants import drawing
from pcpc.tools.after.opened import opened
from pcpc.tools.after.trust import Trust
from pcpc.tools.live.host.sources import RunSource

LAYOUT = "layout.json"


class PlantDrawing:
    """A drawing with the settings of the run, and the newest scene of it."""

    def __init__(
        self, declared: drawing.Drawing, settings: Mapping[str, float], source: RunSource
    ) -> None:
        self._drawing, self._settings = declared, settings
        self._places: dict[str, tuple[str, str]] = {}
        for name, wanted in declared.needs.items():
            with suppress(UserError):  # this rig has no such variable: it is drawn as not known
                self._places[name] = source.curve(wanted)
        self._scene: tuple[int, dict[str, Any]] = (-1, {})

    def scene(self, source: RunSource, cycle: int) -> dict[str, Any]:
        """Return the scene of a cycle as plain lists; DrawingError."""
        if self._scene[0] != cycle:
            now = {name: _value(source, place, cycle) for name, place in self._places.items()}
            now["t"] = cycle * source.period_s
            self._scene = cycle, self._drawing.scene(now, self._settings).json()
        return self._scene[1]


def _value(source: RunSource, place: tuple[str, str], cycle: int) -> float:
    """Return a variable at a cycle, or the newest before it within a second; NaN for none."""
    node = source.nodes[place[0]]
    _, values = node.part([place[1]], cycle - round(1.0 / source.period_s), cycle)
    return float(values[-1, 0]) if len(values) else float(np.nan)


def drawing_of(source: RunSource, trust: Trust) -> PlantDrawing | None:
    """Return the drawing of what is shown, None if it has none; DrawingError, LogError.

    It is Python: that of a run of this user is his own; that of a log is the installed one, or with
    `trust.trust` what the log carries.
    """
    if source.log is not None:
        with opened(source.log, trust) as run:
            file, _ = run.drawing()
            made = file and drawing.load(file)
        return PlantDrawing(made, drawing.settings_of_log(source.log), source) if made else None
    for node in source.nodes.values():
        for path in _paths(node.description, "draws"):
            text = node.description["attachments"]["rig-resolved.yaml"]
            return PlantDrawing(drawing.load(path), settings(text), source)
    return None


def _paths(about: Mapping[str, Any], kind: str) -> list[Path]:
    """Return the files of a description that judge or draw, which are there."""
    named = [one for one in about.get("files", ()) if isinstance(one, dict) and one.get(kind)]
    paths = [Path(str(one.get("path", ""))) for one in named]
    return [path for path in paths if path.is_file()]


def layout(source: RunSource) -> Any:
    """Return the panels with which a plant is shown first, or None.

    They are those of the layout.json beside its evaluation or its drawing.
    """
    for about in (node.description for node in source.nodes.values()):
        for path in _paths(about, "judges") + _paths(about, "draws"):
            with suppress(OSError, ValueError):
                return json.loads(path.with_name(LAYOUT).read_text("utf-8"))
    return None


def settings(text: str) -> dict[str, float]:
    """Return the settings of a plant's blocks, as a rig that is written out has them."""
    data = yamlfile.load("rig.yaml", text).data
    blocks = data.get("plant", {}).get("blocks", {}).values()
    return {name: value for block in blocks for name, value in block["parameters"].items()}
