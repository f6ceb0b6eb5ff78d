"""MCAP files read in one pass, also damaged ones: what is not whole is left out and told.

    file      magic, data records, DATA_END, summary records, FOOTER, magic

What proves that a value is as it was written:

    messages, schemas, channels    CRC-32 of their chunk
    attachments, metadata          CRC-32 of their own
    all data records               CRC-32 in DATA_END, if the file was finished
    summary                        CRC-32 in FOOTER, if the file was finished

A record that proves nothing is no value: it is skipped, with all up to the next that passes its own
check. Messages outside of chunks are therefore left out. Records: `executive.log.mcap_records`.

A file is read at a cost that its size bounds, whatever it declares:

    bytes unpacked or searched     16 MiB + 200 for each byte of the file
    messages                       20,000 + one for each byte of the file

A message carries a time of its own, which no compression makes smaller than a byte; logs of this
project have 4 to 10 bytes unpacked for a byte, and a message in 30.
"""

import mmap
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from struct import Struct
from typing import Any

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema, Statistics
from numpy.typing import NDArray

from pcpc.drivers.errors import UserError
from pcpc.drivers.machine.regular_files import is_being_written, open_regular
from pcpc.executive.log.inventory import CHUNK_HEAD, Inventory
from pcpc.executive.log.mcap_records import (
    ALIKE,
    CHECKED,
    DECLARED,
    FOOTER,
    LARGEST_CHUNK,
    MAGIC,
    MESSAGE_HEAD,
    READERS,
    RECORD,
    UNREADABLE,
    ForeignMetadata,
    Times,
    alike,
    places_of,
    read_channel,
    read_schema,
)

Piece = tuple[int, NDArray[np.uint8]]  # channel id, (messages, bytes of each record)
NONE: Times = (1, 0)

_TOLD = "variables:"  # metadata that comes before the channel
_CHUNK_TIMES = Struct("<QQ")  # how a chunk begins
_NAMES = {kind: Opcode(kind).name.lower() for kind in READERS}
_WINDOWS = 1 << 12, 1 << 20  # bytes searched at once for the next whole record: first, at most
_BYTES, _BYTES_PER_BYTE, _MESSAGES = 16 << 20, 200, 20_000
_GOES_ON = "it is still being written"
_NOTES = 100  # damaged places told one by one
_NAMED = 5
_TIME_TOP, _TIME_TOP_END = 22, 0x40  # the last byte of a message's log time; 2^62 ns is in 2116


class LogError(UserError):
    """The file is no log of this project."""


class TooMuchError(Exception):
    """The file would cost more than its size justifies."""


