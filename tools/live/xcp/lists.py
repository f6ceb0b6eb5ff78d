"""DAQ lists of an XCP session: what is sent of each cycle, built by commands in their order.

A list has object descriptor tables (ODT), each a packet: its number, in the first of a list a time
stamp, then bytes of recorded variables. FREE, ALLOC_DAQ, ALLOC_ODT, ALLOC_ODT_ENTRY follow each
other; WRITE_DAQ fills; what runs is not changed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from pcpc.tools.live.xcp.packets import ETHERNET, CommandRefused, Err, Link

MOST_ODTS, MOST_ENTRIES = 252, 20_000  # numbers behind are no ODT's; what a session may keep
STAMP = Struct("<I")  # microseconds of the run, which come round after 71 minutes
TIMESTAMP, NOT_OURS = 0x10, 0x23  # of a list's mode: alternating, stimulation, no number
DIVISIONS = (1, 10, 100)  # event channels: every cycle, every tenth, every hundredth

Entry = tuple[int, int]  # address, bytes


@dataclass
class _List:
    odts: list[list[Entry | None]] = field(default_factory=list)
    mode: int = 0
    event: int = 0
    prescaler: int = 1
    selected: bool = False
    places: list[NDArray[np.intp]] | None = None  # bytes of a row by ODT; None: it does not run

    @property
    def stamped(self) -> bool:
        return bool(self.mode & TIMESTAMP)


class DaqLists:
    """Those of a session. `columns`: of each variable its place in a row, -1 for none."""

    def __init__(self, columns: Sequence[int], link: Link = ETHERNET) -> None:
        self._columns, self._link = columns, link
        self.lists: list[_List] = []
        self._stage = ""
        self._pointer: tuple[int, int, int] | None = None

    @property
    def running(self) -> bool:
        """Whether any is sent."""
        return any(one.places is not None for one in self.lists)

    def of(self, number: int) -> _List:
        """Return a list; Refused."""
        if number >= len(self.lists):
            raise CommandRefused(Err.OUT_OF_RANGE)
        return self.lists[number]

    # Building

    def free(self) -> None:
        """Leave all lists, running ones too."""
        self.lists, self._pointer, self._stage = [], None, "free"

    def alloc(self, count: int) -> None:
        """Make lists; Refused."""
        self._follows("free")
        if count > MOST_ODTS:
            raise CommandRefused(Err.MEMORY_OVERFLOW)
        self.lists, self._stage = [_List() for _ in range(count)], "daq"

    def alloc_odts(self, number: int, count: int) -> None:
        """Make the tables of a list; Refused."""
        self._follows("daq", "odt")
        daq_list = self.of(number)
        if sum(len(each.odts) for each in self.lists) - len(daq_list.odts) + count > MOST_ODTS:
            raise CommandRefused(Err.MEMORY_OVERFLOW)
        daq_list.odts, self._stage = [[] for _ in range(count)], "odt"

    def alloc_entries(self, number: int, odt: int, count: int) -> None:
        """Make the entries of a table; Refused."""
        self._follows("odt", "entry")
        daq_list = self.of(number)
        if odt >= len(daq_list.odts):
            raise CommandRefused(Err.OUT_OF_RANGE)
        kept = sum(len(entries) for each in self.lists for entries in each.odts)
        if kept - len(daq_list.odts[odt]) + count > MOST_ENTRIES:
            raise CommandRefused(Err.MEMORY_OVERFLOW)
        daq_list.odts[odt], self._stage = [None] * count, "entry"

    def _follows(self, *stages: str) -> None:
        if self.running:
            raise CommandRefused(Err.DAQ_ACTIVE)
        if self._stage not in stages:
            raise CommandRefused(Err.SEQUENCE)

    def clear(self, number: int) -> None:
        """Stop and empty a list; Refused."""
        one = self.of(number)
        one.places, one.selected = None, False
        one.odts = [[None] * len(entries) for entries in one.odts]

    def point(self, number: int, odt: int, entry: int) -> None:
        """Choose the entry that is written or read next; Refused."""
        odts = self.of(number).odts
        if odt >= len(odts) or entry >= len(odts[odt]):
            raise CommandRefused(Err.OUT_OF_RANGE)
        self._pointer = number, odt, entry

    def write(self, bit: int, size: int, extension: int, address: int) -> None:
        """Fill the chosen entry; the next one of its table is chosen then. Refused."""
        number, odt, entry = self._choice()
        daq_list = self.lists[number]
        if daq_list.places is not None:
            raise CommandRefused(Err.DAQ_ACTIVE)
        most = min(8 - address % 8, self._link.dto - 1)
        if bit != 0xFF or extension or not 0 < size <= most:
            raise CommandRefused(Err.OUT_OF_RANGE)
        if address // 8 >= len(self._columns):
            raise CommandRefused(Err.OUT_OF_RANGE)
        if self._columns[address // 8] < 0:
            raise CommandRefused(Err.DAQ_CONFIG)  # a variable that is not recorded
        daq_list.odts[odt][entry] = address, size
        self._pointer = number, odt, entry + 1

    def read(self) -> Entry:
        """Return the chosen entry, (0, 0) if it is empty; Refused."""
        number, odt, entry = self._choice()
        self._pointer = number, odt, entry + 1
        return self.lists[number].odts[odt][entry] or (0, 0)

    def _choice(self) -> tuple[int, int, int]:
        if self._pointer is None:
            raise CommandRefused(Err.SEQUENCE)
        number, odt, entry = self._pointer
        if entry >= len(self.lists[number].odts[odt]):
            raise CommandRefused(Err.OUT_OF_RANGE)
        return number, odt, entry

    # Running

    def set_mode(self, mode: int, number: int, event: int, prescaler: int, _: int) -> None:
        """Say when a list is sent; Refused. The last one would be its priority."""
        daq_list = self.of(number)
        if daq_list.places is not None:
            raise CommandRefused(Err.DAQ_ACTIVE)
        if mode & NOT_OURS:
            raise CommandRefused(Err.MODE_NOT_VALID)
        if event >= len(DIVISIONS) or not prescaler:
            raise CommandRefused(Err.OUT_OF_RANGE)
        daq_list.mode, daq_list.event, daq_list.prescaler = mode & TIMESTAMP, event, prescaler

    def first(self, number: int) -> int:
        """Return the number of a list's first packet."""
        return sum(len(one.odts) for one in self.lists[:number])

    def start(self, *numbers: int) -> None:
        """Send lists from the next cycle on, all or none; Refused."""
        started = {number: self._places(self.of(number)) for number in numbers}
        frames_asked = sum(
            len(one.odts) / (DIVISIONS[one.event] * one.prescaler)
            for number, one in enumerate(self.lists)
            if number in started or one.places is not None
        )
        if frames_asked > self._link.frames:
            raise CommandRefused(Err.DAQ_CONFIG)
        for number, places in started.items():
            self.lists[number].places = places

    def _places(self, daq_list: _List) -> list[NDArray[np.intp]]:
        tables = []
        for i, entries in enumerate(daq_list.odts):
            stamp = STAMP.size * (daq_list.stamped and not i)  # which may stand alone
            if None in entries or not (entries or stamp):
                raise CommandRefused(Err.DAQ_CONFIG)
            bytes_of_entries = [
                address + byte for address, size in filter(None, entries) for byte in range(size)
            ]
            places = [8 * self._columns[at // 8] + at % 8 for at in bytes_of_entries]
            if 1 + stamp + len(places) > self._link.dto:
                raise CommandRefused(Err.DAQ_CONFIG)
            tables.append(np.array(places, np.intp))
        if not tables:
            raise CommandRefused(Err.DAQ_CONFIG)
        return tables

    def stop(self, number: int) -> None:
        """Send a list no more; Refused."""
        self.of(number).places = None

    def packets(
        self, cycle: NDArray[np.int64], period_us: float, values: NDArray[np.float64]
    ) -> Iterator[bytes]:
        """Yield what is sent of cycles (n,) with values (n, columns): each cycle's in its order."""
        raw = np.ascontiguousarray(values).view(np.uint8).reshape(len(cycle), -1)
        for row, number in enumerate(cycle.tolist()):
            for i, daq_list in enumerate(self.lists):
                if daq_list.places is None or number % (
                    DIVISIONS[daq_list.event] * daq_list.prescaler
                ):
                    continue
                for odt, places in enumerate(daq_list.places):
                    stamp = daq_list.stamped and not odt
                    told = STAMP.pack(round(number * period_us) & 0xFFFFFFFF) if stamp else b""
                    yield bytes([self.first(i) + odt]) + told + raw[row, places].tobytes()
