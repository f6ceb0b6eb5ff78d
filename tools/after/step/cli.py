"""`pcpc replay LOG --cycle N`: a cycle of each node, from the frames that came to those it sent.

    in       frames that the node took, with the result of their check, and what they said last
    blocks   in the order in which they are stepped: inputs, states, outputs
    out      what was sent, behind the limits, and the frames that carried it

All values are those at the end of the cycle, recomputed; those that were recorded are compared to
the bit. Clock readings stand in `pcpc log export -o -`.
"""

import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct

from pcpc.drivers.can.e2e_states import name_of
from pcpc.drivers.errors import BusError, Exit, UserError
from pcpc.executive.log import reader as logs
from pcpc.executive.loop.table import Variable
from pcpc.tools.after.commands import ReplayRequest
from pcpc.tools.after.log.frames import frame_text
from pcpc.tools.after.opened import Opened
from pcpc.tools.after.replay import NodeComparison, recomputed_pieces
from pcpc.tools.after.span import chosen_variables, cycle_of, variables_of
from pcpc.tools.after.step.commands import OneCycle
from pcpc.tools.after.trust import Trust
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.answer import Count, NodeName, Number, VariableName
from pcpc.tools.terminal.progress import Progress

_ORDER = "piso"  # initials of parameter, input, state, output
_KINDS = {"parameter": "set", "input": "in", "state": "state", "output": "out"}


def command(path: Path, request: ReplayRequest) -> int:
    """Recompute up to the cycle, then print it. UserError: wrong input."""
    run, asked = Opened(path, Trust.of(request.code)), request.beside.of(OneCycle)
    head = run.head
    cycle, progress = cycle_of(head, asked.cycle, asked.time), Progress(request.quiet)
    roles = [role for role in logs.NODES if role in head.node and request.node in (role, "all")]
    if not roles:
        raise UserError(f"{path}: no record of node {request.node}")
    frames: dict[str, list[Any]] = {role: [] for role in roles}
    try:
        with run.rig() as rig:
            nodes = [NodeComparison(head, rig, role, cycle, seek=cycle) for role in roles]
    except BusError as error:  # the log's DBC, not a bus of this machine
        raise UserError(str(error)) from None
    since_ns = min(node.since_ns for node in nodes)
    for piece in recomputed_pieces(path, nodes, since_ns=since_ns):
        for role in (role for role in roles if role in piece.node):
            own = piece.node[role].frames
            frames[role] += list(own[own["cycle"] == cycle])
        left = cycle + 1 - min(int(node.replay.block.loop.k) for node in nodes)
        progress.show(f"{left} cycles are left to recompute")
    progress.close()
    for node in nodes:
        for note in node.notes:
            print(f"{path}: {note}", file=sys.stderr)
        node.require_end()
    cycles = [CycleState(node, frames[node.role]) for node in nodes]
    known = {one.name: one.kind for each in cycles for one in each.variables}
    names = chosen_variables(known, request.show)
    parts = [one.lines(cycle, names, not request.show) for one in cycles]
    lines = [line for part in parts if len(part) > 1 for line in ("", *part)][1:]
    told: CyclesOfNodes = [one.facts(cycle, names) for one in cycles]
    screen.answer(request.json, told, lines, 1)
    return Exit.OK


class FrameOut(Struct):
    """A frame."""

    name: str
    frame: str
    "as candump writes it"


class FrameIn(FrameOut):
    """A frame that was received."""

    check: str
    "result of its check"


class CycleFacts(Struct):
    """One cycle of a node."""

    node: NodeName
    cycle: Count
    "the node's own"
    t_s: float
    "its time, k T, s"
    received: list[FrameIn]
    sent: list[FrameOut]
    values: dict[VariableName, Number]
    "at the end of the cycle, by name"


CyclesOfNodes = Annotated[list[CycleFacts], Meta(min_length=1)]


class CycleState:
    """What a node has in its table at the end of a cycle, and the frames of that cycle."""

    def __init__(self, node: NodeComparison, frames: Sequence[Any]) -> None:
        made, self.role, self.frames = node.replay.plan, node.role, frames
        self.variables = variables_of(node.replay)
        self.values = {
            v.name: float(node.replay.block.loop.v[made.table.index[v.name]])
            for v in self.variables
        }
        self.blocks = [spec.name for spec in made.spec.blocks]
        self.sources = node.replay.block.description["sources"]
        self.names = node.replay.block.description["frames"]
        self.period_s = 1e-9 * int(node.replay.block.description["period_ns"])

    def stages(self) -> Iterator[tuple[str, list[Variable]]]:
        """Yield the stages in the order of a cycle, with their variables."""
        of: dict[str, list[Variable]] = {}
        for one in self.variables:
            of.setdefault(one.name.partition(".")[0], []).append(one)
        known = {"rx": "signals in", "tx": "signals out"}
        known |= {name: f"block {name}" for name in self.blocks}
        for key in (*(key for key in of if key not in known), "rx", *self.blocks, "tx"):
            if key in of:
                yield known.get(key, key), sorted(of[key], key=lambda one: _ORDER.find(one.kind[0]))

    def taken(self, direction: int) -> list[tuple[str, str, str]]:
        """Return name, bytes and check of the frames received (1) or sent (0)."""
        return [
            (self.names.get(str(int(one["id"])), "?"), frame_text(one), name_of(int(one["e2e"])))
            for one in self.frames
            if one["direction"] == direction
        ]

    def lines(self, cycle: int, chosen: set[str], frames: bool) -> list[str]:
        """Return the text for a terminal; `frames`: with those of the cycle."""
        found = [f"{self.role}, cycle {cycle} ({cycle * self.period_s:.6g} s)"]
        if frames:
            found += [f"  frame in   {' '.join(one)}" for one in self.taken(1)]
        for title, variables in self.stages():
            if rows := [self._row(one) for one in variables if one.name in chosen]:
                found += [title, *screen.table(rows, right=(2,))]
        if frames:
            found += [f"  frame out  {' '.join(one[:2])}" for one in self.taken(0)]
        return found

    def _row(self, one: Variable) -> tuple[str, str, str, str]:
        """Return kind, name, value and unit, and of a limited command what was wanted."""
        value, source = self.values[one.name], self.sources.get(one.name, "")
        wanted = self.values.get(source, value) if one.kind == "sent" else value
        limited = "" if wanted == value or math.isnan(wanted) else f" limited, {wanted:.6g} wanted"
        return f"  {_KINDS.get(one.kind, '')}", one.name, f"{value:.9g}", f"{one.unit}{limited}"

    def facts(self, cycle: int, chosen: set[str]) -> CycleFacts:
        """Return everything for JSON."""
        return CycleFacts(
            node=self.role,
            cycle=cycle,
            t_s=cycle * self.period_s,
            received=[FrameIn(*one) for one in self.taken(1)],
            sent=[FrameOut(*one[:2]) for one in self.taken(0)],
            values={name: self.values[name] for name in self.values if name in chosen},
        )
