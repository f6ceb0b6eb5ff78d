"""Keys of a rig file: how the nodes are scheduled, and from when on a wake-up is late."""

from typing import Annotated

from msgspec import Meta

from pcpc.executive.rig.keyed import Keyed
from pcpc.executive.rig.roles import PLANTS, Role

Fraction = Annotated[float, Meta(ge=0, le=1)]
Priority = Annotated[int, Meta(ge=1, le=99)]  # SCHED_FIFO's range


class Scheduling(Keyed):
    """Of a node: SCHED_FIFO `priority`, and the processor to stay on with it, null for any.

    `phase`: fraction of a period by which its cycles lie behind the common grid of whole periods.
    """

    priority: Priority
    phase: Fraction
    cpu: Annotated[int, Meta(ge=0, le=4095)] | None = None


class _Executive(Scheduling):
    priority: Priority = 80
    phase: Fraction = 0.0


class _Local(Scheduling):
    priority: Priority = 75
    phase: Fraction = 0.3333


class _Plant(Scheduling):
    priority: Priority = 70
    phase: Fraction = 0.5


class Realtime(Keyed):
    """Scheduling of each node; `late_fraction` of a period after its time a wake-up is late."""

    executive: _Executive = _Executive()
    local: _Local = _Local()
    plant: _Plant = _Plant()
    late_fraction: Fraction = 0.1

    def of_node(self, role: Role) -> Scheduling:
        """Return the settings of a node; all plants have those of `plant`."""
        found: Scheduling = getattr(self, "plant" if role in PLANTS else role)
        return found
