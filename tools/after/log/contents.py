"""What a log holds, or an MCAP file of others: what `pcpc log info` tells and prints as JSON."""

from collections.abc import Mapping
from typing import Annotated, NotRequired, TypedDict

from msgspec import UNSET, Meta, Struct, UnsetType

from pcpc.tools.terminal.answer import Count, NodeName, Number, Positive, one_of

DIRECTIONS = ("sent", "received")


class FrameRow(TypedDict):
    """Frames of one id and direction."""

    name: str
    "empty: not in the DBC file"
    id: Annotated[str, Meta(pattern="^[0-9A-F]+$")]
    "hexadecimal"
    direction: Annotated[str, one_of(*DIRECTIONS)]
    "as the node sees it"
    count: Positive
    bits: Annotated[float, Meta(ge=0, multiple_of=1)]
    "on the wire, at most"
    rate_hz: float | None
    "a second; null: the log has no duration"


class TopicRow(TypedDict):
    """A topic."""

    topic: str
    messages: Count
    bytes: Count
    "before compression"


class Cycles(TypedDict):
    """The cycles of a node."""

    cycles: Count
    "rows of the log"
    first: int | None
    "cycle; null: it has none"
    last: int | None
    "cycle; null: it has none"
    skipped: Count
    "between them, as the loop says"
    lost: Count
    "between them, of which the log has no row"


class Entry(TypedDict):
    """An event or a tuning."""

    time_s: float
    "s from the first cycle"
    node: NodeName
    cycle: int
    stamp_ns: int
    "on the node's monotonic clock, ns"
    event: NotRequired[str]
    "what happened: fault, state, skip, change, late, ...; a tuning has none"
    name: NotRequired[str]
    "of a variable, a fault, a state or a frame"
    argument: NotRequired[int]
    "its number in the node, or how many"
    value: Number
    "of a variable"


class Machine(Struct):
    """Where it was made."""

    kernel: str
    machine: str
    processor: str
    cpus: str
    "a whole number as text"


class Contents(Struct):
    """A log."""

    file: str
    bytes: Count
    "of the file"
    bytes_per_hour: int | None
    "null: it has no duration"
    rig: str
    "its name"
    controller: str
    pacing: str
    "virtual, lockstep, sync, real; imported: of a recording"
    bus: str
    "INTERFACE:CHANNEL; memory: none"
    seed: str
    "a whole number as text"
    rate_hz: str
    "a number as text, Hz"
    rig_git: str
    "commit of the rig's work tree, with -dirty where files differ from it; empty: none"
    start: str
    "of the first cycle, ISO 8601 in UTC; empty: not known"
    duration_s: float
    "s, of the first node"
    versions: dict[str, str]
    "of Python and packages; git: the commit of pcpc"
    machine: Machine
    nodes: dict[NodeName, Cycles]
    frames: list[FrameRow]
    "of the executive; in a log without it of the plant"
    e2e: Mapping[NodeName, Mapping[str, Positive]]
    "by node: received frames by state of the end-to-end check, but OK"
    faults: list[Entry]
    "the events that are faults"
    events: list[Entry]
    "by time"
    tunings: list[Entry]
    "by time"
    topics: list[TopicRow]
    attachments: dict[str, Count]
    "bytes, by name"
    recorder: dict[str, str]
    "counts as text, by kind, node and ring"
    recovered: dict[str, str]
    "what pcpc log recover says; empty: it is an original"
    missing: list[str]
    "what is damaged or not there, in words"


class Foreign(Struct):
    """An MCAP file of others; the exit code is 2."""

    file: str
    library: str = ""
    "that wrote it; empty: not told"
    topics: dict[str, Count] = {}
    "messages, by topic"
    damaged: str | UnsetType = UNSET
    "why not all of it was read; only then"
    reason: str = ""
    "why it is no log of this project"
