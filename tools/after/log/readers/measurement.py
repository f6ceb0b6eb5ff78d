"""ASAM MDF 4 with bus logging, read by asammdf and python-can; MDF tells how many frames it has."""

import logging
import re
from collections.abc import Iterator
from datetime import UTC
from importlib import import_module
from typing import IO, Any

from pcpc.drivers.can.wire_layout import flags_of
from pcpc.tools.after.log.readers.account import (
    Account,
    NotReadError,
    RecordedFrame,
    data_frame,
    ns_of_float,
)
from pcpc.tools.terminal.extras import need

_BUS_EVENT, _BUS = 2, ("CAN_DataFrame", "CAN_ErrorFrame", "CAN_RemoteFrame")
_SUM = re.compile(r"\d+ data frames, CRC-32 [0-9A-F]{8}")


def frames(file: IO[bytes], account: Account) -> Iterator[RecordedFrame]:
    """Yield the frames of bus logging; NotReadError, ValueError if some are missing, or others.

    `account.declared` becomes number and checksum of frames, if its comment has them.
    """
    need("MDF needs", "asammdf")
    found = declared = 0
    with _reader(file) as reader:
        version = reader._mdf.version
        for group in reader._mdf.groups if version >= "4" else ():
            head = group.channel_group
            if head.flags & _BUS_EVENT and any(str(c.name) in _BUS for c in group.channels):
                declared += head.cycles_nr
        if not declared:
            raise NotReadError(f"MDF {version} without bus logging of CAN; give one with it")
        comment = _SUM.search(reader._mdf.header.comment)
        account.declared = comment[0] if comment else ""
        start_ns, reader._start_timestamp = _start_ns(reader._mdf.header), 0.0
        for message in reader:
            found += 1
            yield _of_message(message, start_ns + ns_of_float(message.timestamp))
    if found != declared:
        raise ValueError(f"{found} of {declared} frames")


def _of_message(message: Any, time_ns: int) -> RecordedFrame:
    """Return python-can's message as a frame; ValueError."""
    channel = None if message.channel is None else str(message.channel)
    if message.is_error_frame or message.is_remote_frame:
        kind = "error" if message.is_error_frame else "remote"
        return RecordedFrame(time_ns, channel=channel, kind=kind)
    number, extended, data = message.arbitration_id, message.is_extended_id, bytes(message.data)
    return data_frame(time_ns, number, extended, data, flags_of(message), message.is_rx, channel)


class _Damage(logging.Handler):
    """Makes an error of what asammdf warns about and leaves out, but for attachments."""

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage().partition("Traceback")[0]
        if "ttach" not in text:
            raise ValueError(text)


def _reader(file: Any) -> Any:
    """Return python-can's reader; ValueError says in a line why there is none."""
    from can import MF4Reader  # before asammdf, which imports it half-way: then it reads no MDF

    asammdf = import_module("asammdf")  # sets up its log
    log = logging.getLogger(asammdf.__name__)
    log.setLevel(logging.WARNING)
    log.handlers = [_Damage()]
    try:
        return MF4Reader(file)
    except Exception as error:
        reason = str(error) or type(error).__name__
    raise ValueError(re.sub(r'"?<_io\.\w+ [^>]*>"?', "it", reason))


def _start_ns(header: Any) -> int:
    """Return the wall time of t = 0, which may be in the local zone."""
    start = header.start_time
    zone_s = 0.0 if start.tzinfo else start.timestamp() - start.replace(tzinfo=UTC).timestamp()
    return int(header.abs_time) + round(zone_s) * 10**9
