"""What `pcpc check` finds of a rig: its nodes, their frames, the load of the bus, warnings."""

from typing import Annotated

from msgspec import UNSET, Meta, Struct, UnsetType

from pcpc.executive.rig.fmu_model import INPUT, OUTPUT, PARAMETER, START, FmuVariable
from pcpc.tools.terminal.answer import Count, NodeName, Number, Pacing, Positive, one_of

_VARIABLE = Meta(
    extra_json_schema={
        "properties": {
            "role": {"enum": [INPUT, OUTPUT, PARAMETER, START]},
            "element": {"minimum": 0},
        }
    }
)


class CheckedStep(Struct):
    """A step of a cycle."""

    block: str
    law: str
    "empty: a part of the loop"


class Wire(Struct):
    """What an input is copied from."""

    input: str
    source: str
    unit: str
    "empty: none"


class Scale(Struct):
    """What a signal can hold."""

    unit: str
    "empty: none"
    quantum: float
    "what a step of the raw value is, in unit"
    range: tuple[Number, Number]
    "lowest and highest value, in unit"


class CheckedFrame(Struct):
    """A frame that is sent."""

    id: Count
    extended: bool
    "29 bits"
    name: str
    bytes: Annotated[int, Meta(ge=0, le=64)]
    every_cycles: Positive
    period_ms: float
    "ms"
    protected: bool
    "by a counter and a CRC"
    crc_bits: Annotated[int, one_of(0, 8, 16)]
    "0: none"
    signals: list[str]
    "names"
    scales: list[Scale]
    "of the signals, in their order"


class Fmu(Struct):
    """An FMU of a node."""

    block: str
    model: str
    fmi: str
    "version"
    made_by: str
    "empty: not told"
    sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
    variables: tuple[Annotated[FmuVariable, _VARIABLE], ...]
    "of each, what is left out is 0, empty, null or false"
    steps: Positive
    "that were tried"
    median_us: float
    "of a step, us"
    worst_us: float
    "of a step, us"
    period_us: float
    "of the rig, us"
    real_time_capable: bool
    "no step took longer than a period"


class CheckedNode(Struct):
    """A node as it would run."""

    node: str
    "in the DBC file"
    schedule: list[CheckedStep]
    "in the order of a cycle"
    wiring: list[Wire]
    "in the order of a cycle; the inputs of the last ones are what is sent"
    sends: list[CheckedFrame]
    receives: list[str]
    "names of frames"
    variables: Count
    "in its table"
    fmus: list[Fmu] | UnsetType = UNSET
    "only where the part for FMUs is installed"


class Load(Struct):
    """What a rate takes of the bus."""

    rate_hz: float
    "Hz"
    load: float
    "share of the bit rate, in the worst case"


class CheckedBus(Struct):
    """The bus, and how full it is."""

    interface: str
    channel: str | int | None
    "null: the default of the interface"
    bitrate: int | None
    "bit/s; null: none, and no load"
    load: list[Load] = []
    highest_rate_hz: int | None = None
    "that would fill the bus, Hz; null: no bit rate, or none does"


class Report(Struct):
    """What `--json` prints."""

    rig: str
    title: str
    file: str
    "of the rig"
    dbc: str
    "file"
    controller: str
    pacing: Pacing
    rate_hz: Annotated[float, Meta(gt=0)]
    "Hz"
    duration_s: float
    "s"
    cycles: Count
    nodes: dict[NodeName, CheckedNode]
    "by role"
    bus: CheckedBus
    warnings: list[str]
    "each with file and line"
