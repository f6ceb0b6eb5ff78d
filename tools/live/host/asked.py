"""What a client may ask, as messages of JSON: {"do": "panel", "id": 1, "names": [...], ...}.

What has another form, an unknown key, a number out of its range or more than MOST_BYTES is refused
before anything is done with it. An answer to one that acts repeats its `id`.
"""

from typing import Annotated, Literal, TypeVar

import msgspec
from msgspec import Meta, Struct

from pcpc.tools.live.remote.guard import MOST_TOKEN

MOST_BYTES = 64 * 1024
Number = Annotated[int, Meta(ge=0, le=10**6)]
Name = Annotated[str, Meta(min_length=1, max_length=300)]
Run = Annotated[str, Meta(max_length=300)]
Names = Annotated[list[Name], Meta(max_length=32)]
Seconds = Annotated[float, Meta(ge=-1e9, le=1e9)]
Bins = Annotated[int, Meta(ge=2, le=4096)]
MOST_COLUMNS = 8192
Column = Annotated[int, Meta(ge=0, lt=MOST_COLUMNS)]
Field = Literal[
    "control", "answer", "record_ends", "frame_ends", "event_ends", "snapshot", "stages",
    "histogram", "latest",
]  # fmt: skip


class _Asked(Struct, tag_field="do", forbid_unknown_fields=True, frozen=True):
    pass


class Hello(_Asked, frozen=True, tag="hello"):
    """The first word of a client."""

    token: Annotated[str, Meta(max_length=MOST_TOKEN)]
    kind: Literal["page", "terminal"] = "page"
    run: Run = ""  # which it had chosen, of several


class Panel(_Asked, frozen=True, tag="panel"):
    """Curves over time, of at most 32 variables: of the newest `window_s`, or of a span."""

    id: Number
    names: Names
    bins: Bins
    window_s: Annotated[float, Meta(gt=0, le=3600)] | None = None
    from_s: Seconds = 0.0
    to_s: Seconds = 0.0


class Phase(_Asked, frozen=True, tag="phase"):
    """One variable over another: at most `points` of the newest `window_s`, or up to `to_s`."""

    id: Number
    names: Annotated[list[Name], Meta(min_length=2, max_length=2)]
    points: Bins
    window_s: Annotated[float, Meta(gt=0, le=3600)]
    to_s: Seconds | None = None


class Drop(_Asked, frozen=True, tag="drop"):
    """A panel is not shown any more."""

    id: Number


class At(_Asked, frozen=True, tag="at"):
    """The instant of a log that is looked at."""

    t_s: Seconds


class Set(_Asked, frozen=True, tag="set"):
    """Parameters of one node, all between the same two cycles or none."""

    id: Number
    values: Annotated[dict[Name, float], Meta(min_length=1, max_length=64)]


class Choose(_Asked, frozen=True, tag="run"):
    """Show this run from now on; "": whatever runs."""

    id: Number
    run: Run


class Undo(_Asked, frozen=True, tag="undo"):
    """Give the parameters back what they had before the newest tuning."""

    id: Number


class Act(_Asked, frozen=True, tag="act"):
    """One of ACTIONS."""

    id: Number
    what: Annotated[str, Meta(max_length=20)]


class Fault(_Asked, frozen=True, tag="fault"):
    """Begin a fault on purpose of the rig, or end it."""

    id: Number
    name: Name
    end: bool = False
    for_s: Annotated[float, Meta(gt=0, le=1e6)] | None = None


class Handover(_Asked, frozen=True, tag="handover"):
    """Let another controller take over."""

    id: Number
    controller: Name


class Record(_Asked, frozen=True, tag="record"):
    """Begin to record what runs into a file of the host, or end it."""

    id: Number
    end: bool = False


class Snapshot(_Asked, frozen=True, tag="snapshot"):
    """Write the newest seconds that the host has into a file of its own."""

    id: Number
    last_s: Annotated[float, Meta(gt=0, le=120)] = 30.0


# What a terminal of another machine asks (hello: terminal)


class Nodes(_Asked, frozen=True, tag="nodes"):
    """All nodes that run: a handle for each."""

    id: Number


class _OfNode(_Asked, frozen=True):
    id: Number
    node: Name  # its handle


class Describe(_OfNode, frozen=True, tag="describe"):
    """What a node says about itself."""


class Look(_OfNode, frozen=True, tag="look"):
    """Fields that a node publishes, as they are now."""

    fields: Annotated[list[Field], Meta(min_length=1, max_length=16)]


class Rows(_OfNode, frozen=True, tag="rows"):
    """Rows of a ring from number `since` on, as many as one answer holds."""

    ring: Literal["record", "frame", "event"]
    since: Annotated[int, Meta(ge=0, le=2**62)]
    columns: Annotated[list[Column], Meta(min_length=1, max_length=MOST_COLUMNS)] | None = None


class Tune(_OfNode, frozen=True, tag="tune"):
    """Parameters of a node, all between the same two cycles or none."""

    values: Annotated[dict[Name, float], Meta(min_length=1, max_length=64)]


class Lock(_OfNode, frozen=True, tag="lock"):
    """Forbid tunings of a node, or allow them."""

    level: Literal["none", "tune", "all"]


FromTerminal = Nodes | Describe | Look | Rows | Tune | Lock
Wanted = Panel | Phase | Drop
Acting = Set | Undo | Act | Fault | Handover | Record | Snapshot
Decoded = TypeVar("Decoded")
_decoder = msgspec.json.Decoder(Hello | Wanted | At | Choose | Acting)
_of_terminal = msgspec.json.Decoder(FromTerminal)


class Wrong(ValueError):
    """A message that is none of these, in words."""


def read(message: str | bytes) -> Hello | Wanted | At | Choose | Acting:
    """Return what a message asks; Wrong."""
    return _decoded(_decoder, message)


def read_terminal(message: str | bytes) -> FromTerminal:
    """Return what a terminal's message asks; Wrong."""
    return _decoded(_of_terminal, message)


def _decoded(decoder: msgspec.json.Decoder[Decoded], message: str | bytes) -> Decoded:
    try:
        return decoder.decode(message)
    except (msgspec.MsgspecError, RecursionError, UnicodeError) as error:
        raise Wrong(f"not a message: {error}") from None