@dataclass
class Scan:
    """What a file holds, in file order; `place` of `size` bytes are read. `count`: by channel id.

    `missing` says in words what could not be read; complete at the end of the file.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    pieces: list[Piece] = field(default_factory=list)
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    foreign: list[ForeignMetadata] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    count: Counter[int] = field(default_factory=Counter)
    inventory: Inventory = field(default_factory=Inventory)
    statistics: Statistics | None = None
    place: int = 0
    size: int = 0
    is_written: bool = False  # by somebody else, now
    cost: int = 0  # bytes unpacked or searched so far
    records: int = 0  # in chunks
    untold: int = 0  # damaged places without a line of their own
    untimely: int = 0  # messages left out for their time
    proved: bool = False  # the checksum of all data matches
    copies: bool = False  # what `foreign` holds is no loss, as it is copied

    def pieces_of(self, name: str) -> list[NDArray[np.uint8]]:
        """Return the pieces of a topic. Each (n, bytes of a message)."""
        ids = {i for i, channel in self.channels.items() if channel.topic == name}
        return [piece for i, piece in self.pieces if i in ids]

    def topic(self, channel: int) -> str:
        """Return the topic of a channel, empty if nothing describes it."""
        return self.channels[channel].topic if channel in self.channels else ""

    def add_note(self, line: str) -> None:
        """Add a line to `missing`; after many of them only count."""
        if len(self.missing) < _NOTES:
            self.missing.append(line)
        else:
            self.untold += 1

    def spend(self, size: int, records: int = 0) -> None:
        """Count work that is about to be done; TooMuchError where the file is too small for it."""
        self.cost += size
        self.records += records
        if self.cost > _BYTES + _BYTES_PER_BYTE * self.size:
            raise TooMuchError("it unpacks to more than 200 times its size")
        if self.records > _MESSAGES + self.size:
            raise TooMuchError("it has more records than bytes")


def scan(path: Path) -> Scan:
    """Read all records of a file as far as they are whole; LogError if it is no MCAP file."""
    found = Scan()
    found.pieces.extend(walk(path, found))
    return found


def walk(path: Path, scanned: Scan, only: Times | None = None) -> Iterator[Piece]:
    """Yield the messages of a file as they come; put all else into `scanned`. LogError as `scan`.

    A piece: channel id, messages (n, bytes of each record). All pieces of a chunk come at one
    `scanned.place`. `only`: chunks with messages between these log times, ns, are looked into;
    whether all is there is not told then. A whole summary says where.
    """
    try:
        with open_regular(path) as file:
            data: Any = _map(file.fileno()) or file.read()
            scanned.is_written = is_being_written(file)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror}") from None
    begin = data[: len(MAGIC)]
    if sum(a == b for a, b in zip(begin, MAGIC, strict=False)) < len(MAGIC) - 2:
        why = f"begins with {begin!r}" if begin else "it is empty"
        raise LogError(f"{path}: not an MCAP file ({why})")
    if begin != MAGIC:
        scanned.missing.append(f"the first bytes are damaged ({begin!r})")
    scanned.size = len(data)
    summary = _take_summary(data, scanned)
    places = places_of(data, summary, only, scanned.statistics) if only and summary else None
    try:
        yield from _walk_data(data, summary, scanned, only, places)
    except TooMuchError as error:
        scanned.missing.append(f"all after byte {scanned.place}: {error}; no true log is like that")
    if only is None:
        _compare(scanned)
        known = {one.name: one.metadata for one in scanned.metadata}
        closed = not (scanned.missing or scanned.untold)
        notes = scanned.inventory.notes(known, {one.name for one in scanned.attachments}, closed)
        scanned.missing += [line for line in notes if line not in scanned.missing]
        if scanned.foreign and not (scanned.proved or scanned.copies):
            names = ", ".join(repr(one.name[:80]) for one in scanned.foreign[:_NAMED])
            why = f"metadata {names}, {len(scanned.foreign)} in all, of another tool"
            scanned.missing.append(f"{why}: no checksum proves them; `pcpc log recover` keeps them")
    if scanned.untold:
        scanned.missing.append(f"{scanned.untold} further places are damaged")
    if scanned.untimely:
        scanned.missing.append(f"{scanned.untimely} messages of times beyond 2116; left out")


def _map(descriptor: int) -> Any:
    """Return the file as mapped memory; None for what cannot be mapped: an empty file."""
    try:
        return mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError):
        return None


def _walk_data(
    data: bytes, summary: int, scanned: Scan, only: Times | None, places: Iterator[int] | None
) -> Iterator[Piece]:
    """Yield the messages of the data section, which ends where `summary`, if not 0, begins.

    `places`: of the records that are wanted.
    """
    stop, place = summary or len(data), len(MAGIC)
    crc = zlib.crc32(data[:place])
    while place < stop:
        if places is not None and (place := next(places, stop)) == stop:
            return
        scanned.place = place
        try:
            opcode, end, content = _read_record(data, place, stop, scanned, only)
        except UNREADABLE as error:
            after = _next_record(data, place + 1, stop, scanned)
            if after == stop and not summary:
                break
            what = _NAMES.get(data[place], "record")
            lost = f"all up to byte {after} is left out"
            scanned.add_note(f"{what} at byte {place} is damaged ({error}); {lost}")
            place = after
            continue
        if opcode == Opcode.DATA_END:
            scanned.proved = only is None and bool(content) and content == crc
            if content and content != crc and not (only or scanned.missing):
                scanned.missing.append(
                    "the checksum of all data does not match though that of each part does: "
                    "only the file's header or an index can be damaged"
                )
            if not summary:
                scanned.missing.append(
                    "the summary at the end is damaged or cut; all before it is read"
                )
            return
        if only is None:
            crc = zlib.crc32(data[place:end], crc)
        if content is None:
            pass
        elif opcode == Opcode.CHUNK:
            head = place + RECORD.size
            if scanned.inventory.has_chunk(data[head : head + CHUNK_HEAD]):
                place = end
                continue
            try:
                yield from _chunk_pieces(content, scanned)
            except UNREADABLE as error:
                scanned.add_note(f"a part of the chunk at byte {place}: {error or 'it is cut'}")
        elif opcode == Opcode.ATTACHMENT:
            scanned.attachments.append(content)
        elif opcode == Opcode.METADATA:
            foreign = isinstance(content, ForeignMetadata)
            (scanned.foreign if foreign else scanned.metadata).append(content)
        place = end
    if not summary:
        why = _GOES_ON if scanned.is_written else "recorder killed, disk full, or file cut"
        scanned.missing.append(
            f"the end: nothing is readable after byte {place} of {len(data)} "
            f"({why}); the rest of the log is whole"
        )


def _read_record(
    data: bytes, place: int, stop: int, scanned: Scan, only: Times | None = None
) -> tuple[int, int, Any]:
    """Return (opcode, end, content) of the record at `place`; UNREADABLE if a check fails.

    The content of a chunk without messages in the times `only` is None.
    """
    if place + RECORD.size > stop:
        raise ValueError("a record is cut")
    opcode, length = RECORD.unpack_from(data, place)
    end = place + RECORD.size + length
    if opcode not in READERS:
        raise ValueError(f"no record of kind {opcode} belongs here")
    if end > stop:
        raise ValueError(f"of {length} bytes only {stop - place - RECORD.size} follow")
    if only and (opcode == Opcode.MESSAGE_INDEX or _is_outside(data, place, opcode, scanned, only)):
        return opcode, end, None
    if opcode == Opcode.CHUNK and length >= DECLARED.size:
        declared = DECLARED.unpack_from(data, place + RECORD.size)[2]
        scanned.spend(declared if declared <= LARGEST_CHUNK else 0)
    try:
        return opcode, end, READERS[opcode](data[place + RECORD.size : end])
    except UNREADABLE as error:
        raise ValueError(str(error) or "it is cut") from None


def _is_outside(data: bytes, place: int, opcode: int, scanned: Scan, only: Times) -> bool:
    """Return whether the record at `place` is a chunk that is not to be looked into.

    Without a summary the first ones say what the messages of others mean.
    """
    if opcode != Opcode.CHUNK:
        return False
    told = {one.name.removeprefix(_TOLD) for one in scanned.metadata if one.name.startswith(_TOLD)}
    if only != NONE and not told <= {one.topic for one in scanned.channels.values()}:
        return False
    first, last = _CHUNK_TIMES.unpack_from(data, place + RECORD.size)
    return bool(last < only[0] or first > only[1])


def _next_record(data: bytes, place: int, stop: int, scanned: Scan) -> int:
    """Return where the next record lies that passes a check of its own; `stop` if there is none."""
    size, most = _WINDOWS
    while place < stop:
        window = np.frombuffer(data, np.uint8, min(size, stop - place), place)
        starts = window[: max(len(window) - 8, 0)]
        likely = np.isin(starts, CHECKED)
        for high in range(5, 9):  # no record has 4 GiB
            likely &= window[high : high + len(starts)] == 0
        for i in np.flatnonzero(likely).tolist():
            _, length = RECORD.unpack_from(data, place + i)
            if length > stop - place - i:
                continue
            scanned.spend(length)
            try:
                *_, content = _read_record(data, place + i, stop, scanned)
            except UNREADABLE:
                continue
            if not isinstance(content, ForeignMetadata):
                return place + i
        place += max(len(starts), 1)
        size = min(2 * size, most)
    return stop


def _take_summary(data: bytes, scanned: Scan) -> int:
    """Take channels and counts from the summary; return where it begins, 0 if it is not whole."""
    footer = len(data) - FOOTER.size
    if footer < len(MAGIC):
        return 0
    opcode, length, start, _, crc, magic = FOOTER.unpack_from(data, footer)
    if (opcode, length, magic) != (Opcode.FOOTER, 20, MAGIC) or not len(MAGIC) <= start <= footer:
        return 0
    if zlib.crc32(data[start : len(data) - 12]) != crc:
        return 0
    place = start
    try:
        while place < footer:
            opcode, length = RECORD.unpack_from(data, place)
            place += RECORD.size + length
            body = data[place - length : min(place, footer)]
            if opcode == Opcode.STATISTICS:
                scanned.statistics = Statistics.read(ReadDataStream(BytesIO(body)))
            else:
                _describe(scanned, opcode, body)
    except UNREADABLE as error:
        scanned.missing.append(f"a part of the summary at the end: {error or 'it is cut'}")
    return int(start)


def _describe(scanned: Scan, opcode: int, body: bytes) -> None:
    if opcode == Opcode.SCHEMA:
        schema = read_schema(body)
        scanned.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = read_channel(body)
        scanned.channels[channel.id] = channel


def _chunk_pieces(data: bytes, scanned: Scan) -> Iterator[Piece]:
    """Yield a chunk's messages; neighbours of one channel and size come as one piece."""
    place = 0
    while place < len(data):
        opcode, length = RECORD.unpack_from(data, place)
        size = RECORD.size + length
        if place + size > len(data):
            raise ValueError("a record is cut")
        if opcode != Opcode.MESSAGE:
            scanned.spend(0, 1)
            _describe(scanned, opcode, data[place + RECORD.size : place + size])
            place += size
            continue
        if size < MESSAGE_HEAD:
            raise ValueError(f"a message of {size} bytes")
        count = alike(data, place, size)
        rows = np.frombuffer(data, np.uint8, count * size, place).reshape(count, size)
        channel = int.from_bytes(data[place + RECORD.size : place + ALIKE], "little")
        place += rows.size
        scanned.count[channel] += len(rows)
        scanned.spend(0, len(rows))
        timely = rows[:, _TIME_TOP] < _TIME_TOP_END
        if not timely.all():
            scanned.untimely += len(rows) - int(timely.sum())
            rows = rows[timely]
        rows = scanned.inventory.new_rows(scanned.topic(channel), rows)
        if len(rows):
            yield channel, rows


def _compare(scanned: Scan) -> None:
    """Note the channels of which fewer messages are readable than were written, or no name."""
    written = {} if scanned.statistics is None else scanned.statistics.channel_message_counts
    for i, count in written.items():
        if scanned.count[i] < count:
            name = scanned.topic(i) or f"channel {i}"
            scanned.add_note(f"{name}: {count - scanned.count[i]} of {count} messages")
    unknown = sum(count for i, count in scanned.count.items() if i not in scanned.channels)
    if unknown:
        scanned.missing.append(f"the topics of {unknown} messages: no channel describes them")
