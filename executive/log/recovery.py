"""Damaged MCAP files written anew: what is readable of one is a whole one."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.errors import code_of
from pcpc.executive.log.mcap_reader import Piece, Scan, walk
from pcpc.executive.log.mcap_records import MESSAGE_HEAD, message_dtype
from pcpc.executive.log.mcap_writer import BulkWriter, RecordError
from pcpc.executive.rig.roles import ROLES

_OWN = {*ROLES, "run", "frames", "away", "import", "recovered"}  # metadata of this project


@dataclass
class Recovery:
    """What was written anew: messages by topic, what is missing, and what nothing proves."""

    messages: dict[str, int]
    missing: list[str]
    unproved: list[str]


class _Copy:
    """Writes what a scan finds, as it finds it, to a new file."""

    def __init__(self, scan: Scan, writer: BulkWriter) -> None:
        self.scan, self.writer = scan, writer
        self.messages: dict[str, int] = {}
        self._schemas, self._channels = {0: 0}, dict[int, int]()
        self._notes = self._files = self._foreign = 0
        self.unproved: list[str] = []
        self._undescribed = Counter[str]()  # messages by topic

    def heads(self) -> None:
        """Write metadata and attachments that were found since the last call."""
        for note in self.scan.metadata[self._notes :]:
            self.writer.add_metadata(note.name, note.metadata)
        for file in self.scan.attachments[self._files :]:
            self.writer.add_attachment(
                file.create_time, file.log_time, file.name, file.media_type, file.data
            )
        for note in self.scan.foreign[self._foreign :]:
            if is_own(note.name):
                self.scan.missing.append(f"metadata {note.name!r}: no checksum proves them")
            else:
                self.writer.add_metadata(note.name, note.metadata)
                self.unproved.append(f"metadata {note.name!r} of another tool")
        self._notes, self._files = len(self.scan.metadata), len(self.scan.attachments)
        self._foreign = len(self.scan.foreign)

    def channel(self, number: int) -> int:
        """Return the new id of a channel, 0 if the file does not describe it."""
        channel = self.scan.channels.get(number)
        if channel is None or channel.schema_id not in (0, *self.scan.schemas):
            return 0
        if number not in self._channels:
            if channel.schema_id not in self._schemas:
                schema = self.scan.schemas[channel.schema_id]
                self._schemas[schema.id] = self.writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            self._channels[number] = self.writer.register_channel(
                channel.topic,
                channel.message_encoding,
                self._schemas[channel.schema_id],
                channel.metadata,
            )
            self.messages.setdefault(channel.topic, 0)
        return self._channels[number]

    def add(self, number: int, piece: NDArray[np.uint8]) -> None:
        """Write messages of a channel."""
        channel = self.channel(number)
        if not channel:
            self._undescribed[self.scan.topic(number)] += len(piece)
            return
        messages = piece.copy().view(message_dtype(piece.shape[1] - MESSAGE_HEAD))[:, 0]
        messages["channel"] = channel
        self.writer.add([messages])
        self.messages[self.scan.channels[number].topic] += len(piece)

    def end(self) -> None:
        """Write what no message has brought; tell which messages nothing describes."""
        self.heads()
        for number in sorted(self.scan.channels):
            self.channel(number)
        for name, count in sorted(self._undescribed.items()):
            if name:  # else the reader has counted them
                self.scan.missing.append(f"{name}: {count} messages, whose schema is not readable")


def is_own(name: str) -> bool:
    """Return whether logs of this project have metadata of this name."""
    return name.startswith("variables:") or name in _OWN


def recover(path: Path, out: Path, watch: Callable[[Scan], None] = lambda scan: None) -> Recovery:
    """Write what is readable of a damaged log to `out`, which is then a whole one.

    `watch` is told how far it is. Raises LogError; RecordError if `out` cannot be written.
    """
    scan = Scan(copies=True)
    pieces = walk(path, scan)
    begin = list(islice(pieces, 1))  # LogError comes before `out` is made
    try:
        return _write_copy(path.name, chain(begin, pieces), scan, out, watch)
    except OSError as error:
        out.unlink(missing_ok=True)
        message = f"{out}: {error.strerror}; give another place with -o"
        raise RecordError(message, code_of(error)) from None
    except BaseException:  # Ctrl-C: no half file
        out.unlink(missing_ok=True)
        raise


def _write_copy(
    name: str, pieces: Iterable[Piece], scan: Scan, out: Path, watch: Callable[[Scan], None]
) -> Recovery:
    writer = BulkWriter(out)
    with writer.file:
        writer.start(profile="ros2")
        copy = _Copy(scan, writer)
        for number, piece in pieces:
            copy.heads()
            copy.add(number, piece)
            watch(scan)
        copy.end()
        notes = {f"missing {i}": line for i, line in enumerate(scan.missing, 1)}
        notes |= {f"unproved {i}": line for i, line in enumerate(copy.unproved, 1)}
        writer.flush()
        writer.add_metadata("recovered", {"from": name} | notes)
        writer.finish()
    return Recovery(copy.messages, scan.missing, copy.unproved)
