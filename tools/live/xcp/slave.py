"""An XCP slave: packets of one master in, packets out; no sockets, no clock of its own.

Addresses are numbers of names, never memory: extension 0 has the node's variables, number i at
8 i .. 8 i + 7, a little-endian double; 1 the A2L file, 2 a text that a command tells. Nothing else
can be read. Written are whole parameters, all of a command between the same two cycles or none;
the event packet behind the answer, FD FE, has the first cycle with them in 8 bytes.
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
    EV_USER,
    EVENT,
    LAYOUTS,
    MAX_CTO,
    MAX_DTO,
    NEGATIVE,
    POSITIVE,
    Cmd,
    Err,
    Refused,
)  # fmt: skip

VARIABLES, FILE, TEXT = 0, 1, 2  # address extensions
CRC_32 = 0x09
RUNNING_DAQ = 0x40  # of a session's status
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


class Session:
    """The slave's side of one master."""

    def __init__(self, node: NodeTable) -> None:
        self._node, self.connected = node, False
        self.daq = DaqLists(node.columns)
        self._mta = VARIABLES, 0
        self._text = b""

    def answers(self, packet: bytes) -> list[bytes]:
        """Return what is answered to a command; nothing as long as nobody is connected."""
        if not packet or not (self.connected or packet[0] == Cmd.CONNECT):
            return []
        try:
            return self._done(packet)
        except Refused as refused:
            return [bytes([NEGATIVE, refused.code])]

    def packets(self, cycle: NDArray[np.int64], values: NDArray[np.float64]) -> list[bytes]:
        """Return what running lists send of recorded cycles (n,), values (n, columns)."""
        return [*self.daq.packets(cycle, 1e-3 * self._node.period_ns, values)]

    def _done(self, packet: bytes) -> list[bytes]:
        try:
            command = Cmd(packet[0])
        except ValueError:
            raise Refused(Err.CMD_UNKNOWN) from None
        body = packet[1:]
        method = getattr(self, f"_{command.name.lower()}")
        if (layout := LAYOUTS.get(command)) is None:
            return list(method(body))
        if len(body) != layout.size:
            raise Refused(Err.CMD_SYNTAX)
        found = method(*layout.unpack(body))
        return [POSITIVE + found] if isinstance(found, bytes) else found

    # The session

    def _connect(self, mode: int) -> bytes:
        if mode not in (0, 1):
            raise Refused(Err.OUT_OF_RANGE)
        self.connected, self._mta = True, (VARIABLES, 0)
        self.daq.free()
        return Struct("<BBBHBB").pack(CAL_PAG | DAQ, 0x80, MAX_CTO, MAX_DTO, 1, 1)

    def _disconnect(self) -> bytes:
        self.connected = False
        self.daq.free()
        return b""

    def _get_status(self) -> bytes:
        return Struct("<BBxH").pack(RUNNING_DAQ if self.daq.running else 0, 0, 0)

    def _synch(self) -> bytes:
        raise Refused(Err.CMD_SYNCH)

    def _get_comm_mode_info(self) -> bytes:
        return Struct("<xBxBBBB").pack(0, 0, 0, 0, 0x10)

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

    def _set_mta(self, extension: int, address: int) -> bytes:
        self._mta = extension, address
        return b""

    def _upload(self, count: int) -> bytes:
        extension, address = self._mta
        found = self._bytes(extension, address, count, MAX_CTO - 1)
        self._mta = extension, address + count
        return found

    def _short_upload(self, count: int, extension: int, address: int) -> bytes:
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
            raise Refused(Err.OUT_OF_RANGE)
        if extension != VARIABLES:
            return (self._node.a2l if extension == FILE else self._text)[address : address + count]
        _, values = self._node.read()
        return values.astype("<f8").tobytes()[address : address + count]

    def _download(self, body: bytes) -> list[bytes]:
        if not body or len(body) - 1 != body[0]:
            raise Refused(Err.CMD_SYNTAX)
        return self._written(body[1:])

    def _short_download(self, body: bytes) -> list[bytes]:
        head = Struct("<BxBI")
        if len(body) < head.size or len(body) - head.size != body[0]:
            raise Refused(Err.CMD_SYNTAX)
        _, *mta = head.unpack(body[: head.size])
        self._mta = mta[0], mta[1]
        return self._written(body[head.size :])

    def _written(self, data: bytes) -> list[bytes]:
        (extension, address), names = self._mta, self._node.names
        if extension != VARIABLES:
            raise Refused(Err.WRITE_PROTECTED if extension in (FILE, TEXT) else Err.OUT_OF_RANGE)
        if not data or address % 8 or len(data) % 8 or address + len(data) > 8 * len(names):
            raise Refused(Err.OUT_OF_RANGE)
        values = np.frombuffer(data, "<f8").tolist()
        first = address // 8
        cycle = self._node.write(dict(zip(names[first : first + len(values)], values, strict=True)))
        self._mta = extension, address + len(data)
        return [POSITIVE, Struct("<BBQ").pack(EVENT, EV_USER, cycle)]

    # Measurement

    def _get_daq_processor_info(self) -> bytes:
        return Struct("<BHHBB").pack(0x93, 252, len(DIVISIONS), 0, 0)

    def _get_daq_resolution_info(self) -> bytes:
        return Struct("<BBBBBH").pack(1, 8, 1, 0, _STAMPS, 1)

    def _get_daq_event_info(self, event: int) -> bytes:
        if event >= len(DIVISIONS):
            raise Refused(Err.OUT_OF_RANGE)
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

    def _free_daq(self) -> bytes:
        self.daq.free()
        return b""

    def _alloc_daq(self, count: int) -> bytes:
        self.daq.alloc(count)
        return b""

    def _alloc_odt(self, number: int, count: int) -> bytes:
        self.daq.alloc_odts(number, count)
        return b""

    def _alloc_odt_entry(self, number: int, odt: int, count: int) -> bytes:
        self.daq.alloc_entries(number, odt, count)
        return b""

    def _clear_daq_list(self, number: int) -> bytes:
        self.daq.clear(number)
        return b""

    def _set_daq_ptr(self, number: int, odt: int, entry: int) -> bytes:
        self.daq.point(number, odt, entry)
        return b""

    def _write_daq(self, bit: int, size: int, extension: int, address: int) -> bytes:
        self.daq.write(bit, size, extension, address)
        return b""

    def _write_daq_multiple(self, body: bytes) -> list[bytes]:
        element = Struct("<BBIBx")
        if not body or len(body) - 1 != body[0] * element.size:
            raise Refused(Err.CMD_SYNTAX)
        for bit, size, address, extension in element.iter_unpack(body[1:]):
            self.daq.write(bit, size, extension, address)
        return [POSITIVE]

    def _read_daq(self) -> bytes:
        address, size = self.daq.read()
        return Struct("<BBBI").pack(0xFF, size, VARIABLES, address)

    def _set_daq_list_mode(
        self, mode: int, number: int, event: int, prescaler: int, priority: int
    ) -> bytes:
        self.daq.set_mode(mode, number, event, prescaler)
        return b""

    def _start_stop_daq_list(self, mode: int, number: int) -> bytes:
        one = self.daq.of(number)
        if mode == 0:
            self.daq.stop(number)
        elif mode == 1:
            self.daq.start(number)
        elif mode == 2:
            one.selected = True
        else:
            raise Refused(Err.MODE_NOT_VALID)
        return bytes([self.daq.first(number)])

    def _start_stop_synch(self, mode: int) -> bytes:
        if mode not in (0, 1, 2):
            raise Refused(Err.MODE_NOT_VALID)
        chosen = [i for i, one in enumerate(self.daq.lists) if one.selected or mode == 0]
        if mode == 1:
            self.daq.start(*chosen)
        for i in chosen:
            if mode != 1:
                self.daq.stop(i)
            self.daq.lists[i].selected = False
        return b""


def event_name(event: int) -> str:
    """Return what an event channel is called."""
    return "cycle" if not event else f"cycle_{DIVISIONS[event]}"


def period(ns: int) -> tuple[int, int]:
    """Return a period as XCP has it: a count of at most 255, and the unit that is 10^n ns."""
    unit = 0
    while unit + 1 < _UNITS and (ns % 10 == 0 or ns > 255):
        ns, unit = round(ns / 10), unit + 1
    return min(ns, 255), unit
