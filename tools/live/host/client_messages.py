"""What a client may ask, as messages of JSON: {"do": "panel", "id": 1, "names": [...], ...}.

What has another form, an unknown key, a number out of its range or more than MOST_BYTES is refused
before anything is done with it. An answer to one that acts repeats its `id`.
"""

from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from pcpc.tools.live.host.guard import MOST_TOKEN

MOST_BYTES = 64 * 1024
Number = Annotated[int, Meta(ge=0, le=10**6)]
Name = Annotated[str, Meta(min_length=1, max_length=300)]
Run = Annotated[str, Meta(max_length=300)]
Names = Annotated[list[Name], Meta(max_length=32)]
Seconds = Annotated[float, Meta(ge=-1e9, le=1e9)]
Bins = Annotated[int, Meta(ge=2, le=4096)]


class Message(Struct, tag_field="do", tag=str.lower, forbid_unknown_fields=True):
    """One of these, told apart by `do`: its name in small letters."""


class Request(Message):
    """One whose answer repeats its number."""

    id: Number


class Hello(Message):
    """The first word of a client."""

    token: Annotated[str, Meta(max_length=MOST_TOKEN)]
    run: Run = ""  # which it had chosen, of several


class Panel(Request):
    """Curves over time, of at most 32 variables: of the newest `window_s`, or of a span."""

    names: Names
    bins: Bins
    window_s: Annotated[float, Meta(gt=0, le=3600)] | None = None
    from_s: Seconds = 0.0
    to_s: Seconds = 0.0


class Phase(Request):
    """One variable over another: at most `points` of the newest `window_s`, or up to `to_s`."""

    names: Annotated[list[Name], Meta(min_length=2, max_length=2)]
    points: Bins
    window_s: Annotated[float, Meta(gt=0, le=3600)]
    to_s: Seconds | None = None


class Drop(Request):
    """A panel is not shown any more."""


class At(Message):
    """The instant of a log that is looked at."""

    t_s: Seconds


class Set(Request):
    """Parameters of one node, all between the same two cycles or none."""

    values: Annotated[dict[Name, float], Meta(min_length=1, max_length=64)]


class Choose(Request, tag="run"):
    """Show this run from now on; "": whatever runs."""

    run: Run


class Undo(Request):
    """Give the parameters back what they had before the newest tuning."""


class Act(Request):
    """One of ACTIONS."""

    what: Annotated[str, Meta(max_length=20)]


class Fault(Request):
    """Begin a fault on purpose of the rig, or end it."""

    name: Name
    end: bool = False
    for_s: Annotated[float, Meta(gt=0, le=1e6)] | None = None


class Handover(Request):
    """Let another controller take over."""

    controller: Name


class Record(Request):
    """Begin to record what runs into a file of the host, or end it."""

    end: bool = False


class Snapshot(Request):
    """Write the newest seconds that the host has into a file of its own."""

    last_s: Annotated[float, Meta(gt=0, le=120)] = 30.0


PanelMessage = Panel | Phase | Drop
Action = Set | Undo | Act | Fault | Handover | Record | Snapshot
Word = Hello | PanelMessage | At | Choose | Action
_DECODER = msgspec.json.Decoder(Word)


class WrongMessage(ValueError):
    """A message that is none of these, in words."""


def read(message: str | bytes) -> Word:
    """Return what a message of a page asks; WrongMessage."""
    try:
        return _DECODER.decode(message)
    except (msgspec.MsgspecError, RecursionError, UnicodeError) as error:
        raise WrongMessage(f"not a message: {error}") from None
