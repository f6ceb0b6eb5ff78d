"""What a log says of a node, `<node>.json`: `executive.nodes.plan.describe` makes it.

Each key is of its type, or it is not there: `executive.log.checks` leaves out what is wrong.
"""

from collections.abc import Mapping
from typing import Annotated, Any, TypedDict, cast

from msgspec import Meta

from pcpc.executive.own_laws.carried_files import CarriedFile

LATEST = 1 << 62  # ns or cycles; the sum of two is an int64
LONGEST_PERIOD_NS = 10**12

Number = int | float
Count = Annotated[int, Meta(ge=0, le=LATEST)]
Id = Annotated[str, Meta(pattern=r"\A[0-9]{1,10}\Z")]


class CheckedDescription(TypedDict, total=False):
    """The keys whose types are checked when a log is read."""

    node: str
    rig: str
    watch: str | None
    files: list[CarriedFile]
    period_ns: Annotated[int, Meta(ge=1, le=LONGEST_PERIOD_NS)]
    cycles: Count
    keyframe_passes: Count
    keyframe_bytes: Count
    keyframe_layout: str
    variables: list[list[str]]  # name, unit, kind, writer, help
    ranges: dict[str, list[Number]]  # low and high
    state_columns: list[str]
    timing_columns: list[str]
    data_bytes: Annotated[int, Meta(ge=8, le=64)]  # of a message of /can/frames; 8 without it
    frames: dict[Id, str]
    sources: dict[str, str]
    state_names: list[str]
    fault_names: list[str]
    metadata: dict[str, str]
    faults: dict[str, dict[str, Any]]


class NodeDescription(CheckedDescription, total=False):
    """All keys, those of the shared memory among them, which do not go into a log."""

    alarms: dict[str, float | None]
    timing: dict[str, float | None]
    external: list[str]
    bitrate: int | None
    keep_ns: int
    keep_on: list[str]
    attachments: dict[str, str]  # texts by file name
    blocks: list[str]
    laws: list[str]
    initial: dict[str, float]
    file: str  # of the rig


def node_description(data: Mapping[str, Any]) -> NodeDescription:
    """Return plain data, as shared memory holds it, as the description that it is."""
    return cast(NodeDescription, data)
