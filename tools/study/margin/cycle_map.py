"""One cycle of all nodes as a map of their variables: the compiled steps of the blocks, wired.

    executive   inputs, steps, what is sent;  then the plant, then a local node
    carried     as it is: no code of a frame, no counter, no limit, no rate, every frame every cycle

The order is that of `executive.loop.exchange`, so the sample of delay is the same. Blocks of the
executive without an input (references) stand still, their outputs held, unless it is in motion.
"""

from collections.abc import Callable

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.states import HEARTBEATS, State
from pcpc.executive.loop.variables import GAIN, NMT, STATE, T_S
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.rig.roles import PLANTS, Role
from pcpc.executive.rig.schema import FALLBACK
from pcpc.tools.study.arrays import Flags, Places, Vector
from pcpc.tools.study.margin.loops import CutLoop

_ORDER: tuple[Role, ...] = ("executive", *PLANTS, "local")
_KEPT = ("state", "received", "sent", "output")  # kinds of what a cycle begins with


_Wires = tuple[Places, Places]  # from where, to where
_Step = tuple[_Wires, Callable[..., None], list[Vector]]  # of a block: inputs, step, its p, x, u, y


class CycleMap:
    """The tables of all nodes, side by side in `v`; `advance` does a cycle.

    `names` and `kinds` in the order of `v`, names of other nodes than the executive as NODE:NAME;
    `index` of the names; `kept`: the places of what a cycle may take over from the one before.
    """

    def __init__(self, plans: dict[Role, Plan], moving: bool = False) -> None:
        """Take the plans of a rig, `moving` with its references; UserError without a step."""
        self.plans, self._moving = plans, moving
        self.roles = [role for role in _ORDER if role in plans]
        self.first, self.names, kinds = dict[Role, int](), list[str](), list[str]()
        for role in self.roles:
            self.first[role], before = len(self.names), "" if role == "executive" else f"{role}:"
            self.names += [before + name for name in plans[role].names]
            kinds += [one.kind for one in plans[role].table.variables]
        self.index = {name: place for place, name in enumerate(self.names)}
        self.kinds = np.array(kinds)
        self.kept = np.flatnonzero(np.isin(self.kinds, _KEPT))
        self.v: Vector = np.zeros(len(kinds))
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

    def of_kind(self, role: Role, kind: str) -> set[str]:
        """Return the names of a node's variables of a kind, as state, received."""
        first = self.first[role]
        places = range(first, first + len(self.plans[role].names))
        return {self.names[place] for place in places if self.kinds[place] == kind}

    def own(self, flagged: Flags) -> int:
        """Return the first place of those: a block's state before what only follows from one."""
        order = [*(flagged & (self.kinds == kind) for kind in _KEPT), flagged]
        return next(int(np.argmax(found)) for found in order if found.any())

    def cut_places(self, loop: CutLoop) -> list[int]:
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

    def advance(self, cut: CutLoop | None = None, given: float = 0.0, added: bool = False) -> None:
        """Do cycle k of the executive, then k + 1 of the nodes below it.

        `cut`: a loop whose commands get lost, and `given` comes in their place, or is `added`.
        """
        for role in self.roles:
            self._node(role, self.k if role == "executive" else self.k + 1)
            if cut is not None and cut.role == role:
                places = self.cut_places(cut)
                self.v[places] = self.v[places] + given if added else given
        self.k += 1

    def _node(self, role: Role, k: int) -> None:
        v, t = self.v, k * self.dt
        v[self.first[role] + T_S] = t
        for (sources, targets), step, views in self._steps[role]:
            v[targets] = v[sources]
            step(t, self.dt, *views)
        for sources, targets in (self._sent[role], self._carried[role]):
            v[targets] = v[sources]

    def _steps_of(self, role: Role) -> list[_Step]:
        made, first, found = self.plans[role], self.first[role], list[_Step]()
        for b, (spec, views) in enumerate(zip(made.spec.blocks, made.views, strict=True)):
            if spec.name == FALLBACK:
                continue
            if spec.is_opaque:
                what = "is an FMU, of which no step can be repeated; --method measured can do it"
                raise UserError(f"{spec.where()}: {spec.name} {what}")
            if self._moving or role != "executive" or spec.block.inputs:
                ranges = (views.parameters, views.states, views.inputs, views.outputs)
                own = [self.v[first + one.start : first + one.stop] for one in ranges]
                found.append((self._pairs(role, b), spec.block.step, own))
        return found

    def _pairs(self, role: Role, b: int) -> _Wires:
        pairs = np.array(self.plans[role].copies[b], np.int64).reshape(-1, 2) + self.first[role]
        return pairs[:, 0], pairs[:, 1]

    def _carry(self, role: Role) -> _Wires:
        """Return where sent signals come from and go to."""
        pairs = [
            (self.first[role] + place, self.place(other, f"rx.{name[3:]}"))
            for name, place in self.plans[role].table.index.items()
            if name.startswith("tx.")
            for other in self.roles
            if other != role and f"rx.{name[3:]}" in self.plans[other].table.index
        ]
        both = np.array(pairs, np.int64).reshape(-1, 2)
        return both[:, 0], both[:, 1]
