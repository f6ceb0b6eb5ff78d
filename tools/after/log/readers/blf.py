"""Vector's BLF, object by object, so that nothing in it is passed over without a word.

    file       LOGG, its size, the number of objects in it, the date of t = 0; then objects
    object     LOBJ, size of its head, version of that, size, kind; flags and time; its body
    container  an object of kind 10: more objects, packed; one may go on in the next container

A recorder that lost power leaves a head without sizes and a last container that is cut. What cannot
be read is noted with its place; reading goes on at the next LOBJ.

Public descriptions: python-can's reader and Technica's vector_blf.
"""

import struct
import zlib
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import IO

from pcpc.drivers.can.wire_layout import LENGTHS, Flag
from pcpc.tools.after.log.readers.account import (
    Account,
    NotReadError,
    RecordedFrame,
    classic_bytes,
    data_frame,
)

_FILE = struct.Struct("<4sL8xQQLL8H")  # mark, size of head, sizes, objects, read ones, date
_HEAD = struct.Struct("<4sHHLL")  # mark, size of head, its version, size, kind
_TIMES = {1: struct.Struct("<LHHQ"), 2: struct.Struct("<LBxHQ8x")}  # by version: flags, .., time
_CONTAINER = struct.Struct("<H6xL4x")  # method, size once unpacked
_CLASSIC = struct.Struct("<HBBL8s")  # channel, flags, DLC, id, data
_FD = struct.Struct("<HBBLLBBB5x64s")  # channel, flags, DLC, id, .., .., FD flags, valid, data
_FD64 = struct.Struct("<BBBBLLLLLLLHBBL")  # channel, DLC, valid, .., id, .., flags, .., way, ext
_PLAIN, _ZLIB = 0, 2
_ID, _EXTENDED = 0x1FFFFFFF, 0x80000000
_TEN_US, _TXRQ = 1, 2
_FRAME, _CONTAINERS, _FRAME2, _FRAME_FD, _FRAME_FD64 = 1, 10, 86, 100, 101
_KINDS = {2: "error", 73: "error", 104: "error", 140: "error", 3: "overload", 139: "CAN XL"}
_OF_BYTE = (104, 139, 140)  # objects whose channel is a byte
_MARK = b"LOBJ"
_LONGEST_PADDING, _LARGEST = 8, 1 << 24  # bytes


def frames(file: IO[bytes], account: Account) -> Iterator[RecordedFrame]:
    """Yield the frames of a file; NotReadError."""
    return _Blf(file, account).frames()


class _Blf:
    """A file, and how far it is read."""

    def __init__(self, file: IO[bytes], account: Account) -> None:
        self._account = account
        head = file.read(_FILE.size)
        if len(head) < _FILE.size or head[:4] != b"LOGG":
            raise NotReadError("no BLF file: it does not begin with LOGG")
        _, size, self._size, _, self._declared, _, *date = _FILE.unpack(head)
        self._start_ns = _date_ns(date)
        file.seek(max(size, _FILE.size))
        self._begin = file.tell()
        self._data = file.read()
        self._objects = self._done = 0

    def frames(self) -> Iterator[RecordedFrame]:
        """Yield the frames; what the head declares is compared at the end."""
        inner, offset = b"", self._begin
        for offset, version, kind, body in self._walk(self._data, self._begin):
            if kind != _CONTAINERS:  # a file without containers
                yield from self._frame(offset, version, kind, body)
                continue
            self._objects -= 1
            before = self._account.damaged
            inner += self._unpacked(offset, body)
            for one in self._walk(inner, offset, is_inner=True):
                yield from self._frame(*one)
            inner = inner[self._done :] if self._account.damaged == before else b""
        if inner.strip(b"\0"):
            self._account.lose(f"byte {offset}", "an object is cut at the end")
        self._check_declared()

    def _check_declared(self) -> None:
        size = self._begin + len(self._data)
        if self._objects < self._declared:
            self._account.lose("the file", f"{self._objects} of {self._declared} objects")
        elif self._size > size + 3:  # the last padding does not matter
            self._account.lose("the file", f"{size} of {self._size} bytes")
        elif not self._declared and self._size <= self._begin and self._data:
            self._account.lose("the file", "its head was not finished, as a recorder does at last")

    def _walk(
        self, data: bytes, offset: int, is_inner: bool = False
    ) -> Iterator[tuple[int, int, int, bytes]]:
        """Yield place, version of the head, kind and the rest of each object in `data`.

        `offset` is of `data` in the file, of inner data that of their container. Ends before an
        object that goes on behind inner data; in the file itself that is damage.
        """
        position, size = 0, len(data)
        while True:
            self._done = position
            place = offset if is_inner else offset + position
            if data[position : position + len(_MARK)] != _MARK:
                position = self._next_object(data, position, place)
                if position < size:
                    continue
                return
            if position + _HEAD.size > size:
                if not is_inner:
                    self._account.lose(f"byte {place}", "an object is cut")
                return
            _, _, version, length, kind = _HEAD.unpack_from(data, position)
            if not _HEAD.size <= length <= _LARGEST:
                what = "without a size" if length < _HEAD.size else f"of {length} bytes"
                self._account.lose(f"byte {place}", f"an object {what}")
                position += 4
                continue
            if position + length > size and is_inner:
                return
            if position + length > size:
                self._account.lose(f"byte {place}", "an object ends behind the file")
                if kind != _CONTAINERS:
                    return
            self._objects += 1
            yield place, version, kind, data[position + _HEAD.size : position + length]
            position += length

    def _next_object(self, data: bytes, position: int, place: int) -> int:
        """Return where the next object begins, the end of `data` for none."""
        end, is_near = len(data), position + _LONGEST_PADDING + len(_MARK) > len(data)
        if is_near and _MARK.startswith(data[position:].lstrip(b"\0")):
            return end  # padding, and perhaps the begin of what goes on behind it
        mark_at = data.find(_MARK, position)
        self._done = end if mark_at < 0 else mark_at
        is_padding = mark_at < 0 or mark_at <= position + _LONGEST_PADDING
        if not is_padding or data[position : self._done].strip(b"\0"):
            self._account.lose(f"byte {place}", "no object begins there")
        return self._done

    def _unpacked(self, offset: int, body: bytes) -> bytes:
        """Return the objects of a container, as far as they can be unpacked."""
        if len(body) < _CONTAINER.size:
            self._account.lose(f"byte {offset}", "a container is cut")
            return b""
        method, size = _CONTAINER.unpack_from(body)
        packed = body[_CONTAINER.size :]
        if method == _PLAIN:
            return packed
        if method != _ZLIB:
            self._account.lose(f"byte {offset}", f"a container packed by method {method}")
            return b""
        stream, out = zlib.decompressobj(), bytearray()
        try:
            while packed and not stream.eof:
                out += stream.decompress(packed, 1 << 16)
                packed = stream.unconsumed_tail
            reason = "" if stream.eof and len(out) == size else f"{len(out)} of {size} bytes"
        except zlib.error as error:
            reason = str(error)
        if reason:
            self._account.lose(f"byte {offset}", f"a container is damaged: {reason}")
        return bytes(out)

    def _frame(self, place: int, version: int, kind: int, body: bytes) -> Iterator[RecordedFrame]:
        """Yield the frame of an object, if it has one."""
        if kind not in (_FRAME, _FRAME2, _FRAME_FD, _FRAME_FD64, *_KINDS):
            self._account.others += 1
            return
        try:
            if version not in _TIMES:
                raise ValueError(f"an object with a head of version {version}")
            head = _TIMES[version]
            flags, _, _, time = head.unpack_from(body)
            time_ns = self._start_ns + time * (10_000 if flags == _TEN_US else 1)
            yield _of_kind(time_ns, kind, body[head.size :], _HEAD.size + head.size)
        except (ValueError, struct.error) as error:
            self._account.lose(f"byte {place}, object {self._objects}", error)


