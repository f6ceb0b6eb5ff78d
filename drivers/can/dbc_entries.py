"""The frames and signals of a DBC file: what is well-formed, and a list of what is left out.

An entry that is no DBC, that refers to what is not there, or that says what cannot be, is left out
and listed. Where it changes what a frame means, no node may use this frame.

    ids            above 0x7FF without bit 31 are of 29 bits, as no others can be meant
    equal ids      the first frame counts
    equal names    of frames: the later one has its id behind its name
    long names     `System...LongSymbol` is the name, everywhere
    multiplexer    without SG_MUL_VAL_ the only one that is in all layouts

Source: Vector, DBC File Format Documentation 1.0.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation

from pcpc.drivers.can.dbc_syntax import DbcEntry, entries, id_of, names

MOST_BYTES = 1785  # of the longest message that a DBC file is used for, J1939's transport
MOST_MULTIPLEXED = 1 << 16  # multiplexer values of all signals together
NOBODY = "Vector__XXX"
_OF_NO_FRAME = "VECTOR__INDEPENDENT_SIG_MSG"  # CANdb++'s place for signals without a frame
_EXTENDED, _HIGHEST_11, _HIGHEST_29 = 1 << 31, 0x7FF, 0x1FFFFFFF
_LARGEST = 10**18  # of a whole number
_MARKER = re.compile(r"M|m(\d{1,9})M?")
_RANGE = re.compile(r"(\d++)\s*+-\s*+(\d++)")
_PLAIN_NAME = re.compile(r"\w+", re.ASCII)
_CHANGING = ("BO_TX_BU_", "SIG_VALTYPE_", "SG_MUL_VAL_")  # what a frame means


@dataclass(frozen=True)
class OddEntry:
    """What is left out: its place (line, or line and column) and why.

    `frame`: the id, see DescribedFrame, of the one that no node may use. `nodes`: those of a frame
    that is not there.
    """

    place: str
    what: str
    frame: int | None = None
    nodes: frozenset[str] = frozenset()

    def __str__(self) -> str:
        return f"line {self.place}: {self.what}"


@dataclass
class DescribedSignal:
    """A signal; `ranges` of the multiplexer `chooser` with which it comes, none: it always does."""

    name: str
    groups: dict[str, str]
    chooser: "DescribedSignal | None" = None
    ranges: list[tuple[int, int]] = field(default_factory=list)

    @property
    def marker(self) -> str:
        """Its M, m0 or m0M."""
        return self.groups.get("marker", "")

    @property
    def chooses(self) -> bool:
        """Whether it is a multiplexer."""
        return self.marker.endswith("M")


@dataclass
class DescribedFrame:
    """A frame; `number` has bit 31 if its id is of 29 bits.

    `refusal`: why it is left out. `rival`: the id of the frame that has its own.
    """

    name: str
    number: int
    place: str
    length: int = 0
    sender: str = NOBODY
    signals: list[DescribedSignal] = field(default_factory=list)
    refusal: str = ""
    rival: int | None = None

    def named(self, name: str) -> list[DescribedSignal]:
        """Return its signals of a name, which several may have."""
        return [one for one in self.signals if one.groups["name"] == name]


class Description:
    """The entries of a DBC file. `others`: by keyword, those that refer to frames and signals."""

    def __init__(self, content: str) -> None:
        self.frames: dict[int, DescribedFrame] = {}  # by the id as the file writes it
        self.nodes: list[str] = []
        self.others: dict[str, list[DbcEntry]] = {}
        self.odd: list[OddEntry] = []
        self.count = 0  # of entries that are DBC
        self._of_no_frame: set[int] = set()
        self._refused: list[DescribedFrame] = []
        self._current: DescribedFrame | None = None
        for entry in entries(content):
            self._take(entry)
        for frame in self._refused:
            heard = [name for one in frame.signals for name in names(one.groups["names"])]
            nodes = frozenset({frame.sender, *heard} - {NOBODY})
            self.odd.append(OddEntry(frame.place, frame.refusal, frame.rival, nodes))
        self._multiplex()

    def leave_out(self, place: str, what: str, frame: DescribedFrame | None = None) -> None:
        """List what is left out; `frame` is the one whose meaning it would change."""
        self.odd.append(OddEntry(place, what, frame.number if frame else None))

    def those_meant(self, entry: DbcEntry) -> tuple[DescribedFrame, list[DescribedSignal]] | None:
        """Return the frame of an entry, with its signals of this name; else list it, None."""
        entry_label = f"{entry.keyword} {entry.number}"
        frame = self.frames.get(entry.number or 0)
        if frame is None and entry.number in self._of_no_frame:
            return None
        if frame is None:
            self.leave_out(entry.place, f"{entry_label}: there is no frame with this id")
            return None
        name = entry.groups.get("signal", "")
        signals = frame.named(name)
        if name and not signals:
            problem = f"{entry_label} {name}: frame {frame.name} has no such signal"
            self.leave_out(entry.place, problem)
            return None
        return frame, signals

    def _take(self, entry: DbcEntry) -> None:
        if entry.misfit:
            self._take_misfit(entry)
            return
        self.count += 1
        if entry.keyword == "BO_":
            self._new_frame(entry)
        elif entry.keyword == "SG_":
            self._new_signal(entry)
        else:
            self._current = None
            if entry.keyword == "BU_":
                self.nodes += [one for one in names(entry.groups["names"]) if one != NOBODY]
            self.others.setdefault(entry.keyword, []).append(entry)

    def _take_misfit(self, entry: DbcEntry) -> None:
        frame = self._current
        if entry.keyword == "BO_":
            words = entry.text.split("\n")[0].split()
            sender = words[-1] if len(words) > 1 else NOBODY
            self._current = DescribedFrame("", 0, entry.place, 0, sender, refusal=entry.misfit)
            self._refused.append(self._current)
        elif entry.keyword == "SG_" and frame is not None:
            if not frame.refusal:
                self.leave_out(entry.place, entry.misfit, frame)
        else:
            number = re.search(r"-?\d+", entry.text) if entry.keyword in _CHANGING else None
            frame = self.frames.get(id_of(number[0])) if number else None
            self.leave_out(entry.place, entry.misfit, frame)

    def _new_frame(self, entry: DbcEntry) -> None:
        groups, number = entry.groups, entry.number or 0
        frame = DescribedFrame(groups["name"], number, entry.place)
        frame.sender = groups.get("sender", NOBODY)
        self._current = frame
        if frame.name == _OF_NO_FRAME:
            frame.refusal = f"{_OF_NO_FRAME}: its signals are of no frame"
            self._of_no_frame.add(number)
            self.leave_out(frame.place, frame.refusal)
            return
        if why := self._why_no_frame(frame, groups["length"]):
            frame.refusal = f"frame {frame.name}: {why}"
            self._refused.append(frame)
            return
        frame.length = int(groups["length"])
        self.frames[number] = frame
        if _HIGHEST_11 < number < _EXTENDED:
            frame.number |= _EXTENDED
            what = f"frame {frame.name}: id {number:#x} is more than 11 bits, and bit 31 is not set"
            self.leave_out(frame.place, f"{what}; read as extended; write {frame.number}", frame)

    def _why_no_frame(self, frame: DescribedFrame, length: str) -> str:
        if len(length) > 9 or not 0 <= int(length) <= MOST_BYTES:
            return f"{length[:20]} bytes; classic CAN has 8, CAN FD 64; correct its length"
        if frame.number & ~_EXTENDED > _HIGHEST_29:
            return f"id {frame.number:#x} is more than 29 bits; correct its id"
        if (first := self.frames.get(frame.number)) is not None:
            frame.rival, word = first.number, frame.number & ~_EXTENDED
            both = f"{first.name} and {frame.name} (id {word:#x}) have the same id"
            return f"{both}; the first counts; make them differ"
        return ""

    def _new_signal(self, entry: DbcEntry) -> None:
        frame, groups = self._current, entry.groups
        if frame is None:
            problem = f"SG_ {groups['name']}: a signal of no frame; put it behind its BO_"
            self.leave_out(entry.place, problem)
            return
        signal = DescribedSignal(groups["name"], groups)
        if not frame.refusal and (why := _why_no_signal(signal)):
            self.leave_out(entry.place, f"frame {frame.name}: {signal.name}{why}", frame)
            return
        if not frame.refusal and signal.marker and not _MARKER.fullmatch(signal.marker):
            problem = f"frame {frame.name}: {signal.name}: {groups.pop('marker')[:20]} is no marker"
            cure = "read as always there; expected M, m0 or m0M"
            self.leave_out(entry.place, f"{problem} of a multiplexer, {cure}", frame)
        frame.signals.append(signal)

    # multiplexers

    def _multiplex(self) -> None:
        """Give each multiplexed signal its multiplexer; leave out one that has none."""
        count = 0
        for entry in self.others.get("SG_MUL_VAL_", []):
            meant = self.those_meant(entry)
            if meant is None:
                continue
            frame, signals = meant
            ranges = [(int(a[:20]), int(b[:20])) for a, b in _RANGE.findall(entry.groups["ranges"])]
            count += sum(1 + max(0, high - low) for low, high in ranges)
            why = _why_not_multiplexed(frame, signals, entry.groups["chooser"])
            if count > MOST_MULTIPLEXED:
                count, (low, high) = 0, max(ranges, key=lambda one: one[1] - one[0])
                why = f": {low}-{high}: more than {MOST_MULTIPLEXED} values of a multiplexer"
            if any(low > high for low, high in ranges):
                why = ": a range that ends before it begins; write its lower end first"
            if why:
                what = f"SG_MUL_VAL_ {entry.number} {entry.groups['signal']}{why}"
                self.leave_out(entry.place, what, frame)
                continue
            for signal in _those_in(signals, ranges):
                signal.chooser = frame.named(entry.groups["chooser"])[0]
                signal.ranges += ranges
        for frame in self.frames.values():
            self._multiplex_frame(frame)

    def _multiplex_frame(self, frame: DescribedFrame) -> None:
        always = [one for one in frame.signals if one.marker == "M" and one.chooser is None]
        for signal in frame.signals:
            if signal.marker.startswith("m") and signal.chooser is None and len(always) == 1:
                layout = int(signal.marker[1:].removesuffix("M"))
                signal.chooser, signal.ranges = always[0], [(layout, layout)]
        reachable = [one for one in frame.signals if _is_reached(one)]
        for signal in frame.signals:
            if not any(signal is one for one in reachable):
                problem = f"frame {frame.name}: {signal.name} ({signal.marker}): its multiplexer is"
                cure = "give it an SG_MUL_VAL_" if len(always) > 1 else "mark one as M"
                which = "not known" if len(always) > 1 else "not there"
                self.leave_out(frame.place, f"{problem} {which}; {cure}", frame)
        frame.signals = reachable


def whole_number(text: str) -> int | None:
    """Return the whole number of a text, also in quotes; None if it is none."""
    try:
        value = Decimal(text.strip('"'))
        return int(value) if abs(value) < _LARGEST and value == int(value) else None
    except (InvalidOperation, ValueError, OverflowError):
        return None


def is_name(text: str) -> bool:
    """Return whether a text can name a frame or a signal."""
    return _PLAIN_NAME.fullmatch(text) is not None


def _why_no_signal(signal: DescribedSignal) -> str:
    start, bits = signal.groups["start"], signal.groups["bits"]
    most = 8 * MOST_BYTES
    if max(len(start), len(bits)) > 9 or not 0 <= int(start) <= most or int(bits) > most:
        return f": {start[:20]}|{bits[:20]} lies in no frame; correct its start and length"
    if int(bits) == 0:
        return ": its length 0 is not greater than 0; correct its length"
    return ""


def _why_not_multiplexed(
    frame: DescribedFrame, signals: Iterable[DescribedSignal], chooser: str
) -> str:
    choosers = frame.named(chooser)
    if len(choosers) != 1 or not choosers[0].chooses:
        return f": frame {frame.name} has no multiplexer {chooser}"
    if not all(one.marker for one in signals):
        return ": it is always there; mark it as m0, or leave this out"
    return ""


def _those_in(
    signals: list[DescribedSignal], ranges: list[tuple[int, int]]
) -> Iterator[DescribedSignal]:
    """Yield the signal of a name that is meant: of several, those whose marker is in a range."""
    for signal in signals:
        layout = int(signal.marker[1:].removesuffix("M") or "0")
        if len(signals) == 1 or any(low <= layout <= high for low, high in ranges):
            yield signal


def _is_reached(signal: DescribedSignal) -> bool:
    """Return whether the multiplexers of a signal end with one that is always there."""
    seen: list[DescribedSignal] = []
    while signal.chooser is not None:
        if any(signal is one for one in seen):
            return False
        seen.append(signal)
        signal = signal.chooser
    return not signal.marker.startswith("m")
