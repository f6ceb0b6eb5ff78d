"""An XCP slave: packets of one master in, packets out; no sockets, no clock of its own.

Addresses are numbers of names, never memory: extension 0 has the node's variables, number i at
8 i .. 8 i + 7, a little-endian double; 1 the A2L file, 2 a text that a command tells. Nothing else
can be read. A value that is read in parts is that of its first part. Written are whole parameters,
all of a command or block between the same two cycles or none; the event packet behind the answer,
FD FE, has the first cycle with them in 8 bytes, on classic CAN in 6.
"""

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from struct import Struct

import numpy as np
from numpy.typing import NDArray

from pcpc.tools.live.xcp.lists import DIVISIONS, STAMP, DaqLists
from pcpc.tools.live.xcp.packets import (
    CAL_PAG,
    DAQ,
    ETHERNET,
    EV_USER,
    EVENT,
    LAYOUTS,
    POSITIVE,
    Cmd,
    CommandRefused,
    Err,
    Link,
)

VARIABLES, FILE, TEXT = 0, 1, 2  # address extensions
CRC_32 = 0x09
RUNNING_DAQ = 0x40  # of a session's status
_OF_LISTS = {
    Cmd.FREE_DAQ: "free", Cmd.ALLOC_DAQ: "alloc", Cmd.ALLOC_ODT: "alloc_odts",
    Cmd.ALLOC_ODT_ENTRY: "alloc_entries", Cmd.CLEAR_DAQ_LIST: "clear", Cmd.SET_DAQ_PTR: "point",
    Cmd.WRITE_DAQ: "write", Cmd.SET_DAQ_LIST_MODE: "set_mode",
}  # fmt: skip
_UNITS = 10  # of time: 1 ns, 10 ns ... 1 s
_STAMPS = 0x34  # 4 bytes, of microseconds


@dataclass(frozen=True)
class NodeTable:
    """A node, as a slave has it.

    names     of its variables, in the order of their numbers
    columns   the place of each in a recorded row, -1 for what is not recorded
    read      all values (names,) and their cycle
    write     values by name; returns the first cycle with them, Refused
    """

    name: str
    rig: str
    period_ns: int
    names: list[str]
    columns: list[int]
    a2l: bytes
    read: Callable[[], tuple[int, NDArray[np.float64]]]
    write: Callable[[Mapping[str, float]], int]


