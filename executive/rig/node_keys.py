"""Keys of a rig file: its nodes, their blocks, what they send and may receive."""

# ruff: noqa: RUF012  msgspec gives each mapping its own copy of a mutable default

from typing import Annotated, ClassVar, Literal

from msgspec import Meta

from pcpc.executive.rig.bus_keys import Bus, Drive
from pcpc.executive.rig.judged_keys import Word
from pcpc.executive.rig.keyed import Keyed

BlockName = Annotated[str, Meta(pattern=r"\A[a-z][a-z0-9_]{0,63}\Z")]


class BlockEntry(Keyed):
    """A block of a node; only the executive's `controller` has no law here.

    With `law: table` a `file` of numbers over time, or a log and its `signal`; see `rig.tables`.
    """

    law: str | None = None
    unit: Word | None = None  # of a reference of any unit, see `rig.wired_units`
    file: str | None = None
    signal: str | list[str] | None = None
    interpolation: Literal["linear", "hold"] | None = None
    repeat: bool = False
    parameters: dict[str, float] = {}
    inputs: dict[str, str] = {}


class Limit(Keyed):
    """Bounds of a sent signal, in its unit; `rate_per_s` null means no rate limit.

    `safe`: where FAULT and the end of the run take it; null for what the receiver's `safe` says,
    else 0, and for the nearest value within the bounds.
    """

    low: float = float("-inf")
    high: float = float("inf")
    rate_per_s: Annotated[float, Meta(gt=0)] | None = None
    safe: float | None = None


class Plausible(Keyed):
    """What a received signal may be, in its unit; a value beyond it is not taken.

    `rate_per_s`, `still_cycles` null: not judged. `fault_after` such values in a row are a fault,
    null: as many as `supervisor.fault_after_cycles`.
    """

    low: float = float("-inf")
    high: float = float("inf")
    rate_per_s: Annotated[float, Meta(gt=0)] | None = None
    still_cycles: Annotated[int, Meta(ge=1, le=10**9)] | None = None
    fault_after: Annotated[int, Meta(ge=1, le=10**9)] | None = None


class Executive(Keyed):
    """The controller node; the order of `blocks` is the schedule."""

    node: str
    blocks: dict[BlockName, BlockEntry]
    transmit: dict[str, str] = {}
    limits: dict[str, Limit] = {}
    plausible: dict[str, Plausible] = {}


class Plant(Keyed):
    """The plant node; `safe` are the values that its watchdog substitutes.

    `limits`: what it sends may be bounded too, and is then safe in its FAULT. `fmu`: see `rig.fmu`.
    `drive`: the plant is a drive. `bus`: a second one of the executive, null: its first.
    """

    carried_out: ClassVar[tuple[str, ...]] = ("like", "fmu", "inputs", "parameters")

    node: str
    blocks: dict[BlockName, BlockEntry]
    parameters_file: str | None = None
    transmit: dict[str, str] = {}
    limits: dict[str, Limit] = {}
    plausible: dict[str, Plausible] = {}
    safe: dict[str, float] = {}
    drive: Drive | None = None
    bus: Bus | None = None


class Local(Keyed):
    """The node between executive and plant; `bus` is the one towards the plant.

    `bus` null: beside the executive's, vcan1 to vcan0, the next port of udp_multicast. `safe` are
    the values that its watchdog substitutes for what it receives.
    """

    node: str
    blocks: dict[BlockName, BlockEntry]
    bus: Bus | None = None
    transmit: dict[str, str] = {}
    limits: dict[str, Limit] = {}
    plausible: dict[str, Plausible] = {}
    safe: dict[str, float] = {}


Section = Executive | Local | Plant
