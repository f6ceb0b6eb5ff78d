"""The rig's faults on purpose, begun and ended by a client while the rig runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.loop.fault_kinds import WrongNode
from pcpc.executive.loop.injection import FOR_EVER
from pcpc.executive.nodes.live import Live


@dataclass(frozen=True)
class InjectedFault:
    """A fault as it stands in a running node."""

    name: str
    node: str
    about: str
    left: float  # cycles, 0 while it is off
    value: float
    unit: str
    share: float


def faults_of(nodes: Sequence[Live]) -> list[InjectedFault]:
    """Return the faults that these nodes have."""
    faults = []
    for live in nodes:
        values, role = live.read(), live.name.rpartition(".")[2]
        for name, about in _fault_descriptions(live).items():
            left, value, share = (values[f"fault.{name}.{x}"] for x in ("left", "value", "share"))
            unit = live.variables[f"fault.{name}.value"].unit
            what = f"{about['kind']} of {about['of']}"
            faults.append(InjectedFault(name, role, what, left, value, unit, share))
    return faults


def _fault_descriptions(live: Live) -> Mapping[str, Mapping[str, str]]:
    """Return the faults of a node, as `nodes.planned_faults` describes them."""
    known: Mapping[str, Mapping[str, str]] = live.block.description.get("faults", {})
    return known


def inject(
    nodes: Sequence[Live],
    name: str,
    for_s: float | None = None,
    value: float | None = None,
    share: float | None = None,
    end: bool = False,
) -> Mapping[str, int]:
    """Begin a fault in every node that has it, or `end` it; return the cycle in each.

    `for_s` None: until it is ended. UserError for a fault that the rig does not name, a stall where
    no clock runs, or what the node refuses.
    """
    having = [live for live in nodes if name in _fault_descriptions(live)]
    if not having:
        known = [one for live in nodes for one in _fault_descriptions(live)]
        cure = did_you_mean(name, known) if known else "; the rig file has no faults"
        raise UserError(f"{name}: no such fault{cure}")
    cycles = {}
    for live in having:
        clocked = live.block.description["metadata"]["pacing"] in ("real", "sync")
        if _fault_descriptions(live)[name]["kind"] == WrongNode.STALL.word and not clocked:
            what = "without a clock it has no effect; give it a time in the rig file"
            raise UserError(f"{name}: a stall on demand needs pacing real or sync: {what}")
        left = FOR_EVER if for_s is None else float(round(for_s * 1e9 / live.period_ns))
        changes = {"left": 0.0 if end else left, "value": value, "share": share}
        cycles[live.name.rpartition(".")[2]] = live.tune(
            {f"fault.{name}.{key}": x for key, x in changes.items() if x is not None}
        )
    return cycles
