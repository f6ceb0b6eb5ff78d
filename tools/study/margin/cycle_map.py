"""One cycle of all nodes as a map of their variables: the compiled steps of the blocks, wired.

    executive   inputs, steps, what is sent;  then the plant, then a local node
    carried     as it is: no code of a frame, no counter, no limit, no rate, every frame every cycle

The order is that of `executive.loop.exchange`, so the sample of delay is the same. Blocks of the
executive without an input (references) stand still, their outputs held, unless it is in motion.
"""

from dataclasses import dataclass

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.states import HEARTBEATS, State
from pcpc.executive.loop.variables import GAIN, NMT, STATE, T_S
from pcpc.executive.nodes.fmus import step_of
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.rig.roles import PLANTS, Role
from pcpc.executive.rig.schema import FALLBACK
from pcpc.tools.study.arrays import Flags, Places, Vector
from pcpc.tools.study.margin.loops import Loop

_ORDER: tuple[Role, ...] = ("executive", *PLANTS, "local")
_KEPT = ("state", "received", "sent", "output")  # kinds of what a cycle begins with


@dataclass
class _Step:
    """A block's step with its wiring."""

    block: object
    sources: Places
    targets: Places
    views: tuple[slice, slice, slice, slice]
    held: bool


class CycleMap:
    """The tables of all nodes, side by side in `v`; `advance` does a cycle."""

    def __init__(self, plans: dict[Role, Plan], moving: bool = False) -> None:
        """Take the plans of a rig, `moving` with its references; UserError without a step."""
        self.plans, self._moving = plans, moving
        self.roles = [role for role in _ORDER if role in plans]
        sizes = [len(plans[role].table.variables) for role in self.roles]
        self.first = dict(zip(self.roles, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))
        self.v: Vector = np.zeros(sum(sizes))
        self.dt = 1.0 / plans["executive"].rig.config.rate_hz
        self.k = 0
        self._steps = {role: self._steps_of(role) for role in self.roles}
        self._sent = {role: self._pairs(role, sh.MAX_BLOCKS) for role in self.roles}
        self._carried = {role: self._carry(role) for role in self.roles}
        for role in self.roles:
            first = self.first[role]
            for place, value in plans[role].values.items():
                self.v[first + place] = value
            self.v[first + STATE], self.v[first + GAIN] = State.RUN, 1.0
            self.v[first + NMT] = HEARTBEATS[State.RUN]

    def place(self, role: Role, name: str) -> int:
        """Return where a variable of a node stands in `v`."""
        return self.first[role] + self.plans[role].table.index[name]

    @property
    def names(self) -> list[str]:
        """Names in the order of `v`, those of other nodes than the executive as NODE:NAME."""
        return [
            name if role == "executive" else f"{role}:{name}"
            for role in self.roles for name in self.plans[role].names
        ]  # fmt: skip

    def kept(self) -> Places:
        """Return the places of what a cycle may take over from the one before."""
        kinds = [v.kind for role in self.roles for v in self.plans[role].table.variables]
        return np.flatnonzero([kind in _KEPT for kind in kinds])

    def memories(self, role: Role) -> set[str]:
        """Return the names of the states of a node's blocks."""
        return self._of_kind(role, "state")

    def received(self, role: Role) -> set[str]:
        """Return the names of what a node receives from others."""
        return self._of_kind(role, "received")

    def _of_kind(self, role: Role, kind: str) -> set[str]:
        first, variables = self.first[role], self.plans[role].table.variables
        names = self.names[first : first + len(variables)]
        return {name for name, one in zip(names, variables, strict=True) if one.kind == kind}

    def own(self, flagged: Flags) -> int:
        """Return the first place of those: a block's state before what only follows from one."""
        kinds = [v.kind for role in self.roles for v in self.plans[role].table.variables]
        order = [np.array([kind == own for kind in kinds]) & flagged for own in _KEPT]
        return next(
            (int(np.argmax(found)) for found in order if found.any()), int(np.argmax(flagged))
        )

    def cut_places(self, loop: Loop) -> list[int]:
        """Return the places behind the cut of a loop: what is sent, and where it is received."""
        received = [self.place(role, f"rx.{loop.signal}") for role in loop.takers]
        return [*received, self.place(loop.role, loop.sent)]

    def begin(self, held: dict[str, float]) -> None:
        """Sample the plant at t = 0; `held`: outputs of the references."""
        for name, value in held.items():
            self.v[self.place("executive", name)] = value
        for role in self.roles[:0:-1]:
            self._node(role, 0)
        self.k = 0

    def advance(self, cut: Loop | None = None, given: float = 0.0) -> None:
        """Do cycle k of the executive, then k + 1 of the nodes below it.

        `cut`: a loop whose commands get lost; `given` comes in their place.
        """
        for role in self.roles:
            self._node(role, self.k if role == "executive" else self.k + 1)
            if cut is not None and cut.role == role:
                self.v[self.cut_places(cut)] = given
        self.k += 1

    def advance_added(self, loop: Loop, added: float) -> float:
        """Do a cycle, something added to what a loop sends; return what was sent."""
        sent = 0.0
        for role in self.roles:
            self._node(role, self.k if role == "executive" else self.k + 1)
            if loop.role == role:
                self.v[self.cut_places(loop)] += added
                sent = float(self.v[self.place(role, loop.sent)])
        self.k += 1
        return sent

    def _node(self, role: Role, k: int) -> None:
        v, t = self.v, k * self.dt
        v[self.first[role] + T_S] = t
        for one in self._steps[role]:
            v[one.targets] = v[one.sources]
            if not one.held:
                p, x, u, y = one.views
                one.block(t, self.dt, v[p], v[x], v[u], v[y])  # type: ignore[operator]
        for sources, targets in (self._sent[role], self._carried[role]):
            v[targets] = v[sources]

    def _steps_of(self, role: Role) -> list[_Step]:
        made, first, found = self.plans[role], self.first[role], []
        for b, (spec, views) in enumerate(zip(made.spec.blocks, made.views, strict=True)):
            if spec.name == FALLBACK:
                continue
            if step_of(spec):
                what = "is an FMU, of which no step can be repeated; --method measured can do it"
                raise UserError(f"{spec.where()}: {spec.name} {what}")
            ranges = (views.parameters, views.states, views.inputs, views.outputs)
            cut = tuple(slice(first + r.start, first + r.stop) for r in ranges)
            sources, targets = self._pairs(role, b)
            held = role == "executive" and not spec.block.inputs and not self._moving
            found.append(_Step(spec.block.step, sources, targets, cut, held))  # type: ignore[arg-type]
        return found

    def _pairs(self, role: Role, b: int) -> tuple[Places, Places]:
        pairs = np.array(self.plans[role].copies[b], np.int64).reshape(-1, 2) + self.first[role]
        return pairs[:, 0], pairs[:, 1]

    def _carry(self, role: Role) -> tuple[Places, Places]:
        """Return where sent signals come from and go to."""
        pairs = [
            (self.first[role] + place, self.place(other, f"rx.{name[3:]}"))
            for name, place in self.plans[role].table.index.items() if name.startswith("tx.")
            for other in self.roles
            if other != role and f"rx.{name[3:]}" in self.plans[other].table.index
        ]  # fmt: skip
        both = np.array(pairs, np.int64).reshape(-1, 2)
        return both[:, 0], both[:, 1]
