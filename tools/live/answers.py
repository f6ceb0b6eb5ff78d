"""What the commands about running nodes print as JSON.

Commands that do without msgspec, which takes time, import it for types alone.
"""

from typing import Annotated, NotRequired, TypedDict

from msgspec import Meta

from pcpc.executive.nodes.mailbox import LEVELS
from pcpc.executive.rig.roles import ROLES
from pcpc.tools.terminal.answer import Count, NodeName, Positive, VariableName, one_of

KINDS = ("parameter", "input", "output", "state", "sent", "received", "supervisor", "health",
         "timing")  # fmt: skip
_FULL_NAME = Meta(pattern=rf"\.({'|'.join(ROLES)})$")
_CYCLE = {"cycle": {"type": "integer", "minimum": 0, "description": "of the first one's node"}}

Value = Annotated[float | None, Meta(description="in its unit, see pcpc get; null: not finite")]
Values = Annotated[
    dict[VariableName, Value],
    Meta(min_length=1, description="By name, as plant:lag.position where there are several nodes."),
]
WatchedValues = Annotated[
    dict[Annotated[str, Meta(pattern=r"^cycle$|^.+\..+$")], Value],
    Meta(
        min_length=2,
        description="A line for each time; names are as those of pcpc get.",
        extra_json_schema={"properties": _CYCLE, "required": [*_CYCLE]},
    ),
]
CyclesOfReset = Annotated[
    dict[Annotated[str, _FULL_NAME], Annotated[int, Meta(ge=0, description="in which it left")]],
    Meta(min_length=1, description="By node, as RIG.BUS.plant."),
]
CycleOfStop = Annotated[
    dict[Annotated[str, _FULL_NAME], Annotated[int, Meta(ge=0, description="in which it took it")]],
    Meta(min_length=1, max_length=1, description="By node, as RIG.BUS.executive."),
]


class VariableNow(TypedDict):
    """A variable of a node."""

    name: VariableName
    value: float | None
    "now, in unit; null: not finite"
    unit: str
    "empty: none"
    kind: Annotated[str, one_of(*KINDS)]
    "only a parameter can be set"
    writer: str
    "a block, a frame, loop"
    help: str
    range: Annotated[list[float | None], Meta(min_length=2, max_length=2)] | None
    "lowest and highest value of a parameter, in unit, null: no bound; null: it is none"


Variables = Annotated[list[VariableNow], Meta(min_length=1)]


class Tuned(TypedDict):
    """Empty values: nothing had to change."""

    cycle: Count
    "first with the values"
    values: dict[VariableName, float]
    "by name, in the unit of each"
    before: dict[VariableName, float | None]
    "of the same names; null: not finite"


class LoopClosed(TypedDict):
    """The loop is closed."""

    cycle: Count
    "first with it"
    armed: Annotated[bool, one_of(True)]


class LoopOpened(TypedDict):
    """The commands ramp to their safe values."""

    cycle: Count
    "first of the ramp"
    armed: Annotated[bool, one_of(False)]


class HandedOver(TypedDict):
    """Another controller is in charge."""

    cycle: Count
    "first with it"
    in_charge: str
    "name of the controller"


class Locked(TypedDict):
    """Which tunings a node refuses."""

    lock: Annotated[str, one_of(*LEVELS)]
    "none: it takes tunings; tune: no tuning of clients; all: nothing but a stop"


class FaultNow(TypedDict):
    """A fault as it stands in a running node."""

    name: str
    "under faults: in the rig"
    node: NodeName
    about: str
    "kind and place"
    left: Annotated[float, Meta(ge=0)]
    "cycles that it still acts; 0: off; 1e15: until it is ended"
    value: float
    "magnitude, in unit"
    unit: str
    "empty: none"
    share: Annotated[float, Meta(ge=0, le=1)]
    "probability that it acts in a cycle"


Faults = Annotated[list[FaultNow], Meta(description="without a name: all of the rig")]


class FaultChange(TypedDict):
    """A fault that was begun or ended."""

    fault: str
    "its name"
    on: bool
    "false: it was ended"
    cycles: Annotated[dict[NodeName, Count], Meta(min_length=1)]
    "first with it, by node"


class CapturedBurst(TypedDict):
    """Cycles around a trigger."""

    cycle: Count
    "in which the condition became true; without a trigger the last but --post"
    t_s: float
    "its time, s"
    first: Count
    "cycle of the first row"
    last: Count
    "cycle of the last row"
    rows: Positive
    "cycles in it"
    trigger: bool
    "false: --mode auto captured without one"
    missing_before: NotRequired[Positive]
    "cycles of --pre that there are no rows of; only where some are missing"


class Capture(TypedDict):
    """What was captured."""

    file: str
    "the log that was written"
    lost: Count
    "cycles that were overwritten before they were read"
    bursts: Annotated[list[CapturedBurst], Meta(min_length=1)]
