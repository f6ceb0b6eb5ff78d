"""What a reader of a recording yields, and its account of everything else in the file.

Each line or object of a recording ends in one of these:

    frames     data frames, which a log holds
    left_out   other frames, by kind: error, remote, request, CAN XL, ...
    others     what is no frame: events, statistics
    damage     what could not be read, with the place
"""

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

from pcpc.drivers.can.wire_layout import LENGTHS, Flag
from pcpc.drivers.errors import printable

LATEST_NS = 1 << 62  # in the year 2116
CLASSIC_BYTES, MOST_BYTES = 8, LENGTHS[-1]
STANDARD_IDS, EXTENDED_IDS = 1 << 11, 1 << 29
LONG_J1939 = "J1939 of more than 8 bytes"
DATA_LOST = ("CAN XL", "symbolic", LONG_J1939)  # kinds that carry data which a log then lacks
PLACES = 8  # as many places of damage are kept as text
_RESOLVES_NS_S = 2.0**22  # float64 seconds from here on are more than 1 ns apart


class NotReadError(Exception):
    """The file is no recording that this program reads; the text says what it is, and the cure."""


class RecordedFrame(NamedTuple):
    """A frame: `kind` is empty for a data frame, else why a log does not hold it."""

    time_ns: int
    number: int = 0
    extended: bool = False
    data: bytes = b""
    flags: int = Flag.NONE
    is_received: bool = True
    channel: str | None = None
    kind: str = ""


@dataclass
class Account:
    """What was left out of a recording, by reason; `notes` are lines for the report."""

    left_out: Counter[str] = field(default_factory=Counter)
    others: int = 0
    damaged: int = 0  # places
    damage: list[str] = field(default_factory=list)  # the first of them
    notes: list[str] = field(default_factory=list)
    may_be_distances: bool = False  # its stamps look like candump's -td, or -tz
    declared: str = ""  # number and checksum of frames that the file says it has

    def lose(self, place: str, reason: object) -> None:
        """Note a place of which something could not be read; what follows from it is not told."""
        if self.damage and self.damage[-1].startswith(f"{place}: "):
            return
        self.damaged += 1
        if len(self.damage) < PLACES:
            text = printable(" ".join(str(reason).split())[:160])
            self.damage.append(f"{place}: {text}")

    def note(self, line: str) -> None:
        """Keep a line for the report, once."""
        if line not in self.notes:
            self.notes.append(line)

    @property
    def is_whole(self) -> bool:
        """Return whether no data frame of the file is missing."""
        return not self.damaged and not any(self.left_out[kind] for kind in DATA_LOST)


def data_frame(
    time_ns: int,
    number: int,
    extended: bool,
    data: bytes,
    flags: int = Flag.NONE,
    is_received: bool = True,
    channel: str | None = None,
) -> RecordedFrame:
    """Return a data frame; ValueError if no bus could have carried it.

    Data of CAN FD are padded with zeros to a length that it has, as can-utils does.
    """
    if not 0 <= number < (EXTENDED_IDS if extended else STANDARD_IDS):
        raise ValueError(f"no id of {'29' if extended else '11'} bits: {number:#x}")
    if not 0 <= time_ns < LATEST_NS:
        raise ValueError(f"a stamp of {time_ns / 1e9:.9g} s")
    most = MOST_BYTES if flags & Flag.FD else CLASSIC_BYTES
    if len(data) > most:
        raise ValueError(f"{len(data)} bytes, a frame of its kind has {most} at most")
    if flags & Flag.FD and len(data) not in LENGTHS:
        data = data.ljust(next(n for n in LENGTHS if n >= len(data)), b"\0")
    return RecordedFrame(time_ns, number, extended, data, flags, is_received, channel)


def flags_by_size(data: bytes) -> int:
    """Return the flags of a frame of which a file has only the data: above 8 bytes it is of FD."""
    return int(Flag.FD if len(data) > CLASSIC_BYTES else Flag.NONE)


def classic_bytes(dlc: int) -> int:
    """Return the length that a DLC of a classic frame means: 9 to 15 are 8 (ISO 11898-1)."""
    if not 0 <= dlc < len(LENGTHS):
        raise ValueError(f"DLC {dlc}; expected 0 to 15")
    return min(dlc, CLASSIC_BYTES)


def number_of(text: str, base: int, what: str) -> int:
    """Return a number without sign; ValueError says what was expected."""
    try:
        number = int(text, base)
    except ValueError:
        number = -1
    if number < 0 or "_" in text or not text[:1].isalnum():
        raise ValueError(f"expected {what}, not {text[:20]!r}")
    return number


def ns_of(text: str) -> int:
    """Return the ns of decimal seconds, each digit of them, by point or comma; ValueError."""
    whole, _, digits = text.removeprefix("-").replace(",", ".").partition(".")
    if not (whole.isascii() and whole.isdigit() and len(whole) < 20):
        raise ValueError(f"expected seconds, not {text[:30]!r}")
    if digits and not (digits.isascii() and digits.isdigit()):
        raise ValueError(f"expected seconds, not {text[:30]!r}")
    time_ns = int(whole) * 10**9 + int((digits + "000000000")[:9])
    return -time_ns if text.startswith("-") else time_ns


def ns_of_float(seconds: float) -> int:
    """Return the ns of float seconds, to the nearest us once they no longer resolve ns."""
    if not math.isfinite(seconds):
        raise ValueError(f"a stamp of {seconds} s")
    whole = math.floor(seconds)
    if abs(seconds) < _RESOLVES_NS_S:
        return whole * 10**9 + round((seconds - whole) * 1e9)
    return whole * 10**9 + round((seconds - whole) * 1e6) * 1000