def _of_kind(time_ns: int, kind: int, body: bytes, begin: int) -> RecordedFrame:
    """Return the frame of an object, whose body begins there; ValueError, struct.error."""
    if kind in _KINDS:
        channel = body[0] if kind in _OF_BYTE else int.from_bytes(body[:2], "little")
        return RecordedFrame(time_ns, channel=str(channel - 1), kind=_KINDS[kind])
    if kind == _FRAME_FD64:
        return _of_fd64(time_ns, body, begin)
    fd, valid = 0, 8
    flags: int = Flag.NONE
    if kind == _FRAME_FD:
        channel, marks, dlc, word, _, _, fd, valid, data = _FD.unpack_from(body)
    else:
        channel, marks, dlc, word, data = _CLASSIC.unpack_from(body)
    name, way = str(channel - 1), marks & 0x0F
    if way == _TXRQ or marks & 0x80:
        return RecordedFrame(time_ns, channel=name, kind="request" if way == _TXRQ else "remote")
    if fd & 1:
        flags = Flag.FD | (Flag.BRS if fd & 2 else 0) | (Flag.ESI if fd & 4 else 0)
        size = LENGTHS[dlc] if dlc < len(LENGTHS) else -1
        data = data[: min(valid, size)].ljust(size, b"\0")
        if size < 0:
            raise ValueError(f"DLC {dlc}; expected 0 to 15")
    else:
        data = data[: classic_bytes(dlc)]
    extended = bool(word & _EXTENDED)
    return data_frame(time_ns, word & _ID, extended, data, flags, way != 1, name)


def _of_fd64(time_ns: int, body: bytes, begin: int) -> RecordedFrame:
    """Return the frame of an object of CAN FD with data of any length."""
    channel, dlc, valid, _, word, _, fd, *_, way, ext, _ = _FD64.unpack_from(body)
    name, extended = str(channel - 1), bool(word & _EXTENDED)
    is_fd = bool(fd & 0x1000)
    if way == _TXRQ or (fd & 0x10 and not is_fd):
        kind = "request" if way == _TXRQ else "remote"
        return RecordedFrame(time_ns, channel=name, kind=kind)
    size = classic_bytes(dlc)
    size = LENGTHS[dlc] if is_fd else size
    end = len(body) if not ext else min(len(body), max(_FD64.size, ext - begin))
    data = body[_FD64.size : end][: min(valid, size)].ljust(size, b"\0")
    flags: int = Flag.NONE
    if is_fd:
        flags = Flag.FD | (Flag.BRS if fd & 0x2000 else 0) | (Flag.ESI if fd & 0x4000 else 0)
    return data_frame(time_ns, word & _ID, extended, data, flags, way != 1, name)


def _date_ns(date: list[int]) -> int:
    """Return the wall time of a date in words of 16 bits; 0 for none."""
    year, month, _, day, hour, minute, second, ms = date
    try:
        moment = datetime(year, month, day, hour, minute, second, ms * 1000, tzinfo=UTC)
    except ValueError:
        return 0
    return max(0, round(moment.timestamp() * 1000)) * 10**6
