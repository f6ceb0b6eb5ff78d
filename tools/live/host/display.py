"""A run or a log as all clients see it that look at it."""

import json
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import UserError
from pcpc.tools.after.trust import ASKED, Trust
from pcpc.tools.live.host.actions import Actions
from pcpc.tools.live.host.commands import PageRequest
from pcpc.tools.live.host.plant_drawing import PlantDrawing, drawing_of
from pcpc.tools.live.host.recordings import recordings_of
from pcpc.tools.live.host.runs import run_of
from pcpc.tools.live.host.sources import FollowedRun, RunSource
from pcpc.tools.live.host.status import Status

MOST_EVENTS = 200


class Display:
    """One of these. `events` are messages with their numbers, rising.

    `files`: what the host has recorded so far, of whatever run.
    """

    def __init__(
        self,
        shown: RunSource | FollowedRun,
        page: PageRequest,
        files: list[Path],
        trust: Trust = ASKED,
    ) -> None:
        self._shown, self._trust = shown, trust
        self.actions = Actions(lambda: self.source, page.write, recordings_of(page, files))
        self.events: list[tuple[int, dict[str, Any]]] = []
        self._count = 0
        self._status = Status()
        self._drawing: PlantDrawing | None = None
        self._drawn = (-1, -1)  # which version

    @property
    def source(self) -> RunSource:
        """The run that is shown now."""
        return self._shown.source if isinstance(self._shown, FollowedRun) else self._shown

    @property
    def run(self) -> str:
        """Its name, "" for none and for a log."""
        nodes = self.source.nodes.values() if self.source.live else ()
        return next((run_of(node.live.name) for node in nodes), "")

    def status(self) -> tuple[dict[str, Any], dict[str, float | None]]:
        """Return what changes beside curves, and the parameters."""
        source = self.source
        if "status" not in source.parts:
            source.parts["status"] = self._status.of(source)
        found: tuple[dict[str, Any], dict[str, float | None]] = source.parts["status"]
        return found

    def scene(self, cycle: int) -> str:
        """Return the message with the drawing of the plant at a cycle, "" without one."""
        parts = self.source.parts
        if ("scene", cycle) not in parts:
            scene = self._scene(cycle)
            parts["scene", cycle] = json.dumps({"scene": scene}, allow_nan=False) if scene else ""
        return str(parts["scene", cycle])

    def _scene(self, cycle: int) -> dict[str, Any]:
        source = self.source
        try:
            if self._drawn != source.version:
                self._drawn, self._drawing = source.version, None  # should it fail, it does so once
                self._drawing = drawing_of(source, self._trust)
            return self._drawing.scene(source, cycle) if self._drawing else {}
        except UserError as error:
            self._drawing = None
            return {"bounds": [0, 0, 1, 1], "note": str(error), "shapes": []}

    def find(self) -> None:
        """Look for nodes that have come or gone."""
        if isinstance(self._shown, FollowedRun):
            self._shown.find()

    def poll(self) -> None:
        """Take what the run has recorded since."""
        self.source.parts.clear()
        if not isinstance(self._shown, FollowedRun):
            return
        for role, cycle, topic, entry in self._shown.poll():
            self._count += 1
            event = {"node": role, "cycle": cycle, "topic": topic, **entry}
            self.events.append((self._count, event))
        del self.events[:-MOST_EVENTS]

    @property
    def records(self) -> bool:
        """Whether a recording of it goes on."""
        return self.actions.recordings.running is not None

    def close(self) -> None:
        """End what is being recorded."""
        self.actions.recordings.close()