class XcpSession:
    """The slave's side of one master."""

    def __init__(self, node: NodeTable, link: Link = ETHERNET) -> None:
        self._node, self._link, self.connected = node, link, False
        self.daq = DaqLists(node.columns, link)
        self._mta = VARIABLES, 0
        self._text = b""
        self._seen, self._seen_to = b"", 0  # all values, and where the part that was read ends
        self._block, self._left = b"", 0  # of DOWNLOAD, and how many bytes are to come

    def answers(self, packet: bytes) -> list[bytes]:
        """Return what is answered to a command; nothing as long as nobody is connected."""
        if not packet or not (self.connected or packet[0] == Cmd.CONNECT):
            return []
        try:
            return self._answers(packet)
        except CommandRefused as refused:
            return [refused.packet]

    def packets(self, cycle: NDArray[np.int64], values: NDArray[np.float64]) -> list[bytes]:
        """Return what running lists send of recorded cycles (n,), values (n, columns)."""
        return [*self.daq.packets(cycle, 1e-3 * self._node.period_ns, values)]

    def _answers(self, packet: bytes) -> list[bytes]:
        try:
            command = Cmd(packet[0])
        except ValueError:
            raise CommandRefused(Err.CMD_UNKNOWN) from None
        if command != Cmd.DOWNLOAD_NEXT:
            self._left = 0
        body = packet[1:]
        name = _OF_LISTS.get(command)
        method = getattr(self.daq, name) if name else getattr(self, f"_{command.name.lower()}")
        if (layout := LAYOUTS.get(command)) is None:
            return list(method(body))
        found = method(*layout.unpack(self._part(body, 0, layout.size))) or b""
        return [POSITIVE + found] if isinstance(found, bytes) else found

    def _part(self, body: bytes, begin: int, size: int) -> bytes:
        """Return what is the end of a packet but for the padding of CAN; Refused."""
        end = begin + size
        if len(body) < end or (len(body) > end and not self._link.can):
            raise CommandRefused(Err.CMD_SYNTAX)
        return body[begin:end]

    # The session

    def _connect(self, mode: int) -> bytes:
        if mode not in (0, 1):
            raise CommandRefused(Err.OUT_OF_RANGE)
        self.connected, self._mta = True, (VARIABLES, 0)
        self.daq.free()
        mode = 0xC0 if self._link.can else 0x80  # with blocks of the slave
        return Struct("<BBBHBB").pack(CAL_PAG | DAQ, mode, self._link.cto, self._link.dto, 1, 1)

    def _disconnect(self) -> None:
        self.connected = False
        self.daq.free()

    def _get_status(self) -> bytes:
        return Struct("<BBxH").pack(RUNNING_DAQ if self.daq.running else 0, 0, 0)

    def _synch(self) -> bytes:
        raise CommandRefused(Err.CMD_SYNCH)

    def _get_comm_mode_info(self) -> bytes:
        most = self._link.most_in_block
        return Struct("<xBxBBBB").pack(most > 0, most, self._link.apart, 0, 0x10)

    def _get_id(self, kind: int) -> bytes:
        rig = self._node.rig
        if kind == 4:
            self._mta = FILE, 0
            return Struct("<BxxI").pack(0, len(self._node.a2l))
        told = {0: self._node.name, 1: rig, 2: f"{rig}.a2l"}.get(kind, "")
        return Struct("<BxxI").pack(0, self._tell(told))

    def _tell(self, text: str) -> int:
        self._text, self._mta = text.encode(), (TEXT, 0)
        return len(self._text)

    def _get_seed(self, mode: int, resource: int) -> bytes:
        return b"\x00"  # nothing is protected by a key

    # Memory

    def _set_mta(self, extension: int, address: int) -> None:
        self._mta = extension, address

    def _upload(self, count: int) -> list[bytes]:
        extension, address = self._mta
        size = self._link.cto - 1
        found = self._bytes(extension, address, count, 255 if self._link.can else size)
        self._mta = extension, address + count
        return [POSITIVE + found[begin : begin + size] for begin in range(0, count, size)]

    def _short_upload(self, count: int, extension: int, address: int) -> list[bytes]:
        if count >= self._link.cto:
            raise CommandRefused(Err.OUT_OF_RANGE)
        self._mta = extension, address
        return self._upload(count)

    def _build_checksum(self, count: int) -> bytes:
        extension, address = self._mta
        found = zlib.crc32(self._bytes(extension, address, count, 1 << 30))
        self._mta = extension, address + count
        return Struct("<BxxI").pack(CRC_32, found)

    def _bytes(self, extension: int, address: int, count: int, most: int) -> bytes:
        sizes = {
            VARIABLES: 8 * len(self._node.names), FILE: len(self._node.a2l), TEXT: len(self._text)
        }  # fmt: skip
        if not 0 < count <= most or address + count > sizes.get(extension, 0):
            raise CommandRefused(Err.OUT_OF_RANGE)
        if extension != VARIABLES:
            return (self._node.a2l if extension == FILE else self._text)[address : address + count]
        if address % 8 == 0 or address != self._seen_to:
            self._seen = self._node.read()[1].astype("<f8").tobytes()
        self._seen_to = address + count
        return self._seen[address : address + count]

    def _download(self, body: bytes) -> list[bytes]:
        if not body:
            raise CommandRefused(Err.CMD_SYNTAX)
        self._block = b""
        return self._more(body, body[0])

    def _download_next(self, body: bytes) -> list[bytes]:
        left, self._left = self._left, 0
        if not left or body[:1] != bytes([left]):
            raise CommandRefused(Err.SEQUENCE, left)
        return self._more(body, left)

    def _more(self, body: bytes, left: int) -> list[bytes]:
        """Take a part of a block, of which `left` bytes are to come; write all at its end."""
        part = min(left, self._link.cto - 2) if self._link.can else left
        self._block += self._part(body, 1, part)
        self._left = left - part
        return [] if self._left else self._write_memory(self._block)

    def _short_download(self, body: bytes) -> list[bytes]:
        head = Struct("<BxBI")
        if len(body) < head.size:
            raise CommandRefused(Err.CMD_SYNTAX)
        count, extension, address = head.unpack(body[: head.size])
        data = self._part(body, head.size, count)
        self._mta = extension, address
        return self._write_memory(data)

    def _write_memory(self, data: bytes) -> list[bytes]:
        (extension, address), names = self._mta, self._node.names
        if extension != VARIABLES:
            raise CommandRefused(
                Err.WRITE_PROTECTED if extension in (FILE, TEXT) else Err.OUT_OF_RANGE
            )
        if not data or address % 8 or len(data) % 8 or address + len(data) > 8 * len(names):
            raise CommandRefused(Err.OUT_OF_RANGE)
        values = np.frombuffer(data, "<f8").tolist()
        first = address // 8
        cycle = self._node.write(dict(zip(names[first : first + len(values)], values, strict=True)))
        self._mta = extension, address + len(data)
        return [POSITIVE, Struct("<BBQ").pack(EVENT, EV_USER, cycle)[: self._link.cto]]

    # Measurement

    def _get_daq_processor_info(self) -> bytes:
        return Struct("<BHHBB").pack(0x93, 252, len(DIVISIONS), 0, 0)

    def _get_daq_resolution_info(self) -> bytes:
        return Struct("<BBBBBH").pack(1, min(8, self._link.dto - 1), 1, 0, _STAMPS, 1)

    def _get_daq_event_info(self, event: int) -> bytes:
        if event >= len(DIVISIONS):
            raise CommandRefused(Err.OUT_OF_RANGE)
        cycle, unit = period(self._node.period_ns * DIVISIONS[event])
        return Struct("<BBBBBB").pack(0x04, 0xFF, self._tell(event_name(event)), cycle, unit, 0)

    def _get_daq_clock(self) -> bytes:
        cycle, _ = self._node.read()
        stamp = round(1e-3 * cycle * self._node.period_ns) & 0xFFFFFFFF
        return Struct("<xBB").pack(0, 0) + STAMP.pack(stamp)

    def _get_daq_list_info(self, number: int) -> bytes:
        one = self.daq.of(number)
        return Struct("<BBBH").pack(0x04, len(one.odts), max(map(len, one.odts), default=0), 0)

    def _get_daq_list_mode(self, number: int) -> bytes:
        one = self.daq.of(number)
        mode = one.mode | one.selected | (0x40 if one.places is not None else 0)
        return Struct("<BxxHBB").pack(mode, one.event, one.prescaler, 0)

    def _write_daq_multiple(self, body: bytes) -> list[bytes]:
        element = Struct("<BBIBx")
        if not body:
            raise CommandRefused(Err.CMD_SYNTAX)
        data = self._part(body, 1, body[0] * element.size)
        for bit, size, address, extension in element.iter_unpack(data):
            self.daq.write(bit, size, extension, address)
        return [POSITIVE]

    def _read_daq(self) -> bytes:
        address, size = self.daq.read()
        return Struct("<BBBI").pack(0xFF, size, VARIABLES, address)

    def _start_stop_daq_list(self, mode: int, number: int) -> bytes:
        daq_list = self.daq.of(number)
        if mode == 0:
            self.daq.stop(number)
        elif mode == 1:
            self.daq.start(number)
        elif mode == 2:
            daq_list.selected = True
        else:
            raise CommandRefused(Err.MODE_NOT_VALID)
        return bytes([self.daq.first(number)])

    def _start_stop_synch(self, mode: int) -> None:
        if mode not in (0, 1, 2):
            raise CommandRefused(Err.MODE_NOT_VALID)
        chosen = [i for i, one in enumerate(self.daq.lists) if one.selected or mode == 0]
        if mode == 1:
            self.daq.start(*chosen)
        for i in chosen:
            if mode != 1:
                self.daq.stop(i)
            self.daq.lists[i].selected = False


def event_name(event: int) -> str:
    """Return what an event channel is called."""
    return "cycle" if not event else f"cycle_{DIVISIONS[event]}"


def period(ns: int) -> tuple[int, int]:
    """Return a period as XCP has it: a count of at most 255, and the unit that is 10^n ns."""
    unit = 0
    while unit + 1 < _UNITS and (ns % 10 == 0 or ns > 255):
        ns, unit = round(ns / 10), unit + 1
    return min(ns, 255), unit
