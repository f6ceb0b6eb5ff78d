"""The plan of one node, and what each of its features is: a `Part` that adds to it.

A part is the one place where a feature of a node enters it: what of the rig it takes and refuses,
which variables it adds to the table, what it writes into the LOOP record, what a log says of it,
what of it has failed, what it closes.
Its keys stand in `executive.rig.schema`, its code and memory in `executive.loop`.
"""

from bisect import insort
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from pcpc.drivers.can import dbc
from pcpc.drivers.can.wire_layout import LENGTHS
from pcpc.executive.laws.idle import idle
from pcpc.executive.log.description import NodeDescription
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.table import Table, Variable, Views
from pcpc.executive.nodes.acting_faults import ActingFault
from pcpc.executive.own_laws.carried_files import Reads
from pcpc.executive.rig import messages as protocol
from pcpc.executive.rig.reading import NodeSpec, Rig
from pcpc.executive.rig.roles import PLANTS, Role
from pcpc.executive.rig.schema import Limit


@dataclass
class Plan:
    """Everything that `install` writes; tables of frames are those of `drivers.can.dbc`."""

    rig: Rig
    role: Role
    spec: NodeSpec
    pacing: str
    table: Table = field(default_factory=Table)
    views: list[Views] = field(default_factory=list)
    copies: list[list[tuple[int, int]]] = field(default_factory=list)
    rx_frames: list[dbc.Frame] = field(default_factory=list)
    tx_frames: list[dbc.Frame] = field(default_factory=list)
    values: dict[int, float] = field(default_factory=dict)
    schedule: list[tuple[int, int, float]] = field(default_factory=list)  # cycle, place, value
    faults: list[ActingFault] = field(default_factory=list)
    noted: list[int] = field(default_factory=list)
    read: Reads = field(default_factory=dict)  # by `prepare`
    limits: dict[str, Limit] = field(default_factory=dict)  # by sent signal, `safe` given
    below: frozenset[str] = frozenset()  # of executive or local node: frames on the second bus
    senders: dict[str, int] = field(default_factory=dict)  # of frames from several nodes below
    external: dict[str, Any] = field(default_factory=dict)  # entries in the place of blocks' own
    opened: list[Any] = field(default_factory=list)  # what has to live as long as the loop runs
    metadata: dict[str, str] = field(default_factory=dict)  # of a log that is written
    has_text: bool = True  # whether that log has the effective rig

    @property
    def leads(self) -> bool:
        """Whether it is the executive, which has the clock, the schedule and the supervisor."""
        return self.role == "executive"

    @property
    def is_plant(self) -> bool:
        """Whether it is the lowest node, or one of several."""
        return self.role in PLANTS

    @property
    def steps(self) -> tuple[Any, ...]:
        """What the loop calls: the steps of the blocks, filled up with idle ones."""
        used = [self.external.get(b.name, b.block.step.entry) for b in self.spec.blocks]
        return (*used, *(idle.entry,) * (sh.MAX_BLOCKS - len(used)))

    @property
    def fd(self) -> bool:
        """Whether a frame of the node, or of the rig's drive, is one of CAN FD."""
        own = any(frame.fd for frame in (*self.rx_frames, *self.tx_frames))
        return own or protocol.has_fd_drive(self.rig)

    @property
    def data_bytes(self) -> int:
        """The most data bytes of a frame."""
        return LENGTHS[-1] if self.fd else 8

    @property
    def receive_ids(self) -> list[int]:
        """The ids this node listens to; a local node: towards the executive."""
        return [frame.can_id for frame in self.rx_frames if frame.name not in self.below]

    @property
    def receive_ids_below(self) -> list[int]:
        """The ids a local node listens to on its bus to the plant."""
        return [frame.can_id for frame in self.rx_frames if frame.name in self.below]

    @property
    def send_ids(self) -> list[int]:
        """The ids this node sends; a local node: towards the executive."""
        return [frame.can_id for frame in self.tx_frames if frame.name not in self.below]

    @property
    def send_ids_below(self) -> list[int]:
        """The ids a local node sends on its bus to the plant."""
        return [frame.can_id for frame in self.tx_frames if frame.name in self.below]

    def columns(self, timing: bool) -> list[int]:
        """Return the places of the recorded variables, of the timing or of the state record."""
        return [i for i, v in enumerate(self.table.variables) if v.recorded and v.timing == timing]

    @property
    def names(self) -> list[str]:
        """Names in the order of the table."""
        return [variable.name for variable in self.table.variables]

    def of_kind(self, kind: str) -> dict[str, Variable]:
        """Return the `received` or `sent` signals, by FRAME.SIGNAL."""
        return {v.name[3:]: v for v in self.table.variables if v.kind == kind}

    def add(self, variable: Variable, value: float | None = None) -> int:
        """Append a variable, which begins with `value` (0); return its place. RigError."""
        place = self.table.add(variable)
        if value is not None:
            self.values[place] = value
        return place

    def tune_at(self, cycle: int, place: int, value: float) -> None:
        """Add a tuning of the schedule, behind those of its cycle."""
        insort(self.schedule, (cycle, place, value), key=lambda row: row[0])


Size = tuple[str, int, int]  # of what, how many, how many one node holds


class Part:
    """One feature of a node; a part that says nothing of a question leaves it to the others."""

    def variables(self, made: Plan) -> None:
        """Check what the rig asks for, and add variables with their first values; RigError."""

    def sizes(self, made: Plan) -> Iterable[Size]:
        """Return how many of its things a node has, and how many the LOOP record holds."""
        return ()

    def install(self, made: Plan, loop: Loop) -> None:
        """Write it into the zeroed LOOP record, in which the parts before it stand; RigError."""

    def in_no_lane(self, rig: Rig) -> str:
        """Return why a run of a rig is none of several side by side; "" if it may be one."""
        return ""

    def described(self, made: Plan) -> NodeDescription:
        """Return what the node's shared memory and its log say of it."""
        return {}

    def failures(self, made: Plan) -> Iterable[str]:
        """Return what went wrong in it while the node ran, a line each."""
        return ()

    def close(self, made: Plan) -> None:
        """Give back what `install` has opened: the loop has ended."""
