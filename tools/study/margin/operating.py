"""The point at which a loop is looked at: the rig with its reference held, at rest.

What the executive's blocks without an input (references) give at one time of the run is held; of
what they give, derivatives are 0: outputs whose unit has a higher power of 1/s than another's.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np

from pcpc.drivers.errors import UserError
from pcpc.executive.laws.units import unit
from pcpc.executive.nodes.plan import Plan, plan
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.executive.rig.schema import Fault
from pcpc.tools.study.arrays import Vector
from pcpc.tools.study.margin.cycle_map import CycleMap
from pcpc.tools.study.margin.loops import CutLoop

_WILD = 1e12  # beyond every variable, also beyond counters
INJECTED = "margin"  # name of the fault that adds the excitation


def without_disturbances(rig: Rig) -> Rig:
    """Return the rig without faults and losses on purpose, and without an emulated line."""
    bus = msgspec.structs.replace(rig.config.bus, emulate=None)
    return rig.changed(faults={}, losses={}, bus=bus)


def plans_of(rig: Rig) -> dict[Role, Plan]:
    """Return the plans of all nodes. RigError, BusError."""
    return {role: plan(rig, role, "lockstep") for role in rig.roles}


def reference_values(plans: Mapping[Role, Plan], at_s: float) -> dict[str, float]:
    """Return what the references give at a time, by variable; derivatives are 0."""
    made, found = plans["executive"], dict[str, float]()
    rate = made.rig.config.rate_hz
    for spec, views in zip(made.spec.blocks, made.views, strict=True):
        if spec.block.inputs:
            continue
        p, x, u, y = (
            np.array([made.values.get(place, 0.0) for place in places])
            for places in (views.parameters, views.states, views.inputs, views.outputs)
        )
        spec.block.step(round(at_s * rate) / rate, 1.0 / rate, p, x, u, y)
        variables = [made.table.variables[place] for place in views.outputs]
        orders = [unit(one.unit).order for one in variables]
        for variable, value, order in zip(variables, y.tolist(), orders, strict=True):
            found[variable.name] = value if order == min(orders) else 0.0
    return found


def with_injection(rig: Rig, loop: CutLoop, values: Mapping[str, float]) -> Rig:
    """Return the rig with the references held and something added to a sent signal.

    Both are faults on purpose: of kind value at the references' outputs, of kind bias at the
    signal, whose size is the variable `fault.margin.value`.
    """
    faults = {
        f"held_{i}": Fault(kind="value", at=name, value=value, from_="0s")
        for i, (name, value) in enumerate(values.items())
    }
    at = loop.sent if loop.role == "executive" else f"{loop.role}:{loop.sent}"
    faults[INJECTED] = Fault(kind="bias", at=at, value=0.0, from_="0s")
    return rig.changed(faults=faults)


@dataclass(frozen=True)
class Rest:
    """The map of a cycle after a time, and the mean of its variables over the last half of it."""

    cycle: CycleMap
    mean: Vector
    deviation: Vector


def at_rest(plans: dict[Role, Plan], values: Mapping[str, float], settle_s: float) -> Rest:
    """Return what a rig comes to. UserError if it leaves all bounds."""
    cycle = CycleMap(plans)
    cycle.begin(dict(values))
    return rest_after(cycle, settle_s)


def rest_after(cycle: CycleMap, settle_s: float) -> Rest:
    """Return what a map comes to after that time; UserError as `at_rest`."""
    began = cycle.v.copy()
    half = max(round(0.5 * settle_s / cycle.dt), 1)
    total, squares = np.zeros_like(cycle.v), np.zeros_like(cycle.v)
    with np.errstate(all="ignore"):
        for _ in range(half):
            cycle.advance()
        first = cycle.v.copy()
        live = np.abs(began) < _WILD  # others mark what is empty
        for _ in range(half):
            cycle.advance()
            moved = np.where(live, cycle.v - first, 0.0)
            total += moved
            squares += moved * moved
    wild = ~(np.abs(cycle.v) < _WILD) & live
    if wild.any():
        name = cycle.names[cycle.own(wild)]
        what = f"the closed loop is unstable: {name} leaves all bounds within {settle_s:g} s"
        raise UserError(f"{what}; a lower gain or another --at or --set may be stable")
    mean = total / half
    deviation = np.sqrt(np.maximum(squares / half - mean * mean, 0.0))
    return Rest(cycle, first + mean, deviation)


def later_rest(rest: Rest, place: int, settle_s: float) -> Rest:
    """Return what a rig comes to that long after a rest, if a variable moves half as much there.

    Else the same: what stays as it is, noise or a limit cycle, has no later rest.
    """
    cycle = rest.cycle
    start, k = cycle.v.copy(), cycle.k
    later = rest_after(cycle, settle_s)
    if later.deviation[place] < 0.5 * rest.deviation[place]:
        return later
    cycle.v[:], cycle.k = start, k
    return rest
