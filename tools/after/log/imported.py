"""What became of a recording: the counts that `pcpc log import` prints as JSON."""

from typing import Annotated, TypedDict

from msgspec import Meta

from pcpc.tools.after.log.readers.account import PLACES
from pcpc.tools.terminal.answer import Count, Positive

_MoreThanNone = Annotated[float, Meta(gt=0)]
_Id = Annotated[str, Meta(pattern="^0x[0-9A-F]+$")]


class ClockSetBack(TypedDict):
    """Where the clock of the recorder was set back."""

    frame: Annotated[int, Meta(ge=2)]
    "of the recording, counted from 1"
    back_s: _MoreThanNone
    "s, by which its stamp lies before that of the frame ahead of it"
    shift_s: _MoreThanNone
    "s, by which stamps from there on are later than in the recording"


class Imported(TypedDict):
    """The log that was made of a recording."""

    file: str
    "that was written"
    frames: Positive
    "in the log, of all ids"
    ids: Positive
    "different ones"
    rows: Count
    "cycles of the log, 0 without a DBC file"
    signals: Count
    "variables of the log"
    duration_s: Annotated[float, Meta(ge=0)]
    "s, from the first frame to the last"
    clock_frame: str
    "each one of it begins a cycle; empty without a DBC file"
    rate_hz: _MoreThanNone
    "cycles a second, by the median; of frames without a DBC file"
    left_out: dict[str, Positive]
    "frames that a log does not hold, by kind"
    others: Count
    "lines or objects that are no frames: events, statistics"
    damaged: Count
    "places of the recording that could not be read; with any the exit code is 3"
    damage: Annotated[list[str], Meta(max_length=PLACES)]
    "the first of these places, by line, byte or row, each with the reason"
    notes: list[str]
    "what was assumed, in words"
    unsorted: Count
    "frames stamped before one ahead of them, which are sorted by their stamps"
    clock_steps: list[ClockSetBack]
    declared: str
    "number and checksum of frames that an MDF file has in its comment; empty: these are they"
    channels: dict[str, Positive]
    "frames, by channel of the recording"
    lost: Count
    "frames that the counters of their ids tell of"
    not_decoded: Count
    "frames of known ids whose bytes no signal fits"
    foreign_crc: list[str]
    "frames whose CRC is not this project's"
    not_in_dbc: list[str]
    "entries of the DBC file that are left out, each with its line and why"
    no_signal: list[str]
    "signals that do not lie in their frames, or have more than 64 bits"
    by_pgn: dict[str, _Id]
    "frames that were found by their J1939 PGN, with the recorded id"
    unknown: dict[_Id, Positive]
    "frames, by id that the DBC file does not have"
