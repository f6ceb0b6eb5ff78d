"""The rig's faults on purpose, begun and ended by a client while the rig runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.loop.injection import FOR_EVER
from pcpc.executive.nodes.live import Live

_FIRST, _LAST = "fault.", ".left"


@dataclass(frozen=True)
class Injected:
    """A fault as it stands in a running node."""

    name: str
    node: str
    about: str
    left: float  # cycles, 0 while it is off
    value: float
    unit: str
    share: float


def faults_of(nodes: Sequence[Live]) -> list[Injected]:
    """Return the faults that these nodes have."""
    found = []
    for live in nodes:
        values = live.read()
        for variable in live.variables.values():
            if variable.name.startswith(_FIRST) and variable.name.endswith(_LAST):
                name = variable.name[len(_FIRST) : -len(_LAST)]
                left, value, share = (values[f"{_FIRST}{name}.{x}"]
                                      for x in ("left", "value", "share"))  # fmt: skip
                unit = live.variables[f"{_FIRST}{name}.value"].unit
                about = variable.help.rpartition(": ")[0]
                role = live.name.rpartition(".")[2]
                found.append(Injected(name, role, about, left, value, unit, share))
    return found


def inject(
    nodes: Sequence[Live], name: str, for_s: float | None = None, value: float | None = None,
    share: float | None = None, end: bool = False,
) -> Mapping[str, int]:  # fmt: skip
    """Begin a fault in every node that has it, or `end` it; return the cycle in each.

    `for_s` None: until it is ended. UserError for a fault that the rig does not name, a stall where
    no clock runs, or what the node refuses.
    """
    having = [live for live in nodes if f"{_FIRST}{name}{_LAST}" in live.variables]
    if not having:
        known = [one.name for one in faults_of(nodes)]
        cure = did_you_mean(name, known) if known else "; the rig file has no faults"
        raise UserError(f"{name}: no such fault{cure}")
    cycles = {}
    for live in having:
        about = live.variables[f"{_FIRST}{name}{_LAST}"].help
        if about.startswith("stall ") and live.block.description["metadata"]["pacing"] not in (
            "real", "sync",
        ):  # fmt: skip
            what = "without a clock nobody would notice; give it a time in the rig file"
            raise UserError(f"{name}: a stall on demand needs pacing real or sync: {what}")
        left = FOR_EVER if for_s is None else round(for_s * 1e9 / live.period_ns)
        changes = {_LAST: 0.0 if end else float(left), ".value": value, ".share": share}
        cycles[live.name.rpartition(".")[2]] = live.tune(
            {
                f"{_FIRST}{name}{key}": number
                for key, number in changes.items()
                if number is not None
            }
        )
    return cycles
