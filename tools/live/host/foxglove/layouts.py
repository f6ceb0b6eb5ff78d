"""A layout for Foxglove and Lichtblick, made of the `layout.json` with which the page begins.

Both read the same file. A message path is a topic and a field of its schema, as live data and logs
have them: `plant:barrel.theta_rad` is /plant/state.barrel_theta_rad.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import UserError
from pcpc.executive.log import reader as logs
from pcpc.executive.log.schemas import field_names
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.plants.pages import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION
from pcpc.tools.live.host.foxglove.names import LOG_TOPIC
from pcpc.tools.live.host.plant_drawing import LAYOUT
from pcpc.tools.live.host.sources import full
from pcpc.tools.start import rigs

COLOURS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, BLACK)
_SHARE = 65  # percent of the width for curves
_FIRST = 4  # curves of a rig whose plant has no layout


def of_rig(name: str) -> tuple[dict[str, Any], list[str]]:
    """Return the layout of a rig, by name or path, and what was left out, as it is not recorded.

    RigError; UserError: its plant's layout cannot be read.
    """
    rig = load_rig(rigs.find(name))
    places = _places(rig)
    window_s, panels = _panels(rig, places)
    wanted = dict.fromkeys(one for panel in panels for one in panel["names"])
    recorded_panels = [
        panel | {"names": names}
        for panel in panels
        if (names := [one for one in panel["names"] if one in places])
        and (panel["kind"] != "phase" or len(names) == 2)
    ]
    return of_panels(recorded_panels, places, window_s), [
        one for one in wanted if one not in places
    ]


def _places(rig: Rig) -> dict[str, tuple[str, str]]:
    """Return the message path and unit of what a rig records, by the names of the page."""
    places = {}
    for role in sorted(rig.roles, key=lambda role: role != "executive"):
        made = plan(rig, role, "virtual")
        for kind in ("state", "timing"):
            columns = made.columns(timing=kind == "timing")
            names = [made.names[place] for place in columns]
            units = [made.table.variables[place].unit for place in columns]
            topic = logs.topic(role, kind)
            for name, field, unit in zip(names, field_names(names), units, strict=True):
                places[full(role, name)] = f"{topic}.{field}", unit
    return places


def _panels(rig: Rig, places: Iterable[str]) -> tuple[float, list[dict[str, Any]]]:
    """Return the page's window in s and panels, of the layout beside the evaluation or the rig."""
    beside = Path(rig.evaluation.file) if rig.evaluation else rig.path
    path = beside.with_name(LAYOUT)
    if not path.is_file():
        names = [name for name in places if name.startswith("controller.")][:_FIRST]
        return 5.0, [{"kind": "time", "names": names}]
    try:
        wanted = json.loads(path.read_text("utf-8"))
        panels = [
            {"kind": str(p["kind"]), "names": [*map(str, p["names"])]} for p in wanted["panels"]
        ]
        return float(wanted["window_s"]), panels
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path}: no layout: {error}") from None


def of_panels(
    panels: Sequence[Mapping[str, Any]], places: Mapping[str, tuple[str, str]], window_s: float
) -> dict[str, Any]:
    """Return a layout with these panels of the page, and states, parameters and what is told."""
    plots = {f"Plot!{i}": _plot(panel, places, window_s) for i, panel in enumerate(panels, 1)}
    supervisor = ("supervisor.state", "supervisor.fault")
    states = {
        name: path for name, (path, _) in places.items() if name.rpartition(":")[2] in supervisor
    }
    beside = {
        "StateTransitions!states": {
            "foxglovePanelTitle": "states",
            "isSynced": True,
            "paths": [
                {"value": path, "label": name, "timestampMethod": "receiveTime"}
                for name, path in states.items()
            ],
        },
        "Parameters!all": {"foxglovePanelTitle": "parameters"},
        "RosOut!log": {"foxglovePanelTitle": "events", "topicToRender": LOG_TOPIC},
    }
    return {
        "configById": plots | beside,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row", "splitPercentage": _SHARE,
            "first": _column([*plots]), "second": _column([*beside]),
        },
    }  # fmt: skip


def _plot(
    panel: Mapping[str, Any], places: Mapping[str, tuple[str, str]], window_s: float
) -> dict[str, Any]:
    """Return the configuration of a plot over time, or of one variable over another."""
    names = panel["names"]
    phase = panel["kind"] == "phase"
    drawn = names[1:] if phase else names
    units = dict.fromkeys(places[name][1] or "1" for name in drawn)
    title = f"{', '.join(drawn) if phase else names[0].rpartition(':')[2]} [{', '.join(units)}]"
    return {
        "foxglovePanelTitle": title,
        "paths": [
            {
                "value": places[name][0], "label": name, "enabled": True,
                "color": COLOURS[i % len(COLOURS)], "timestampMethod": "receiveTime",
            }
            for i, name in enumerate(drawn)
        ],
        "showXAxisLabels": True, "showYAxisLabels": True,
        "showLegend": True, "legendDisplay": "floating", "showPlotValuesInLegend": False,
        "isSynced": not phase, "sidebarDimension": 240,
    } | (
        {"xAxisVal": "custom", "xAxisPath": {"value": places[names[0]][0], "enabled": True}}
        if phase else {"xAxisVal": "timestamp", "followingViewWidth": window_s}
    )  # fmt: skip


def _column(names: Sequence[str]) -> Any:
    """Return panels above each other, all as high."""
    if len(names) == 1:
        return names[0]
    return {
        "direction": "column", "splitPercentage": 100 / len(names),
        "first": names[0], "second": _column(names[1:]),
    }  # fmt: skip
