"""ASAM MDF 4 with bus logging, unpacked by asammdf; MDF tells how many frames it has.

Without its IDE a frame is of 29 bits by bit 31 of its ID, or if 11 are too few for that; without
its EDL it is of CAN FD if it has more than 8 bytes.
"""

import heapq
import logging
import re
from collections.abc import Iterator, Mapping
from datetime import UTC
from importlib import import_module
from io import BytesIO
from operator import attrgetter
from typing import IO, Any

from pcpc.drivers.can.wire_layout import LENGTHS, Flag
from pcpc.tools.after.log.readers.account import (
    CLASSIC_BYTES,
    EXTENDED_IDS,
    STANDARD_IDS,
    Account,
    NotReadError,
    RecordedFrame,
    data_frame,
    ns_of_float,
)
from pcpc.tools.terminal.extras import need

_BUS_EVENT, _ROWS_AT_ONCE = 2, 1000
_DATA = "CAN_DataFrame"
_KINDS = {
    _DATA: "",
    "CAN_ErrorFrame": "error",
    "CAN_RemoteFrame": "remote",
    "CAN_OverloadFrame": "overload",
}
_SUM = re.compile(r"\d+ data frames, CRC-32 [0-9A-F]{8}")


def frames(file: IO[bytes], account: Account) -> Iterator[RecordedFrame]:
    """Yield the frames of bus logging; NotReadError, ValueError if some are missing, or others.

    `account.declared` becomes number and checksum of frames, if its comment has them.
    """
    need("MDF needs", "asammdf")
    with _opened(file) as measurement:
        start_ns = _start_ns(measurement.header)
        groups = []
        for index, group in enumerate(measurement.groups if measurement.version >= "4" else ()):
            head = group.channel_group
            name = next((str(c.name) for c in group.channels if str(c.name) in _KINDS), None)
            if name and head.cycles_nr:
                groups.append(_frames_of(measurement, index, name, start_ns, account))
            elif head.flags & _BUS_EVENT:
                account.others += head.cycles_nr
        if not groups:
            what = f"MDF {measurement.version} without bus logging of CAN; give one with it"
            raise NotReadError(what)
        comment = _SUM.search(measurement.header.comment)
        account.declared = comment[0] if comment else ""
        yield from heapq.merge(*groups, key=attrgetter("time_ns"))


def _frames_of(
    measurement: Any, index: int, name: str, start_ns: int, account: Account
) -> Iterator[RecordedFrame]:
    """Yield the frames of a group; ValueError if some are missing."""
    declared = measurement.groups[index].channel_group.cycles_nr
    for first in range(0, declared, _ROWS_AT_ONCE):
        part = measurement.get(name, index, record_offset=first, record_count=_ROWS_AT_ONCE)
        names = part.samples.dtype.names or ()
        columns = {one.removeprefix(f"{name}."): part.samples[one] for one in names}
        for i, seconds in enumerate(part.timestamps.tolist()):
            row = {key: column[i] for key, column in columns.items()}
            try:
                frame = frame_of(start_ns + ns_of_float(seconds), _KINDS[name], row)
            except (ValueError, KeyError) as error:
                reason = f"it has no {error.args[0]}" if isinstance(error, KeyError) else error
                account.lose(f"{name} {first + i + 1} of group {index}", reason)
                continue
            yield frame
        if len(part.timestamps) < min(_ROWS_AT_ONCE, declared - first):
            raise ValueError(f"{first + len(part.timestamps)} of {declared} frames")


def frame_of(time_ns: int, kind: str, row: Mapping[str, Any]) -> RecordedFrame:
    """Return the frame of a row, its members by name; ValueError, KeyError."""
    channel = str(int(row["BusChannel"])) if "BusChannel" in row else None
    if kind or row.get("RTR"):
        return RecordedFrame(time_ns, channel=channel, kind=kind or "remote")
    word, content = int(row["ID"]), bytes(row["DataBytes"])
    number, extended = word % EXTENDED_IDS, bool(row.get("IDE")) or word >> 31 == 1
    if "IDE" not in row:
        extended = extended or number >= STANDARD_IDS
    size, flags = _size(row, len(content)), int(Flag.NONE)
    is_fd = row.get("EDL", size > CLASSIC_BYTES)
    if is_fd:
        flags = Flag.FD | (Flag.BRS if row.get("BRS") else 0) | (Flag.ESI if row.get("ESI") else 0)
    else:
        size = min(size, CLASSIC_BYTES)
    if len(content) < size:
        raise ValueError(f"{len(content)} of {size} bytes")
    received = _is_received(row.get("Dir", 0))
    return data_frame(time_ns, number, extended, content[:size], flags, received, channel)


def _size(row: Mapping[str, Any], room: int) -> int:
    """Return how many bytes a frame has: by its length, else by its DLC, else all."""
    if "DataLength" in row:
        size = int(row["DataLength"])
        return size if "EDL" in row or room > CLASSIC_BYTES else min(size, CLASSIC_BYTES)
    if "DLC" not in row:
        return room
    lengths = LENGTHS if row.get("EDL", room > CLASSIC_BYTES) else LENGTHS[: CLASSIC_BYTES + 1]
    return lengths[min(int(row["DLC"]), len(lengths) - 1)]


def _is_received(way: Any) -> bool:
    """Return whether a frame was received: by a number, of which 0 is Rx, or by a word."""
    if isinstance(way, bytes | str):
        return (way.decode("latin-1") if isinstance(way, bytes) else way).strip().lower() != "tx"
    return int(way) == 0


class _Damage(logging.Handler):
    """Makes an error of what asammdf warns about and leaves out, but for attachments."""

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage().partition("Traceback")[0]
        if "ttach" not in text:
            raise ValueError(text)


def _opened(file: Any) -> Any:
    """Return asammdf's measurement; ValueError says in a line why there is none."""
    asammdf = import_module("asammdf")  # sets up its log
    log = logging.getLogger(asammdf.__name__)
    log.setLevel(logging.WARNING)
    log.handlers = [_Damage()]
    try:
        return asammdf.MDF(BytesIO(file.read()), process_bus_logging=False)
    except Exception as error:
        reason = str(error) or type(error).__name__
    raise ValueError(re.sub(r'"?<_io\.\w+ [^>]*>"?', "it", reason))


def _start_ns(header: Any) -> int:
    """Return the wall time of t = 0, which may be in the local zone."""
    start = header.start_time
    zone_s = 0.0 if start.tzinfo else start.timestamp() - start.replace(tzinfo=UTC).timestamp()
    return int(header.abs_time) + round(zone_s) * 10**9
