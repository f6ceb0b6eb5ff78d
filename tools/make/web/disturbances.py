"""What a reader can do to a rig while it runs, as buttons: of the rig and those beside it.

- an entry of its `schedule`, now
- an event of a block below the executive: what BEGINS and lasts by its parameters X_from_s with
  X_to_s, or X_start_s with X_lasts_s. It begins at the press and is as strong and as long as the
  rig says, else a rig in the same folder; a switch with the event's own name goes to 1
- the values that a rig in the same folder gives the blocks below the executive, and those of the
  rig itself to go back to

Faults on purpose are not there: a rig with them has no page.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import UserError
from pcpc.executive.loop.table import Variable
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import Rig, load_rig

Values = Mapping[str, float]  # by NODE:BLOCK.PORT
MOST_BESIDE = 40  # files that are looked at
MOST_NAMED = 4  # values in the text of a button
_TIMES = re.compile(r"(?P<block>.*\.)(?P<event>[^_.]+)(?P<more>\w*)_(?P<way>from|start)_s")
_ENDS = {"from": "to", "start": "lasts"}


@dataclass(frozen=True)
class _Event:
    """Parameters of one event: `begins` by what ends it, `all` of them, `switch` or ""."""

    name: str
    begins: dict[str, str]
    all: tuple[str, ...]
    switch: str


def disturbances(rig: Rig, settings: list[str]) -> list[dict[str, Any]]:
    """Return the buttons: label, and `set`: [name, value, 1 if it is a time after the press]."""
    own = _parameters(rig)
    mine = {name: value for name, (_, value) in own.items()}
    others = [*_neighbour_rigs(rig, settings, own)]
    events, rigs = [*_events(own)], [mine, *(values for _, values in others)]
    taken = {name for one in events for name in one.all}
    return [
        *_scheduled_settings(rig),
        *filter(None, (_event(one, rigs) for one in events)),
        *_neighbour_changes(rig, own, mine, others, taken),
    ]


def _scheduled_settings(rig: Rig) -> Iterator[dict[str, Any]]:
    for entry in rig.config.schedule:
        words = ", ".join(f"{name} = {value:g}" for name, value in entry.set.items())
        yield {"label": f"{words} now", "set": [[*one, 0] for one in entry.set.items()]}


def _event(event: _Event, rigs: Sequence[Values]) -> dict[str, Any] | None:
    """Return an event as the first rig has it in which it does something."""
    for values in rigs:
        lasting = [begin for begin in event.begins if _length(event, values, begin) > 0.0]
        times = {*event.begins, *event.begins.values(), event.switch}
        strengths = [values[name] for name in event.all if name not in times]
        if lasting and (any(strengths) or not strengths):
            break
    else:
        return None
    first = min(values[begin] for begin in lasting)
    made = {name: [name, values[name], 0] for name in event.all}
    for begin, end in event.begins.items():
        made[begin] = [begin, round(values[begin] - first, 9), 1]
        if end.endswith("_to_s"):
            made[end] = [end, round(values[end] - first, 9), 1]
    if event.switch:
        made[event.switch] = [event.switch, 1.0, 0]
    return {"label": f"{event.name} now", "set": [*made.values()]}


def _length(event: _Event, values: Values, begin: str) -> float:
    """Return how long a part of an event takes."""
    end = event.begins[begin]
    return values[end] - values[begin] if end.endswith("_to_s") else values[end]


def _events(own: Mapping[str, tuple[Variable, float]]) -> Iterator[_Event]:
    """Yield the events of a rig's blocks; the first word of their parameters is their name."""
    begins: dict[tuple[str, str], dict[str, str]] = {}
    for name, (variable, _) in own.items():
        if (told := _TIMES.fullmatch(name)) is None or variable.unit != "s":
            continue
        end = f"{told['block']}{told['event']}{told['more']}_{_ENDS[told['way']]}_s"
        if end in own and own[end][0].unit == "s":
            begins.setdefault((told["block"], told["event"]), {})[name] = end
    for (block, word), pairs in begins.items():
        own_name = f"{block}{word}"
        parts = [name for name in own if name.startswith(f"{own_name}_")]
        switch = ""
        if own_name in own and (own[own_name][0].low, own[own_name][0].high) == (0.0, 1.0):
            switch = own_name
        every = (*([switch] if switch else []), *parts)
        if all(_bounded(own[name][0]) for name in every):
            yield _Event(word, pairs, every, switch)


def _neighbour_changes(
    rig: Rig,
    own: Mapping[str, tuple[Variable, float]],
    mine: Values,
    others: Sequence[tuple[str, Values]],
    taken: set[str],
) -> Iterator[dict[str, Any]]:
    """Yield what other rigs set otherwise, events left out, and the way back."""
    back: dict[str, float] = {}
    seen = list[dict[str, float]]()
    for name, values in others:
        differ = {key: it for key, it in values.items() if it != mine[key] and key not in taken}
        # One that can be had in part only is not that rig.
        if not differ or differ in seen or not all(_bounded(own[key][0]) for key in differ):
            continue
        seen.append(differ)
        back |= {key: mine[key] for key in differ}
        yield {"label": _label(name, differ, own), "set": [[*one, 0] for one in differ.items()]}
    if back:
        title = f"back to {rig.config.rig}"
        yield {"label": title, "set": [[*one, 0] for one in back.items()]}


def _label(
    name: str, values: Mapping[str, float], own: Mapping[str, tuple[Variable, float]]
) -> str:
    """Return the words of a button."""
    words = [
        f"{key.partition('.')[2]} = {value:g} {own[key][0].unit}".rstrip()
        for key, value in values.items()
    ]
    rest = [f"{len(words) - MOST_NAMED} more"] if len(words) > MOST_NAMED else []
    return f"as {name}: {', '.join(words[:MOST_NAMED] + rest)}"


def _neighbour_rigs(
    rig: Rig, settings: list[str], own: Mapping[str, Any]
) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield the rigs in the folder of one that have its blocks, by name."""
    path = Path(rig.path).resolve()
    for file in sorted(path.parent.glob("*.yaml"))[:MOST_BESIDE]:
        if file == path:
            continue
        try:
            other = load_rig(file, rig.config.controller, settings)
            found = _parameters(other) if [*other.roles] == [*rig.roles] else {}
        except UserError:
            continue  # no rig, or none that has the controller and takes the settings
        if found.keys() == own.keys():
            yield other.config.rig, {name: value for name, (_, value) in found.items()}


def _parameters(rig: Rig) -> dict[str, tuple[Variable, float]]:
    """Return the parameters of the blocks below the executive, by NODE:NAME."""
    found: dict[str, tuple[Variable, float]] = {}
    for role in list(rig.roles)[1:]:
        made = plan(rig, role, "lockstep")
        blocks = {spec.name for spec in made.spec.blocks}
        for place, variable in enumerate(made.table.variables):
            if variable.kind == "parameter" and variable.writer in blocks:
                found[f"{role}:{variable.name}"] = variable, made.values.get(place, 0.0)
    return found


def _bounded(variable: Variable) -> bool:
    """Return whether a page can set a parameter."""
    return math.isfinite(variable.high - variable.low)
