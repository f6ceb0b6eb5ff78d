"""`pcpc save|load|undo`: the parameters of a running node in a file, taken from one, taken back.

    controller.kv_Nms_rad: 121.5       what `save` writes: YAML, a comment with help, unit and range
    pcpc load FILE                     all at once, or none
    pcpc run RIG --set @FILE           the rig takes the values over

The history that `undo` goes back in is the node's own: its ring of events holds who set what, and
its description what the rig gave, so all hosts see the same. A state is what the tuned parameters
were after a cycle with tunings; one that returns to an earlier state takes back what was between.
"""

import math
import shlex
from collections.abc import Iterator, Mapping
from itertools import groupby
from typing import Any

import numpy as np

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.ring_layout import OfEvent
from pcpc.executive.nodes.live import Live, known_name
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.executive.rig import yamlfile
from pcpc.tools.live.commands import LoadRequest, SaveRequest, UndoRequest
from pcpc.tools.live.local_nodes import Nodes
from pcpc.tools.live.variables import tune
from pcpc.tools.start import rigs
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.outfile import new_file

State = dict[str, float]


def command(request: SaveRequest | LoadRequest | UndoRequest) -> int:
    """Run one of the three."""
    if isinstance(request, SaveRequest):
        _save(request)
    elif isinstance(request, LoadRequest):
        _load(request)
    else:
        live = Nodes().chosen(request.node)
        tune(live, undo_changes(live, request.count), request.json)
    return Exit.OK


# History


def states(live: Live) -> list[State]:
    """Return the states of a node's tuned parameters, the present one last.

    A value that the ring of events no longer tells is missing. LiveError: it does not tell the
    present ones.
    """
    rows, first = live.rows("event", 0)
    is_whole = first == 0 and not live.block.ends("event").dropped
    rows = rows[rows[:, OfEvent.CODE] == Event.TUNING]
    names, blocks = list(live.variables), set(live.block.description.get("blocks", ()))
    given = live.block.description.get("initial", {}) if is_whole else {}
    state: State = {
        name: given[name] for at in rows[:, OfEvent.ARGUMENT] if (name := names[at]) in given
    }
    history = [state]
    for _, group in groupby(rows, key=lambda row: row[OfEvent.CYCLE]):
        state = dict(state)
        for row in group:
            name = names[row[OfEvent.ARGUMENT]]
            if name.partition(".")[0] in blocks:  # faults, resets and stops are no tunings
                state[name] = float(row[OfEvent.BITS :].view(np.float64)[0])
        if state in history:
            del history[history.index(state) + 1 :]
        else:
            history.append(state)
    return history


def undo_changes(live: Live, count: int = 1) -> State:
    """Return what to tune so that the parameters are as before the last `count` tunings.

    LiveError: there are not so many, or the node no longer tells them.
    """
    values, path = live.read(), states(live)
    steps = len(path) - 1
    if any(values[name] != value for name, value in path[-1].items()):
        raise LiveError(f"{live.name}: its events no longer hold all tunings")
    if count > steps:
        what = f"tunings that can be undone: {steps}" if steps else "nothing was tuned"
        raise LiveError(f"{live.name}: {what}")
    now, then = path[-1], path[-1 - count]
    if missing := [name for name in now if name not in then]:
        raise LiveError(f"{missing[0]}: its previous value is no longer known; the log has it")
    return {name: then[name] for name in now if now[name] != then[name]}


# Files


def _save(request: SaveRequest) -> None:
    live = Nodes().chosen(request.node)
    values, settings = live.read(), _settings(live.block.description)
    initial = live.block.description.get("initial", {})
    chosen = [
        name
        for name in initial
        if values[name] != initial[name] or (request.all and name in settings)
    ]
    rig, file = live.block.description, str(request.file)
    lines = [
        f"# {live.name}, cycle {values.cycle}, controller {rig['metadata']['controller']}",
        f"# in a running node: pcpc load {shlex.quote(file)}",
        f"# in a new run: pcpc run {rigs.shell_name(rig.get('file', rig['rig']))} "
        f"--set {shlex.quote(f'@{file}')}",
    ]
    for name in chosen:
        one = live.variables[name]
        low, high = one.range or (-math.inf, math.inf)
        comment = f"{' '.join(one.help.split())}; {low:.9g}..{high:.9g} {one.unit}".rstrip()
        comment += f"; rig {initial[name]:.9g}" if values[name] != initial[name] else ""
        comment += "" if name in settings else "; computed by its law: only `load` takes it"
        lines += ["", *screen.wrapped_lines(comment, "# "), f"{name}: {values[name]!r}"]
    with new_file(request.file, request.force) as path:
        path.write_text("\n".join([*lines, *([] if chosen else ["{}"])]) + "\n", "utf-8")
    changed = sum(values[name] != initial[name] for name in chosen)
    many = "parameter" if len(chosen) == 1 else "parameters"
    print(f"{request.file}: {len(chosen)} {many} of {live.name}, {changed} changed")


def _settings(description: Mapping[str, Any]) -> set[str]:
    """Return the parameters of blocks that a rig gives, others are computed; UserError."""
    try:
        data = yamlfile.load("rig.yaml", description["attachments"]["rig-resolved.yaml"]).data
        laws = data["controllers"]
        blocks = data[description["node"]]["blocks"] | {"controller": laws[data["controller"]]}
        blocks |= {name: laws[name] for name in data["standby"]}
        names = {f"{block}.{name}" for block, one in blocks.items() for name in one["parameters"]}
        return names | {f"handover.{name}" for name in data["handover"]}
    except (KeyError, TypeError, AttributeError):
        what = f"{description['name']}: sent no valid description of its rig; what answers there?"
        raise UserError(what, Exit.ENVIRONMENT) from None


def _load(request: LoadRequest) -> None:
    if not request.file:
        raise UserError("'' is not a file; give one that `pcpc save` has written")
    document = yamlfile.load(request.file)
    there = Nodes()
    nodes = [there.find(request.node)] if request.node else list(there.running().values())
    names = [name for name in document.data if any(name in one.variables for one in nodes)]
    live = there.chosen(request.node, names)
    changes = dict(_changes(document, live))
    before = live.read()
    if changes := {name: value for name, value in changes.items() if before[name] != value}:
        tune(live, changes, request.json)
    else:
        told = {"cycle": before.cycle, "values": {}, "before": {}}
        screen.answer(request.json, told, [f"{live.name}: already has these values"])


def _changes(document: yamlfile.Document, live: Live) -> Iterator[tuple[str, float]]:
    """Yield name and value of all entries; UserError with file and line."""
    for name, value in document.data.items():
        place = document.where((name,))
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise UserError(f"{place}: {name}: expected a number, got {value!r}")
        try:
            live.check({known_name(name, live.variables): float(value)})
        except LiveError as error:
            raise UserError(f"{place}: {error}") from None
        yield name, float(value)
