"""A log of a part of a run: what taps of its nodes saw, with the bits that the run's own log has.

    part = Part(path)
    node = part.node(live.block.description)
    node.add("record", node.rows(tap.rows()))
    node.add("frame", tap.frames()); node.add("event", tap.raw("event"))
    part.close({"executive": tap.missed})

What explains the messages is written first, so that a file that was cut short opens.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log.channels import Channels, write_description
from pcpc.executive.log.description import NodeDescription, node_description
from pcpc.executive.log.long_logs import WITHOUT_CLOCK
from pcpc.executive.log.mcap_writer import CHUNK_BYTES, BulkWriter
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.ring_layout import RECORD_HEAD
from pcpc.executive.nodes.tap import Rows

_KINDS = "state_columns", "timing_columns"


class NodePart:
    """What of one node is written; made by `LogPart.node`."""

    def __init__(self, description: NodeDescription, writer: BulkWriter) -> None:
        self.names = [*description["state_columns"], *description["timing_columns"]]
        self.channels = Channels(description, writer)
        self.written = dict.fromkeys((*sh.RINGS, "alarm"), 0)
        self._writer, self._states = writer, len(description["state_columns"])

    def rows(self, seen: Rows) -> NDArray[np.int64]:
        """Return cycles as rows of a ring with the columns of this log only.

        Shape (n, columns of the ring).
        """
        head, states = RECORD_HEAD, self._states
        rows = np.full((len(seen), head + len(self.names) + 1), sh.CDR_HEADER, np.int64)
        rows[:, 0], rows[:, 1] = seen.cycle, seen.stamp_ns
        places = [seen.places[name] for name in self.names]
        values = np.ascontiguousarray(seen.values[:, places]).view(np.int64)
        rows[:, head : head + states] = values[:, :states]
        rows[:, head + states + 1 :] = values[:, states:]
        return rows

    def add(self, ring: str, rows: NDArray[np.int64]) -> None:
        """Write rows as they are in a ring, in pieces that a chunk takes; OSError.

        Shape (n, columns of the ring).
        """
        most = CHUNK_BYTES // (8 * rows.shape[1] + 128)  # with the heads of two messages
        for start in range(0, len(rows), most):
            self._writer.add(self.channels.messages(ring, rows[start : start + most]))
        self.written[ring] += len(rows)

    def write_event(self, stamp: int, cycle: int, entry: dict[str, Any]) -> None:
        """Write an event that stands in no ring; OSError."""
        self._writer.add([self.channels.entry("events", stamp, cycle, entry)])
        self.written["alarm"] += 1


class LogPart:
    """The file. Nodes may come while it is written; OSError where that fails."""

    def __init__(self, path: Path) -> None:
        self.writer = BulkWriter(path)
        self.writer.start(profile="ros2")
        self.nodes: dict[str, NodePart] = {}
        self._files: dict[str, str] = {}
        self._wall_ns = ""  # of the first node: without a clock the stamps of all count from there

    def node(self, description: Mapping[str, Any], names: Sequence[str] | None = None) -> NodePart:
        """Take up the node of a description, with all that it records or what `names` has."""
        facts = dict(description["metadata"])
        self._wall_ns = self._wall_ns or facts["clock_wall_ns"]
        if facts.get("pacing") in WITHOUT_CLOCK:
            facts |= {"clock_monotonic_ns": "0", "clock_wall_ns": self._wall_ns}
        own = (
            {} if names is None else {k: [n for n in description[k] if n in names] for k in _KINDS}
        )
        description = node_description({**description, **own, "metadata": facts})
        write_description(self.writer, description, self._files)
        found = self.nodes[str(description["node"])] = NodePart(description, self.writer)
        return found

    @property
    def size(self) -> int:
        """The bytes that are in the file so far."""
        return self.writer.file.tell()

    def flush(self) -> None:
        """Hand what was added to the kernel."""
        self.writer.flush()

    def close(self, missed: Mapping[str, Mapping[str, int]]) -> None:
        """End the log; `missed`: rows by node and ring that were lost while it was made."""
        counts: dict[str, int] = {}
        for name, node in self.nodes.items():
            counts |= {f"written.{name}.{ring}": n for ring, n in node.written.items()}
            counts |= {f"dropped.{name}.{ring}": n for ring, n in missed[name].items()}
        self.writer.flush()
        self.writer.add_metadata("run", {key: str(count) for key, count in counts.items()})
        self.writer.finish()
        self.writer.file.close()

    def give_up(self) -> None:
        """Close the file as it is, where it cannot be written any more."""
        with suppress(OSError):
            self.writer.file.close()
