"""An MCAP file that others wrote: by what, and how many messages of which topic; bounded cost."""

import mmap
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk, Header

from pcpc.drivers.errors import printable
from pcpc.drivers.machine.regular_files import open_regular
from pcpc.executive.log.mcap_reader import Scan, TooMuchError
from pcpc.executive.log.mcap_records import (
    LARGEST_CHUNK,
    MAGIC,
    RECORD,
    UNREADABLE,
    read_channel,
    unpack_chunk,
)
from pcpc.tools.after.log.contents import Foreign


def survey(path: Path) -> Foreign | None:
    """Return library and messages by topic; None for what is no MCAP file."""
    foreign = Foreign(str(path))
    names: dict[int, str] = {}
    try:
        with (
            open_regular(path) as file,
            mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data,
        ):
            if data[: len(MAGIC)] != MAGIC:
                return None
            for opcode, body in _records(data, len(MAGIC), Scan(size=len(data))):
                if opcode == Opcode.HEADER:
                    library = Header.read(ReadDataStream(BytesIO(body))).library
                    foreign.library = printable(library)
                elif opcode == Opcode.CHANNEL:
                    channel = read_channel(body)
                    names[channel.id] = channel.topic
                    foreign.topics.setdefault(channel.topic, 0)
                elif opcode == Opcode.MESSAGE:
                    topic = names.get(int.from_bytes(body[:2], "little"))
                    if topic is not None:
                        foreign.topics[topic] += 1
    except (*UNREADABLE, OSError, TooMuchError) as error:
        if isinstance(error, ValueError) and path.stat().st_size == 0:  # no mapping of nothing
            return None
        foreign.damaged = printable(str(error)) or "it is cut"
    return foreign


def _records(
    data: Any, place: int, cost: Scan, inside: bool = False
) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and body of each record, also of those in chunks, up to the footer."""
    while place < len(data) or not inside:
        if place + RECORD.size > len(data):
            raise ValueError("it is cut")
        opcode, length = RECORD.unpack_from(data, place)
        place += RECORD.size + length
        if place > len(data):
            raise ValueError("it is cut")
        cost.spend(0, 1)
        if opcode == Opcode.FOOTER:
            return
        body = bytes(data[place - length : place])
        if opcode == Opcode.CHUNK and not inside:
            chunk = Chunk.read(ReadDataStream(BytesIO(body)))
            cost.spend(min(chunk.uncompressed_size, LARGEST_CHUNK))
            yield from _records(unpack_chunk(chunk), 0, cost, inside=True)
        else:
            yield opcode, body
