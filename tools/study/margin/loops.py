"""The loops of a rig: each signal that a law commands and a block of another node takes.

A loop is cut where faults of actuators act: at the sent signal, behind the law and before limits
and codec. All others stay closed.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import PLANTS, Role
from pcpc.tools.study.arrays import Complex

_SHARES = (0.02, 0.05, 0.12, 0.3)
_HEAD = ("supervisor", "health", "timing", "time", "rx")


@dataclass(frozen=True)
class CutLoop:
    """A loop by its signal; `takers` are the nodes that receive it, `source` what is sent."""

    signal: str
    role: Role
    source: str
    unit: str
    takers: tuple[Role, ...]
    low: float
    high: float

    @property
    def sent(self) -> str:
        """Its place in the table of the node that sends it."""
        return f"tx.{self.signal}"

    def amplitudes(self) -> list[float]:
        """Return what may be injected, rising: shares of half its range. UserError without one."""
        half = 0.5 * (self.high - self.low)
        if not math.isfinite(half) or half > 1e12:
            what = "has no limits to take a share of; give the size to inject with --amplitude"
            raise UserError(f"{self.signal} {what} [{self.unit or '1'}]")
        return [share * half for share in _SHARES]


@dataclass(frozen=True, kw_only=True)
class OpenLoop:
    """What a loop is at a point, where `command` is sent; it may have poles that are not known.

    `kinks`: states whose two sides differ; `rounded`: the steps of what is rounded inside a block;
    `idle`: memories of the law that the command reaches or that reach it, but not both; `given`:
    all that the command reaches.
    """

    dt: float
    command: float
    kinks: list[str] = field(default_factory=list)
    rounded: dict[str, float] = field(default_factory=dict)
    idle: list[str] = field(default_factory=list)
    given: frozenset[str] = frozenset()

    def poles(self) -> Complex:
        """Return the poles z of the open loop, of those that are known."""
        return np.empty(0, complex)

    def closed(self) -> Complex:
        """Return the poles z of the closed loop, of those that are known."""
        return np.empty(0, complex)


def loops(rig: Rig, plans: dict[Role, Plan]) -> list[CutLoop]:
    """Return the loops of a rig, those to the plant first."""
    found = []
    for role, made in plans.items():
        for signal, source in made.spec.transmit.items():
            takers = tuple(
                other
                for other, theirs in plans.items()
                if other != role and role not in PLANTS and _takes(theirs, signal)
            )
            if takers and source.partition(".")[0] not in _HEAD:
                found.append(_loop(made, role, signal, source, takers))
    return sorted(found, key=lambda loop: not set(PLANTS) & set(loop.takers))


def _takes(made: Plan, signal: str) -> bool:
    return any(f"rx.{signal}" in spec.inputs.values() for spec in made.spec.blocks)


def _loop(made: Plan, role: Role, signal: str, source: str, takers: tuple[Role, ...]) -> CutLoop:
    variable = made.table.variables[made.table.index[f"tx.{signal}"]]
    low, high = variable.low, variable.high
    if signal in made.limits:
        limit = made.limits[signal]
        low, high = max(low, limit.low), min(high, limit.high)
    return CutLoop(signal, role, source, variable.unit, takers, low, high)


def choose(rig: Rig, plans: dict[Role, Plan], name: str | None) -> tuple[CutLoop, list[CutLoop]]:
    """Return the loop of that signal, or the first, and all. UserError if there is none."""
    known = loops(rig, plans)
    if not known:
        what = "no loop: no signal that a law sends is an input of a block of another node"
        raise UserError(f"{rig.path}: {what}; see `pcpc check`")
    if name is None:
        return known[0], known
    for loop in known:
        if name in (loop.signal, loop.signal.partition(".")[2]):
            return loop, known
    names = [loop.signal for loop in known]
    cure = did_you_mean(name, names) or f"; known: {', '.join(names)}"
    raise UserError(f"--loop {name}: no such loop{cure}")
