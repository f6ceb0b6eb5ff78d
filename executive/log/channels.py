"""What becomes of the rows of a node's rings in a log: topics, their schemas, messages.

The bytes of a row become the payloads of two messages:

    row of the ring   [cycle, stamp, header, state..., header, timing...]   cells of 8 bytes
    /state            the upper half of the first header and all state cells, byte for byte
    /timing           the same of the second header
    log_time          stamp - clock_monotonic_ns + clock_wall_ns            wall time, ns
                      without a clock: k T + clock_wall_ns of the first node
"""

import json
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log import reader as logs
from pcpc.executive.log.description import NodeDescription
from pcpc.executive.log.event_entries import entry_of
from pcpc.executive.log.long_logs import WITHOUT_CLOCK
from pcpc.executive.log.mcap_writer import BulkWriter, message_records
from pcpc.executive.log.schemas import FD_FRAME_SCHEMA, FRAME_SCHEMA, JSON_SCHEMAS, field_names
from pcpc.executive.loop.ring_layout import RECORD_HEAD, OfEvent, OfFrame, OfRecord, data_bytes
from pcpc.executive.own_laws import carried_files

_OF_THE_MEMORY = (
    "attachments",
    "blocks",
    "initial",
    "record_columns",
    "name",
    "laws",
)  # not in a log


class Topics(Protocol):
    """Where topics are made known: a file, a server."""

    def register(self, name: str, schema: str, text: str, encoding: str) -> int:
        """Make a topic known with its schema (`encoding` cdr or json); return its id."""
        ...

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Take what is said about topics besides."""
        ...


class Channels:
    """The topics of a node, of which `about` is the description."""

    def __init__(self, description: NodeDescription, writer: Topics) -> None:
        self.about, self.name = description, str(description["node"])
        facts = description["metadata"]
        self.wall_ns = int(facts["clock_wall_ns"]) - int(facts["clock_monotonic_ns"])
        self.clocked = facts.get("pacing") not in WITHOUT_CLOCK
        self.period_ns = int(description["period_ns"])
        self.state_end = 8 * (RECORD_HEAD + len(description["state_columns"]))
        both = {"state": description["state_columns"], "timing": description["timing_columns"]}
        self.ids = {kind: self._columns(writer, kind, names) for kind, names in both.items()}
        self.ids |= register_entries(writer, self.name, data_bytes(description))

    def _columns(self, writer: Topics, kind: str, names: Sequence[str]) -> int:
        known = {row[0]: row for row in self.about["variables"]}
        rows = [known.get(name, (name, "", "", "", "")) for name in names]
        schema = f"pcpc/{'' if self.name == 'executive' else self.name.title()}{kind.title()}"
        return register_columns(writer, logs.topic(self.name, kind), schema, rows)

    def messages(self, ring: str, rows: NDArray[np.int64]) -> list[NDArray[Any]]:
        """Return copies of ring rows as message records. `rows`: (n, columns of the ring)."""
        cells = rows.view(np.uint8)
        if ring == "record":
            cycle, end = rows[:, OfRecord.CYCLE], self.state_end
            log_ns = self.stamp(rows[:, OfRecord.STAMP_NS], cycle) + self.wall_ns
            head = 8 * RECORD_HEAD - logs.CDR_BYTES
            state, timing = cells[:, head:end], cells[:, end + 8 - logs.CDR_BYTES :]
            return [
                message_records(self.ids["state"], cycle, log_ns, state),
                message_records(self.ids["timing"], cycle, log_ns, timing),
            ]
        if ring == "frame":
            log_ns, data = rows[:, OfFrame.STAMP_NS] + self.wall_ns, cells[:, 8 - logs.CDR_BYTES :]
            return [message_records(self.ids["can/frames"], rows[:, OfFrame.CYCLE], log_ns, data)]
        return [self._event(row) for row in rows]

    def stamp(self, machine_ns: Any, cycle: Any) -> Any:
        """Return the stamp of what the machine's clock stamped in `cycle`: without a clock k T."""
        return machine_ns if self.clocked else cycle * self.period_ns

    def _event(self, row: NDArray[np.int64]) -> NDArray[Any]:
        topic, entry = entry_of(row, self.about)
        return self.entry(topic, int(row[OfEvent.STAMP_NS]), int(row[OfEvent.CYCLE]), entry)

    def entry(self, kind: str, stamp: int, cycle: int, entry: dict[str, Any]) -> NDArray[Any]:
        """Return an entry of the topic `kind`, as events or tunings, as a message record.

        Shape (1,).
        """
        whole = json.dumps({"cycle": cycle, "stamp_ns": stamp} | entry).encode()
        k, log_ns = np.array([[cycle], [stamp + self.wall_ns]])
        data = np.frombuffer(whole, np.uint8)[None, :]
        return message_records(self.ids[kind], k, log_ns, data)


def register_columns(
    writer: Topics, topic: str, schema: str, variables: Sequence[Sequence[str]]
) -> int:
    """Register a topic of columns, each variable with unit, kind, writer, help; return its id."""
    lines, mapping = [], {}
    for field, row in zip(field_names([row[0] for row in variables]), variables, strict=True):
        name, unit, kind, owner, text = row
        comment = f"{name} [{unit or '1'}] {' '.join(text.split())}"
        lines.append(f"float64 {field}  # {comment.rstrip()}")
        about = {"name": name, "unit": unit, "kind": kind, "writer": owner, "help": text}
        mapping[field] = json.dumps(about)
    writer.add_metadata(f"variables:{topic}", mapping)
    return writer.register(topic, schema, "\n".join(lines) + "\n", "cdr")


def register_entries(writer: Topics, node: str, most: int = 8) -> dict[str, int]:
    """Register the topics of a node that are no columns; return their ids by kind.

    `most`: data bytes of a frame.
    """
    place = logs.topic(node, "can/frames")
    schema = ("pcpc/Frame", FRAME_SCHEMA) if most == 8 else ("pcpc/FdFrame", FD_FRAME_SCHEMA)
    found = {"can/frames": writer.register(place, *schema, "cdr")}
    return found | register_objects(writer, node, "Event", "Tuning")


def register_objects(writer: Topics, node: str, *kinds: str) -> dict[str, int]:
    """Register topics of JSON of a node, of kinds of `JSON_SCHEMAS`; return their ids by kind."""
    ids: dict[str, int] = {}
    for kind in kinds:
        topic = f"{kind.lower()}s"
        place, schema = logs.topic(node, topic), json.dumps(JSON_SCHEMAS[kind])
        ids[topic] = writer.register(place, f"pcpc.{kind}", schema, "json")
    return ids


def write_description(
    writer: BulkWriter, description: NodeDescription, files: dict[str, str]
) -> None:
    """Write what explains the messages of a node; `files` are those that stand in the log so far.

    A file that differs from one of its name stands below the node's name.
    """
    name = str(description["node"])
    facts = {str(key): str(value) for key, value in description["metadata"].items()}
    facts |= {"rig": str(description["rig"]), "period_ns": str(description["period_ns"])}
    writer.add_metadata(name, facts)
    rest = {k: v for k, v in description.items() if k not in _OF_THE_MEMORY}
    wall_ns = int(description["metadata"]["clock_wall_ns"])
    for file, data, digest in carried_files.attachments(
        description, {f"{name}.json": json.dumps(rest)}
    ):
        place = file if files.get(file, digest) == digest else f"{name}/{file}"
        if files.setdefault(place, "") == "":
            files[place] = digest
            writer.add_attachment(wall_ns, wall_ns, place, "text/plain", data)
