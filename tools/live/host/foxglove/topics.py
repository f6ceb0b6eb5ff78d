"""The topics of a running node for Foxglove: names, schemas and bytes are those of its log.

So a layout for a log works on the run, and the other way round. `/log` is what only the run has:
events and tunings once more, as foxglove.Log.
"""

import foxglove
import numpy as np
from foxglove.channels import LogChannel
from foxglove.messages import Log, LogLevel, Timestamp
from numpy.typing import NDArray

from pcpc.executive.log.channels import Channels
from pcpc.executive.log.description import node_description
from pcpc.executive.log.event_entries import entry_of
from pcpc.executive.log.long_logs import WITHOUT_CLOCK
from pcpc.executive.loop.ring_layout import OfEvent
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.tap import Tap
from pcpc.tools.live.host.foxglove.thinning import Thinning
from pcpc.tools.live.host.sources import full

_KINDS = {"cdr": "ros2msg", "json": "jsonschema"}
_LEVELS = {
    "fault": LogLevel.Error, "not finite": LogLevel.Error, "state": LogLevel.Info,
    "change": LogLevel.Info,
}  # fmt: skip


class NodeTopics:
    """Those of one node, advertised by the servers of `context`.

    `wall_ns`: when the run began, for one without a clock; its nodes have the same time.
    """

    def __init__(
        self, live: Live, context: foxglove.Context, log: LogChannel, wall_ns: str
    ) -> None:
        self._context, self._log = context, log
        self._open: dict[int, foxglove.Channel] = {}
        description = node_description(live.block.description)
        facts = description["metadata"]
        if facts.get("pacing") in WITHOUT_CLOCK:  # its stamps count from 0, as its log's do
            facts = facts | {"clock_monotonic_ns": "0", "clock_wall_ns": wall_ns}
            description = {**description, "metadata": facts}
        self._about, self._live, self._tap = description, live, Tap(live)
        self._channels = Channels(description, self)
        self._thinning = Thinning(self._channels.period_ns, self._channels.clocked)

    def register(self, name: str, schema: str, text: str, encoding: str) -> int:
        """Advertise a topic; see `executive.log.channels.Topics`."""
        kind = foxglove.Schema(name=schema, encoding=_KINDS[encoding], data=text.encode())
        channel = foxglove.Channel(
            name, message_encoding=encoding, schema=kind, context=self._context
        )
        number = len(self._open) + 1
        self._open[number] = channel
        return number

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Do nothing: name, unit and meaning stand in the schema, too."""

    def publish(self) -> None:
        """Send what the node has recorded since, as much as goes, to those who subscribed."""
        self._send("record", self._thinning.cycles(self._tap.raw("record")))
        self._send("frame", self._thinning.frames(self._tap.raw("frame")))
        events = self._tap.raw("event")
        self._send("event", events)
        if self._log.has_sinks():
            for row in events:
                self._tell(row)

    def close(self) -> None:
        """Take the topics back."""
        for channel in self._open.values():
            channel.close()

    def _send(self, ring: str, rows: NDArray[np.int64]) -> None:
        for records in self._channels.messages(ring, rows) if len(rows) else ():
            channel = self._open[int(records["channel"][0])]
            for record in records if channel.has_sinks() else ():
                channel.log(record["data"].tobytes(), log_time=int(record["log_time"]))

    def _tell(self, row: NDArray[np.int64]) -> None:
        """Send an event or a tuning in words."""
        topic, entry = entry_of(row, self._about)
        wall_ns = int(row[OfEvent.STAMP_NS]) + self._channels.wall_ns
        cycle = int(row[OfEvent.CYCLE])
        name, value = str(entry.get("name", "")), entry["value"]
        if topic == "tunings":
            unit = self._live.variables[name].unit
            words = f"{full(self._channels.name, name)} = {value:.9g} {unit}".rstrip()
            level, text = LogLevel.Info, f"{words} from cycle {cycle}"
        else:
            level = _LEVELS.get(entry["event"], LogLevel.Warning)
            text = f"{entry['event']} {name} at cycle {cycle}".replace("  ", " ")
        at = Timestamp(sec=wall_ns // 10**9, nsec=wall_ns % 10**9)
        said = Log(timestamp=at, level=level, message=text, name=self._channels.name)
        self._log.log(said, log_time=wall_ns)
